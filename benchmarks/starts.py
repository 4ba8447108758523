"""Does success depend on the pose in which the robot's arm begins?

    python -m benchmarks.starts --only DrinkingBaxter --num-episodes 512 --json benchmarks/results/starts.jsonl

Inverse kinematics finds several families of start poses, as in Assistive Gym, some of them seldom. Plays episodes of a shipped policy on C MuJoCo and
counts successes by family: a policy can solve all but a rare one, and look as if it failed everywhere a little. ``--robot.rare-starts`` trains with
more episodes from rare poses.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import jax
import numpy as np
import tyro

from agym_jax.data.banks import load_bank
from agym_jax.flags import Count
from agym_jax.policy.files import find_policies, load_policies
from agym_jax.sim.starts import ALIKE, apart
from benchmarks.keep import ShippedConfig, keep_of_shipped
from train.envs import make_env
from train.evaluation.evaluator import AT_ONCE, Evaluator


@dataclass(frozen=True)
class StartsConfig(ShippedConfig):
    """Flags of ``python -m benchmarks.starts``."""

    num_episodes: Count = 512
    """Episodes of each."""
    seed: int = 5001
    """Of the episodes."""


def families(angles: np.ndarray) -> np.ndarray:
    """Rows in the middle of each family: the pose that most others are like, and so on with those that are left (F,).

    Args:
        angles: of the arm [rad] (K, n_arm).
    """
    alike = apart(angles, angles) < ALIKE
    left, found = np.ones(len(angles), bool), []
    while left.any():
        middle = int(np.argmax(np.where(left, (alike & left).sum(axis=1), 0)))
        found.append(middle)
        left &= ~alike[middle]
    return np.array(found)


def measure(env_name: str, config: StartsConfig) -> dict[str, Any]:
    """The fields of a result: for each family its middle, episodes, successes and gentle successes.

    Raises:
        AgymError: there is no such environment, or no policy that fits it.
    """
    env = make_env(env_name, "native")
    policy = load_policies(find_policies(env_name), env)
    begun: list[np.ndarray] = []
    seen = 0

    def watch(state: Any) -> None:  # before the first step of a batch, and after each
        nonlocal seen
        if seen % (env.episode_length + 1) == 0:
            begun.append(np.asarray(state.episode.placement.arm_angles))
        seen += 1

    key = jax.random.PRNGKey(config.seed)
    result = Evaluator(env, config.num_episodes, AT_ONCE)(policy, key, watch=watch)
    bank = np.asarray(load_bank(env.task, env.robot).arm_angles)
    middles = bank[families(bank)]
    of = apart(np.concatenate(begun), middles).argmin(axis=1)
    gentle = result.gentle_successes
    found: list[dict[str, Any]] = []
    for family, middle in enumerate(middles):
        here = of == family
        if here.any():
            found.append(
                {
                    "middle": [round(float(x), 2) for x in middle],
                    "episodes": int(here.sum()),
                    "successes": int(result.successes[here].sum()),
                    "gentle_successes": None if gentle is None else int(gentle[here].sum()),
                }
            )
    return {
        "env": env_name,
        "impl": env.impl,
        "episodes": config.num_episodes,
        "seed": config.seed,
        "success": result.success,
        "alike": ALIKE,
        "families": sorted(found, key=lambda x: -x["episodes"]),
    }


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; returns the exit status, 2 if something could not be measured."""
    config = tyro.cli(StartsConfig, prog="python -m benchmarks.starts", args=arguments)
    return keep_of_shipped("starts", config.only, lambda name: measure(name, config), config.json)


if __name__ == "__main__":
    sys.exit(main())
