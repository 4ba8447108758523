"""One session of training, whatever is trained: compile, go from log line to log line, save, resume.

The run is compiled once and then goes from log line to log line in single calls, each of many
updates. A session that finds checkpoints in its folder goes on from there.
"""

from __future__ import annotations

import dataclasses
import math
import signal
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import jax
import numpy as np
from jax.sharding import Mesh

from agym_jax.data.npz import check_writable
from agym_jax.errors import AgymError

from ..configs import Config, LearnConfig, parse_arguments, resolve, updates_in
from ..envs import make_env, vectorize
from ..learning.algorithm import Algorithm
from ..learning.hosts import check_agreement, join_hosts, wait_for_hosts
from ..learning.rollout import RolloutState, init_rollout
from ..learning.stepwise import StepwiseEnv, start_stepwise
from ..learning.update import AXIS, device_mesh, make_updates, replicate, shard, shardings, to_host
from .curve import Row, check_row, make_row
from .folder import RunFolder
from .manager import CheckpointManager, Policies
from .progress import Progress, Silent, for_terminal
from .result import TrainResult, summary

SAVE_PERIOD = 60.0  # seconds after which a checkpoint is due at the next log line
UNIMPORTANT = ("save_dir", "fresh", "log_interval", "save_interval", "devices", "hosts")
OnLog = Callable[[Row, Callable[[], Policies]], bool | None]


def settle(env: Any, config: Config) -> tuple[Config, Mesh | None]:
    """Settings for an environment and this machine, and the devices if there are several.

    Raises:
        ConfigError: settings that do not fit together, or the machine.
    """
    mesh = None if isinstance(env, StepwiseEnv) else device_mesh(config.devices)
    config = dataclasses.replace(config, env_name=env.name)
    return resolve(config, jax.default_backend(), mesh.size if mesh else 1), mesh


