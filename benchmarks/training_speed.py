"""Environment steps per second of training: one learner or two, on one device or several, one seed or several side by side.

    python -m benchmarks.training_speed --env-name FeedingJacoHuman-v0 --learners 1 2 --devices 1 2
    python -m benchmarks.training_speed --env-name ScratchItchJaco-v0 --learners 1 --num-seeds 8

One learner is a policy that sees and moves robot and person together (``train.ppo --allow-joint-observation``).
Every device has as many environments. Compiling does not count.
"""

from __future__ import annotations

import dataclasses
import statistics
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import jax
import tyro

from benchmarks.keep import keep
from train import coop, ppo
from train.configs import (
    Config,
    CoopConfig,
    Count,
    LearnConfig,
    PPOConfig,
    config_for,
    resolve,
)
from train.envs import make_env
from train.runs.progress import for_terminal
from train.task_changes import NO_SEARCH

CALLS = 10
"""Calls of the compiled training in one measurement, after a first one that does not count."""


@dataclass(frozen=True)
class TrainingSpeedConfig:
    """Flags of ``python -m benchmarks.training_speed``."""

    env_name: str = "FeedingJacoHuman-v0"
    """Environment id; with two learners, one whose person acts too."""
    learners: tuple[Literal[1, 2], ...] = (1, 2)
    """How many policies learn."""
    devices: tuple[int, ...] = (1,)
    """How many devices share the work."""
    num_envs: Count = 0
    """Environments of each seed on each device; 0 = as many as training takes."""
    num_seeds: Count = 1
    """Seeds that learn side by side; their steps count together."""
    gradient_precision: Literal["float32", "tensorfloat32"] = LearnConfig.gradient_precision
    """Of matrix products in gradients, see ``agym-jax train --help``."""
    updates: Count = 20
    """In one measurement, rounded up to whole calls."""
    impl: str = "auto"
    """Physics: "jax", "warp", "auto"."""
    json: Path | None = None
    """File to which each result is added as a JSON line."""


def measure(config: TrainingSpeedConfig, learners: int, devices: int) -> dict[str, Any]:
    """Train for a while; returns the fields of the result line."""
    env = make_env(config.env_name, config.impl)
    platform = jax.default_backend()
    if learners == 2:
        both = config_for(env.name, CoopConfig, platform)
        result = coop.train(env, _settings(both, config, devices), for_terminal())
    else:
        joint = config_for(env.name, PPOConfig, platform)
        joint = dataclasses.replace(joint, allow_joint_observation=True)
        result = ppo.train(env, _settings(joint, config, devices), for_terminal())
    speeds = [row["steps_per_second"] for row in result.curve[1:]]
    usual = config.gradient_precision == LearnConfig.gradient_precision
    return {
        "env": env.name,
        "impl": env.impl,
        "learners": learners,
        "devices": devices,
        "num_envs": result.config.num_envs,
        "num_seeds": config.num_seeds,
        "steps": result.env_steps * config.num_seeds,
        "steps_per_s": round(statistics.median(speeds)),
        "steps_per_s_min": round(min(speeds)),
        "steps_per_s_max": round(max(speeds)),
        "nan": result.nan_steps,
        "gradient_precision": config.gradient_precision,
        "changes": {} if usual else {"gradient_precision": config.gradient_precision},
    }


def _settings(settings: Config, config: TrainingSpeedConfig, devices: int) -> Config:
    """Those of a short training on several devices that writes nothing."""
    settings = dataclasses.replace(settings, num_envs=config.num_envs or settings.num_envs)
    num_envs = devices * resolve(settings, jax.default_backend()).num_envs
    each = -(-config.updates // CALLS)
    return dataclasses.replace(
        settings,
        num_envs=num_envs,
        num_env_steps=(CALLS + 1) * each * num_envs * settings.num_steps,
        log_interval=each,
        gradient_precision=config.gradient_precision,
        devices=devices,
        num_seeds=config.num_seeds,
        save_dir=None,
        **NO_SEARCH,
    )


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; returns the exit status."""
    config = tyro.cli(
        TrainingSpeedConfig, prog="python -m benchmarks.training_speed", args=arguments
    )
    wanted = [(learners, devices) for learners in config.learners for devices in config.devices]
    done = [
        keep("training-speed", lambda pair=pair: measure(config, *pair), config.json)
        for pair in wanted
    ]
    return 2 if None in done else 0


if __name__ == "__main__":
    sys.exit(main())
