"""Learning on a laptop: how good the demo's policy is, and what training comes to in at most a quarter of an hour.

    taskset -c 0,1 python -m benchmarks.laptop --what demo --seed 1 --json benchmarks/results/laptop.jsonl
    taskset -c 0,1 python -m benchmarks.laptop --what train --minutes 15 --seed 1 --json benchmarks/results/laptop.jsonl

``demo`` runs ``python -m train.demo``, ``train`` runs ``python -m train.ppo`` with the settings that the task has on a CPU, as
users run them: in a process of their own, with an empty compilation cache, on the cores that this process may
use. Seconds count from the start of that process. Afterwards, in time that does not count, the policy is
evaluated with other people, by the mode of its distribution and by samples of it.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import tyro

from benchmarks.child import ChildError, run_child
from benchmarks.keep import keep
from train.configs import Count

ENOUGH = 0.9
"""Success while training whose time is reported."""
EPISODES = 100
"""Over which that success is a mean, or more: of the last rows of the curve."""
EVALUATE = """
import json, sys
import agym_jax
from train.evaluate import evaluate
env = agym_jax.make(sys.argv[1], impl="native")
policy = agym_jax.load_policy(sys.argv[2], env)
results = [evaluate(env, policy, int(sys.argv[3]), 5000, deterministic=x) for x in (True, False)]
print(json.dumps([[r.success, float(r.returns.mean())] for r in results]))
"""


@dataclass(frozen=True)
class LaptopConfig:
    """Flags of ``python -m benchmarks.laptop``."""

    what: Literal["demo", "train"] = "demo"
    """The demo, or a training of --minutes."""
    env_name: str = "ScratchItchJaco-v0"
    """Environment id."""
    minutes: float = 15.0
    """When a training is stopped, if it has not made all its steps."""
    num_env_steps: Count = 2_000_000
    """Steps of a training, after which its learning rate is zero; the demo has its own."""
    episodes: Count = 500
    """Of each evaluation."""
    seed: int = 1
    """Of people and training."""
    json: Path | None = None
    """File to which the result is added as a JSON line."""


def run_command(words: Sequence[str], seconds: float, cache: str) -> tuple[float, float]:
    """A command of this package in a process of its own.

    Args:
        words: after ``python -m``.
        seconds: after which it is asked to end; it keeps what it has.
        cache: folder for compiled programs.

    Returns:
        When it began (``time.time``), and how long it took [s].

    Raises:
        ChildError: it failed.
    """
    variables = {**os.environ, "AGYM_JAX_CACHE": cache}
    with tempfile.TemporaryFile("w+") as said:
        began = time.time()
        process = subprocess.Popen(
            [sys.executable, "-m", *words], stdout=said, stderr=subprocess.STDOUT, env=variables
        )
        try:
            status = process.wait(seconds)
        except subprocess.TimeoutExpired:
            process.send_signal(signal.SIGTERM)
            status = process.wait()
        took = time.time() - began
        said.seek(0)
        text = said.read()
    if status not in (0, 130):  # 130: it was asked to end
        raise ChildError(f"python -m {' '.join(words)} failed:\n{text[-2000:]}")
    return began, took


def seconds_to(curve: Sequence[dict[str, Any]], share: float) -> float | None:
    """When success was so high in the last ``EPISODES`` episodes [s]; None if it never was."""
    episodes: list[int] = []
    won: list[float] = []
    for row in curve:
        episodes.append(row["episodes"])
        won.append(row["episodes"] * (row["success"] or 0.0))
        while sum(episodes[1:]) >= EPISODES:
            del episodes[0], won[0]
        if sum(episodes) >= EPISODES and sum(won) >= share * sum(episodes):
            return row["seconds"]
    return None


def measure(config: LaptopConfig) -> dict[str, Any]:
    """One run and the evaluation of its policy; returns the fields of the result line."""
    load = os.getloadavg()[0]
    common = ["--env-name", config.env_name, "--seed", str(config.seed)]
    with tempfile.TemporaryDirectory() as folder:
        cache = str(Path(folder) / "cache")
        if config.what == "demo":
            words = ["train.demo", *common, "--out", folder]
            limit = 3600.0
        else:
            words = ["train.ppo", *common, "--save-dir", folder, "--impl", "native"]
            words += ["--num-env-steps", str(config.num_env_steps)]
            limit = 60.0 * config.minutes
        began, took = run_command(words, limit, cache)
        run = Path(folder) / config.env_name
        rows = [json.loads(line) for line in (run / "curve.jsonl").read_text().splitlines()]
        settings = json.loads((run / "config.json").read_text())["config"]
        # a row is written as soon as it is there; its seconds begin with the training
        ahead = (run / "curve.jsonl").stat().st_mtime - began - rows[-1]["seconds"]
        curve = [row | {"seconds": row["seconds"] + ahead} for row in rows]
        words = (config.env_name, str(run), str(config.episodes))
        mode, sampled = run_child(EVALUATE, *words, AGYM_JAX_CACHE=cache)
    names = ("num_env_steps", "num_envs", "lr", "policy_hidden", "value_hidden")
    return {
        "what": config.what,
        "minutes": config.minutes if config.what == "train" else None,
        "env": config.env_name,
        "seed": config.seed,
        "seconds": round(took, 1),
        "training_began": round(ahead, 1),
        "env_steps": rows[-1]["env_steps"],
        "steps_per_s": round(rows[-1]["env_steps"] / rows[-1]["seconds"]),
        "success": mode[0],
        "return": mode[1],
        "success_sampled": sampled[0],
        "return_sampled": sampled[1],
        "episodes": config.episodes,
        "success_training": curve[-1]["success"],
        "seconds_to_90": seconds_to(curve, ENOUGH),
        "settings": {name: settings[name] for name in names},
        "curve": {
            name: [row[name] if row[name] is None else round(row[name], 4) for row in curve]
            for name in ("seconds", "env_steps", "episodes", "success", "return")
        },
        "load_before": round(load, 2),
    }


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; returns the exit status."""
    config = tyro.cli(LaptopConfig, prog="python -m benchmarks.laptop", args=arguments)
    os.environ["JAX_PLATFORMS"] = "cpu"  # for the children, and for the record, which asks JAX
    return 2 if keep("laptop", lambda: measure(config), config.json) is None else 0


if __name__ == "__main__":
    sys.exit(main())
