"""Train a robot's policy with PPO: ``python -m train.ppo --env-name ScratchItchJaco-v0``.

The run is compiled once and then goes from log line to log line in single calls, each of many
updates. Rerunning the same command continues a run that was killed; ``train`` does the same from
Python.
"""

from __future__ import annotations

import dataclasses
import math
import signal
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp

from agym_jax.errors import AgymError
from train import record
from train.checkpoint import load_newest, save_checkpoint
from train.configs import PPOConfig, parse_arguments, resolve, updates_in
from train.curve import Row, check_row, make_row
from train.envs import make_env, refuse_active_human, vectorize
from train.learner import LearnerState, architecture, init_learner, make_updates
from train.networks import Architecture
from train.npz import check_writable
from train.policy import Policy, save_policy
from train.progress import Progress, Silent, for_terminal
from train.result import TrainResult, summary
from train.rollout import Worlds, first_worlds
from train.run_folder import RunFolder
from train.stepwise import StepwiseEnv, start_stepwise

SAVE_PERIOD = 60.0  # seconds after which a checkpoint is due at the next log line
OnLog = Callable[[Row, Callable[[], Policy]], bool | None]


def policy_of(learner: LearnerState, arch: Architecture, info: Mapping[str, Any]) -> Policy:
    """The learner's present policy."""
    info = {**info, "env_steps": int(learner.env_steps)}
    mean, std = jnp.asarray(learner.normalizer.mean), jnp.asarray(learner.normalizer.std)
    return Policy(learner.params.policy, mean, std, arch, info)


def train(
    env: Any,
    config: PPOConfig,
    progress: Progress | None = None,
    on_log: OnLog | None = None,
) -> TrainResult:
    """Train a policy.

    Args:
        env: an environment (``agym_jax.make``) with one acting agent, or a ``StepwiseEnv``.
        config: settings; ``save_dir=None`` writes no files.
        progress: is told what happens; None shows nothing.
        on_log: called as ``on_log(row, policy)`` at each log line, where ``policy()`` makes the
            present policy; a true result stops the run (its state is saved).

    Returns:
        Policy, learning curve and times.

    Raises:
        ActiveHumanError: the person acts too, and it was not allowed.
        ConfigError: settings that do not fit together.
        SaveFolderError: results cannot be written.
        CheckpointMismatchError: the folder holds a run of something else.
        BufferOverflowError: the physics lost contacts.
        DivergedError: a loss is not finite.
    """
    progress = progress or Silent()
    refuse_active_human(env, config.allow_joint_observation)
    config = resolve(dataclasses.replace(config, env_name=env.name), jax.default_backend())
    folder = RunFolder(config.save_dir, env.name) if config.save_dir is not None else None
    if folder and (aside := folder.prepare(config.fresh)):
        progress.say(f"Starting over; the earlier run is now in {aside}")

    start = time.perf_counter()
    venv = vectorize(env, config.num_processes)
    arch = architecture(config, venv.observation_size, venv.action_size)
    key_learner, key_worlds = jax.random.split(jax.random.PRNGKey(config.seed))
    learner = jax.jit(lambda key: init_learner(config, arch, key))(key_learner)
    belongs = {
        "env": env.name,
        "layout": env.layout_version,
        **{
            k: list(v) if isinstance(v, tuple) else v
            for k, v in vars(arch).items()
            if k not in ("init_noise_std", "policy_head_gain")
        },
    }
    info = {
        "env": env.name,
        "layout": env.layout_version,
        "commit": record.commit(),
        "versions": record.versions(),
        "algorithm": "ppo",
    }
    batch = config.num_processes * config.num_steps
    total_steps = updates_in(config.num_env_steps, batch) * batch
    curve: list[Row] = []
    seconds_before = 0.0
    if folder and (found := load_newest(folder.checkpoints, learner, belongs)):
        learner, curve = found.learner, found.meta["curve"]
        seconds_before = found.meta["seconds"]
        _say_resumed(progress, found.meta, config, int(learner.env_steps))
    first_steps = int(learner.env_steps)
    if folder:
        folder.write_curve(curve)
        folder.write_config(
            config,
            resumed_from_step=first_steps or None,
            impl=str(getattr(env, "impl", config.impl)),
        )

    worlds: Any = None
    run: Any = None
    if first_steps < total_steps:
        # A resumed run gets fresh episodes, and other ones than the run before it began with.
        key_worlds = jax.random.fold_in(key_worlds, first_steps)
        begin = start_stepwise if isinstance(venv, StepwiseEnv) else _compile
        worlds, run = begin(venv, config, arch, learner, key_worlds)
    else:
        progress.say("This run is complete; raise --num-env-steps to go on.")
    compile_seconds = time.perf_counter() - start

    def save(learner: LearnerState, seconds: float) -> None:
        if folder:
            meta = {
                "belongs": belongs,
                "curve": curve,
                "seconds": seconds_before + seconds,
                "config": dataclasses.asdict(config),
            }
            save_checkpoint(folder.checkpoints, learner, meta)
            save_policy(folder.policy, policy_of(learner, arch, info))

    progress.start(first_steps, total_steps)
    length = jnp.float32(total_steps)
    start = last_save = time.perf_counter()
    env_steps, nan_steps, since_save, interrupted = first_steps, 0, 0, False
    saved_at = first_steps
    try:
        while env_steps < total_steps and not interrupted:
            count = min(config.log_interval, math.ceil((total_steps - env_steps) / batch))
            began = time.perf_counter()
            next_learner, worlds, totals = run(learner, worlds, jnp.int32(count), length)
            totals = jax.device_get(totals)
            now = time.perf_counter()
            row = make_row(totals, count, count * batch, env.episode_length)
            nan_steps += int(row["nan"])
            row |= {
                "env_steps": env_steps + count * batch,
                "seconds": seconds_before + now - start,
                "steps_per_second": count * batch / (now - began),
                "nan_total": nan_steps,
            }
            check_row(row, env.name, config.num_processes)
            learner, env_steps = next_learner, env_steps + count * batch
            curve.append(row)
            if folder:
                folder.add_row(row)
            progress.update(row)
            since_save += count
            due = since_save >= config.save_interval or now - last_save > SAVE_PERIOD
            if on_log and on_log(row, lambda kept=learner: policy_of(kept, arch, info)):
                interrupted = env_steps < total_steps
            if due or interrupted or env_steps >= total_steps:
                save(learner, now - start)
                saved_at, since_save, last_save = env_steps, 0, time.perf_counter()
    except KeyboardInterrupt:
        interrupted = True
        if env_steps > saved_at:
            save(learner, time.perf_counter() - start)
    finally:
        progress.stop()
    train_seconds = time.perf_counter() - start
    policy = policy_of(learner, arch, info)
    if folder:
        save_policy(folder.policy, policy)
        folder.draw(curve, f"{env.name}, PPO, seed {config.seed}")
    return TrainResult(
        policy=policy,
        learner=learner,
        config=config,
        curve=curve,
        env_steps=env_steps,
        session_steps=env_steps - first_steps,
        compile_seconds=compile_seconds,
        train_seconds=train_seconds,
        nan_steps=nan_steps,
        interrupted=interrupted,
        folder=folder.path if folder else None,
    )


