"""What makes contact rough: does the robot hit, or does it press?

    python -m benchmarks.rough BedBathingJaco-v0 ScratchItchSawyer-v0
    python -m benchmarks.rough
    python -m benchmarks.rough BedBathingJaco-v0 --action-scale 0.5

Runs the policies that ship on C MuJoCo. A control step is rough where the peak force on a region of the body is
above its comfort limit. It is a *first touch* if nothing touched that region in the step before (0.1 s), otherwise the
robot *presses*. The last step of an episode does not count, neither for forces nor for what is gentle. Without ids: all robots' policies that are gentle in fewer than ``SELDOM`` of their successes.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import jax
import numpy as np
import tyro

import agym_jax
from agym_jax.flags import Count
from agym_jax.human.regions import NAMES, comfort_limits
from agym_jax.policy.policy import shipped
from agym_jax.registry import parse
from benchmarks.keep import keep
from benchmarks.shipped import recorded
from train.evaluation.evaluator import AT_ONCE, Evaluator

SELDOM = 0.6


@dataclass(frozen=True)
class RoughConfig:
    """Flags of ``python -m benchmarks.rough``."""

    ids: Annotated[tuple[str, ...], tyro.conf.Positional, tyro.conf.arg(metavar="[ID ...]")] = ()
    """Environment ids."""
    num_episodes: Count = 128
    """Of each policy; 64 run at a time."""
    action_scale: float = 1.0
    """Factor on the policy's actions; below 1, the robot moves more slowly."""
    seed: int = 5001
    """Of the episodes."""
    json: Path | None = None
    """File to which each result is added as a JSON line."""


def summary(
    peak: np.ndarray, mean: np.ndarray, comfort: np.ndarray, success: np.ndarray
) -> dict[str, Any]:
    """What the rough steps of episodes are.

    Args:
        peak: largest force in each control step on each region [N] (T, B, regions).
        mean: mean force in each control step [N] (T, B, regions).
        comfort: limits [N] (regions,).
        success: of each episode (B,) bool.

    Returns:
        ``rough_steps``, regions and steps above the limit in an episode; ``first_touch``, the share of them that are first
        touches; ``mean_below``, the share in which the mean over the step is within the limit, so that only the peak
        is above it; ``gentle``, the share of episodes that are gentle successes; ``gentle_but_first_touches``, the share that were,
        if first touches did not count; medians of the peaks of rough ``first_touch_n`` and of rough ``pressing_n`` [N];
        ``regions``, the share of the rough steps on each.
    """
    rough = peak > comfort
    before = np.concatenate([np.zeros_like(peak[:1]), peak[:-1]])
    first = rough & (before == 0)
    pressing = rough & ~first
    total = max(rough.sum(), 1)

    def gentle(x: np.ndarray) -> float:
        return float((success & ~x.any(axis=(0, 2))).mean())

    def median(x: np.ndarray) -> float | None:
        return round(float(np.median(peak[x])), 1) if x.any() else None

    return {
        "rough_steps": round(float(rough.sum() / peak.shape[1]), 2),
        "first_touch": round(float(first.sum() / total), 3),
        "mean_below": round(float((rough & (mean <= comfort)).sum() / total), 3),
        "gentle": gentle(rough),
        "gentle_but_first_touches": gentle(pressing),
        "first_touch_n": median(first),
        "pressing_n": median(pressing),
        "regions": {
            name: round(float(rough[..., i].sum() / total), 3)
            for i, name in enumerate(NAMES[: rough.shape[-1]])
            if rough[..., i].any()
        },
    }


def measure(env_name: str, config: RoughConfig) -> dict[str, Any]:
    """Run the episodes of one policy; returns the fields of the result line.

    Raises:
        AgymError: there is no such environment, or no policy for it.
    """
    env = agym_jax.make(env_name, impl="native")
    policy = agym_jax.load_policy(env_name, env)
    seen: list[tuple[np.ndarray, ...]] = []

    def watch(state: Any) -> None:
        forces = (state.regions.peak, state.regions.mean, state.metrics["success"])
        seen.append(tuple(np.asarray(x) for x in forces))

    def act(obs: Any, key: Any, deterministic: bool) -> Any:
        return config.action_scale * policy(obs, key, deterministic)

    result = Evaluator(env, config.num_episodes, AT_ONCE)(
        act, jax.random.PRNGKey(config.seed), watch=watch
    )
    steps = (
        env.episode_length + 1
    )  # of a batch: one before the first step, and the last is of the next episode
    batches = [seen[i : i + steps - 1] for i in range(0, len(seen), steps)]
    peak, mean, success = (
        np.concatenate([np.stack([x[i] for x in batch]) for batch in batches], axis=1)
        for i in range(3)
    )
    found = summary(peak, mean, comfort_limits(env.task), success[-1] > 0)
    return {
        "env": env.name,
        "impl": env.impl,
        "episodes": peak.shape[1],
        "seed": config.seed,
        "action_scale": config.action_scale,
        "success": float(np.mean(result.successes)),
        **found,
    }


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; returns the exit status."""
    config = tyro.cli(RoughConfig, prog="python -m benchmarks.rough", args=arguments)
    jax.config.update("jax_platforms", "cpu")
    known = recorded()
    ids = config.ids or [
        name
        for name in shipped()
        if not parse(name).active
        and known[name]["gentle_success"] < SELDOM * known[name]["success"]
    ]
    failed = 0
    for name in ids:
        failed += keep("rough", lambda name=name: measure(name, config), config.json) is None
    return 2 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
