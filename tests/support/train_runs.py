"""What the tests of both trainers share: runs that are killed, and learners that are restored."""

from __future__ import annotations

import dataclasses
import os
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from paths import PROCESS_SECONDS, ROOT, SUPPORT

from train.learning.ppo import Hyper
from train.learning.rollout import init_rollout
from train.learning.update import make_updates
from train.runs.checkpoint import checkpoint_files, load_newest, save_checkpoint
from train.runs.progress import Lines

PREAMBLE = f"import sys; sys.path[:0] = {[str(ROOT), str(SUPPORT)]!r}\n"
KILLED = """
from paths import ROOT, SUPPORT
import time
from {module} import {env}
from train.configs import {config}
from train.{trainer} import train
train({env}(), {config}(**{fields!r}), on_log=lambda row, policies: time.sleep(0.05))
"""


def start_python(code: str, **options: Any) -> subprocess.Popen:
    """A fresh Python on the CPU that knows this repository."""
    options["env"] = {**os.environ, "JAX_PLATFORMS": "cpu", **options.get("env", {})}
    return subprocess.Popen([sys.executable, "-c", PREAMBLE + code], text=True, **options)


def _told(config: Any) -> dict[str, Any]:
    """The settings that are other than the defaults."""
    usual = type(config)()
    fields = {x.name: getattr(config, x.name) for x in dataclasses.fields(config)}
    return {name: value for name, value in fields.items() if value != getattr(usual, name)}


def kill_in_training(env: Any, trainer: str, config: Any) -> None:
    """Train in another process, and kill it (SIGKILL) when it has written two checkpoints."""
    code = KILLED.format(
        module=type(env).__module__,
        env=type(env).__name__,
        config=type(config).__name__,
        trainer=trainer,
        fields=_told(config),
    )
    folder = Path(config.save_dir) / env.name / "checkpoints"
    with start_python(code, stderr=subprocess.DEVNULL) as process:
        try:
            deadline = time.monotonic() + PROCESS_SECONDS
            while len(checkpoint_files(folder)) < 2 and process.poll() is None:
                assert time.monotonic() < deadline, "no checkpoints were written"
                time.sleep(0.02)
            assert process.poll() is None, "the run ended before it could be killed"
        finally:  # SIGKILL; also where this fails: the process must not outlive the test
            process.kill()


def check_continued(result: Any, said: list[str], config: Any, updates: int) -> None:
    """The curve of a run that was killed and went on has every row once, in memory and on disk."""
    batch = config.num_envs * config.num_steps
    assert 0 < result.session_steps < result.env_steps == updates * batch
    steps = [row["env_steps"] for row in result.curve]
    assert steps == [batch * i for i in range(1, updates + 1)]  # nothing twice, nothing missing
    seconds = [row["seconds"] for row in result.curve]
    assert seconds == sorted(seconds)
    assert said[0].startswith("Continuing from step") and "fresh episodes" in said[0]
    assert len((result.folder / "curve.jsonl").read_text().splitlines()) == updates


def check_restored(env: Any, config: Any, agents: Any, folder: Path) -> Any:
    """A saved and restored learner learns on exactly as one that was never saved; returns it."""
    venv, hyper = env.vectorize(config.num_envs), Hyper.of(config, 800)
    learner = jax.jit(agents.init)(jax.random.PRNGKey(0))
    rollout = jax.jit(lambda key: init_rollout(venv, key, True))(jax.random.PRNGKey(1))
    run = jax.jit(make_updates(venv, config, agents))
    middle, rollout, _ = run(learner, rollout, jnp.int32(3), hyper)
    unbroken, _, _ = run(middle, rollout, jnp.int32(2), hyper)

    save_checkpoint(folder, middle, {"compatibility": {}})
    restored = load_newest(folder, learner, {}).learner
    resumed, _, _ = run(restored, rollout, jnp.int32(2), hyper)
    assert env.traces["step"] == 1
    assert same_bytes(unbroken, resumed) and not same_bytes(middle, resumed)
    return restored


def same_bytes(one: Any, other: Any) -> bool:
    """Whether all leaves of two trees of one structure are the same, bit by bit."""
    pairs = zip(jax.tree.leaves(one), jax.tree.leaves(other), strict=True)
    return all(np.asarray(a).tobytes() == np.asarray(b).tobytes() for a, b in pairs)


def listening() -> tuple[Lines, list[str]]:
    """A progress that keeps what it is told to say, and what it has said."""
    progress, said = Lines(period=0.0), []
    progress.say = said.append
    return progress, said