def run_session(
    env: Any,
    config: LearnConfig,
    algorithm: Algorithm,
    mesh: Mesh | None = None,
    progress: Progress | None = None,
    on_log: OnLog | None = None,
) -> TrainResult:
    """Train until the number of steps is reached, or something stops it.

    Args:
        env: an environment (``agym_jax.make``), or a ``StepwiseEnv``.
        config: from ``settle``.
        algorithm: how to learn.
        mesh: from ``settle``.
        progress: is told what happens; None shows nothing.
        on_log: see ``train.ppo.train``; gets policies by agent.

    Returns:
        Policies, learning curve and times.
    """
    is_main_process = jax.process_index() == 0  # one host writes, and tells
    progress = (progress if is_main_process else None) or Silent()
    folder = RunFolder(config.save_dir, env.name) if config.save_dir is not None else None
    if folder and is_main_process and (aside := folder.prepare(config.fresh)):
        progress.say(f"Starting over; the earlier run is now in {aside}")
    wait_for_hosts("folder")

    start = time.perf_counter()
    venv = vectorize(env, config.num_envs // config.devices)
    key_learner, key_envs = jax.random.split(jax.random.PRNGKey(config.seed))
    keeper = CheckpointManager(env, config, algorithm, folder, writes=is_main_process)
    learner, meta = keeper.resume(jax.jit(algorithm.init)(key_learner))
    first_steps = int(learner.env_steps)
    if meta:
        _say_resumed(progress, meta, config, first_steps)
    check_agreement("the step to go on from", first_steps, "They need a common --save-dir.")
    keeper.begin(first_steps)

    batch = config.num_envs * config.num_steps
    total_steps = updates_in(config.num_env_steps, batch) * batch
    rollout_state: Any = None
    run: Any = None
    if first_steps < total_steps:
        # A resumed run gets fresh episodes, and other ones than the run before it began with.
        key_envs = jax.random.fold_in(key_envs, first_steps)
        if isinstance(venv, StepwiseEnv):
            rollout_state, run = start_stepwise(venv, config, algorithm, key_envs)
        else:
            learner, rollout_state, run = _compile(venv, config, algorithm, learner, key_envs, mesh)
    else:
        progress.say("This run is complete; raise --num-env-steps to go on.")
    compile_seconds = time.perf_counter() - start

    progress.start(first_steps, total_steps)
    length = np.float32(total_steps)
    start = last_save = time.perf_counter()
    env_steps, nan_steps, since_save, interrupted = first_steps, 0, 0, False
    saved_at = first_steps
    try:
        while env_steps < total_steps and not interrupted:
            count = min(config.log_interval, math.ceil((total_steps - env_steps) / batch))
            began = time.perf_counter()
            next_learner, rollout_state, totals = run(
                learner, rollout_state, np.int32(count), length
            )
            totals = jax.device_get(totals)
            now = time.perf_counter()
            row = make_row(totals, count, count * batch, env.episode_length)
            nan_steps += int(row["nan"])
            row |= {
                "env_steps": env_steps + count * batch,
                "seconds": keeper.seconds + now - start,
                "steps_per_second": count * batch / (now - began),
                "nan_total": nan_steps,
            }
            check_row(row, env.name, config.num_envs)
            learner, env_steps = next_learner, env_steps + count * batch
            keeper.add(row)
            progress.update(row)
            since_save += count
            due = since_save >= config.save_interval or now - last_save > SAVE_PERIOD
            if on_log and on_log(row, lambda kept=learner: keeper.policies(kept)):
                interrupted = env_steps < total_steps
            if due or interrupted or env_steps >= total_steps:
                keeper.save(learner, now - start)
                saved_at, since_save, last_save = env_steps, 0, time.perf_counter()
    except KeyboardInterrupt:
        interrupted = True
        if env_steps > saved_at:
            keeper.save(learner, time.perf_counter() - start)
    finally:
        progress.stop()
    train_seconds = time.perf_counter() - start
    return TrainResult(
        policies=keeper.finish(learner),
        learner=to_host(learner),
        config=config,
        curve=keeper.curve,
        env_steps=env_steps,
        session_steps=env_steps - first_steps,
        compile_seconds=compile_seconds,
        train_seconds=train_seconds,
        nan_steps=nan_steps,
        interrupted=interrupted,
        folder=folder.path if folder and is_main_process else None,
    )


def _compile(
    venv: Any,
    config: LearnConfig,
    algorithm: Algorithm,
    learner: Any,
    key: jax.Array,
    mesh: Mesh | None,
) -> tuple[Any, RolloutState, Callable]:
    """The learner where it belongs, environments at their start, the compiled function for many updates."""

    def first(key: jax.Array) -> RolloutState:
        return init_rollout(venv, key, config.stagger)

    run = make_updates(venv, config, algorithm, AXIS if mesh else None)
    common = own = None
    if mesh:
        common, own = shardings(mesh)
        first, run = shard(mesh, first, run)
        learner, key = replicate(mesh, (learner, key))
    # XLA would leave Warp's empty buffers anywhere, so every place is said.
    reset = jax.jit(first, out_shardings=own).lower(key)
    rollout_state = jax.tree.map(
        lambda leaf: jax.ShapeDtypeStruct(leaf.shape, leaf.dtype, sharding=own), reset.out_info
    )
    update = jax.jit(run, out_shardings=(common, own, common))
    update = update.lower(learner, rollout_state, np.int32(1), np.float32(1))
    with ThreadPoolExecutor(2) as pool:  # XLA compiles outside of Python's lock
        begin, go = pool.map(lambda lowered: lowered.compile(), (reset, update))
    return learner, jax.block_until_ready(begin(key)), go


def _say_resumed(
    progress: Progress, meta: Mapping[str, Any], config: LearnConfig, steps: int
) -> None:
    """Tell where a run goes on, and which settings differ from before."""
    progress.say(f"Continuing from step {steps:,} with fresh episodes (--fresh starts over).")
    ours, theirs = dataclasses.asdict(config), meta.get("config", {})
    for name, value in ours.items():
        value = list(value) if isinstance(value, tuple) else value
        if name not in UNIMPORTANT and name in theirs and theirs[name] != value:
            progress.say(f"  {name} is now {value!r}; it was {theirs[name]!r}.")


def _on_terminate(*_: Any) -> None:
    raise KeyboardInterrupt


def command_line(
    kind: type[Config],
    train: Callable[[Any, Config, Progress], TrainResult],
    arguments: Sequence[str] | None,
    make: Callable[[str, str], Any] = make_env,
    prog: str | None = None,
) -> int:
    """The command line of a trainer.

    Args:
        kind: of its settings.
        train: the trainer: environment, settings and progress -> result.
        arguments: words; None for those of the program.
        make: id and physics -> environment.
        prog: what was typed to start it, for the help.

    Returns:
        The exit status.
    """
    words = sys.argv[1:] if arguments is None else list(arguments)
    try:
        config = parse_arguments(words, kind, prog)
        signal.signal(signal.SIGTERM, _on_terminate)
        if config.save_dir is not None:  # before the environment is built, which takes seconds
            check_writable(Path(config.save_dir))
        join_hosts(config.hosts)
        env = make(config.env_name, config.impl)
        result = train(env, config, for_terminal())
    except AgymError as error:
        print(f"{type(error).__name__}: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("Stopped before training began.", file=sys.stderr)
        return 130
    if jax.process_index() == 0:
        print(summary(result))
    if result.interrupted:
        print("Rerun the same command to continue.")
        return 130
    return 0