def _compile(
    venv: Any, config: PPOConfig, arch: Architecture, learner: LearnerState, key: jax.Array
) -> tuple[Worlds, Callable]:
    """Worlds at their start and the compiled function for many updates."""
    with jax.default_matmul_precision("highest"):  # TF32 hurts; ``main`` sets it for all else
        reset = jax.jit(lambda key: first_worlds(venv, key, config.stagger)).lower(key).compile()
        worlds = reset(key)
        run = jax.jit(make_updates(venv, config, arch))
        run = run.lower(learner, worlds, jnp.int32(1), jnp.float32(1)).compile()
        return jax.block_until_ready(worlds), run


def _say_resumed(
    progress: Progress, meta: Mapping[str, Any], config: PPOConfig, steps: int
) -> None:
    """Tell where a run goes on, and which settings differ from before."""
    progress.say(f"Continuing from step {steps:,} with fresh episodes (--fresh starts over).")
    ours, theirs = dataclasses.asdict(config), meta.get("config", {})
    same = ("save_dir", "fresh", "log_interval", "save_interval")
    for name, value in ours.items():
        value = list(value) if isinstance(value, tuple) else value
        if name not in same and name in theirs and theirs[name] != value:
            progress.say(f"  {name} is now {value!r}; it was {theirs[name]!r}.")


def _on_terminate(*_: Any) -> None:
    raise KeyboardInterrupt


def main(arguments: Sequence[str] | None = None, make: Callable[[str, str], Any] = make_env) -> int:
    """The command line; returns the exit status."""
    words = sys.argv[1:] if arguments is None else list(arguments)
    jax.config.update("jax_default_matmul_precision", "highest")  # TF32 hurts small networks
    try:
        config = parse_arguments(words)
        signal.signal(signal.SIGTERM, _on_terminate)
        if config.save_dir is not None:  # before the environment is built, which takes seconds
            check_writable(Path(config.save_dir))
        env = make(config.env_name, config.impl)
        result = train(env, config, for_terminal())
    except AgymError as error:
        print(f"{type(error).__name__}: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("Stopped before training began.", file=sys.stderr)
        return 130
    print(summary(result))
    if result.interrupted:
        print("Rerun the same command to continue.")
        return 130
    return 0


if __name__ == "__main__":
    sys.exit(main())
