"""The same episodes on several implementations of the physics: do the policies that ship do the same?

    python -m benchmarks.implementations --only Jaco-v0 --json benchmarks/results/implementations.jsonl

People, starts and everything else that is drawn are the same; each implementation shows the policy its own observations. Floating-point
errors of 1e-7 grow where contacts make and break, so that single episodes may end otherwise; rates of success may not.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import jax
import numpy as np
import tyro
from rich.progress import track

from agym_jax.errors import ArgumentError
from agym_jax.flags import Count
from agym_jax.policy.files import find_policies, load_policies
from agym_jax.wrappers import vectorize
from benchmarks.keep import ShippedConfig, keep_of_shipped
from benchmarks.physics_tables import STEPS_COMPARED
from train.envs import make_env


@dataclass(frozen=True)
class ImplementationsConfig(ShippedConfig):
    """Flags of ``python -m benchmarks.implementations``."""

    num_episodes: Count = 32
    """Episodes of each policy."""
    impls: tuple[Literal["native", "jax", "warp"], ...] = ("native", "jax")
    """Implementations; the others are compared with the first."""
    seed: int = 0
    """Of the episodes."""


@dataclass(frozen=True)
class Played:
    """What became of N episodes."""

    success: np.ndarray  # bool (N,)
    returns: np.ndarray  # (N,)
    angles: np.ndarray  # of all joints, after each of STEPS_COMPARED [rad]    (times, N, joints)


def play(env_name: str, impl: str, config: ImplementationsConfig) -> Played:
    """Play the episodes on one implementation.

    Raises:
        AgymError: there is no such environment or implementation, or no policy that fits.
    """
    env = make_env(env_name, impl)
    policy = load_policies(find_policies(env_name), env)
    batch = vectorize(env, config.num_episodes)
    reset, step = batch.reset, batch.step
    if impl != "native":
        reset, step = jax.jit(reset), jax.jit(step)
    state = reset(jax.random.PRNGKey(config.seed))
    returns, angles = np.zeros(config.num_episodes), []
    for count in track(range(1, env.episode_length + 1), f"{env_name}, {impl}"):
        state = step(state, policy(state.obs))
        returns += np.asarray(state.reward)
        if count in STEPS_COMPARED:
            angles.append(np.array(state.data.qpos))
    return Played(np.asarray(state.metrics["success"]) > 0, returns, np.stack(angles))


def compare(first: Played, other: Played) -> dict[str, Any]:
    """How far one implementation is from another: of an episode, the joint that is farthest off."""
    off = np.abs(first.angles - other.angles).max(-1)
    return {
        "success": int(other.success.sum()),
        "same_outcome": int((first.success == other.success).sum()),
        "return": float(other.returns.mean()),
        "off_median": [float(x) for x in np.median(off, 1)],
        "off_largest": [float(x) for x in off.max(1)],
    }


def measure(env_name: str, config: ImplementationsConfig) -> dict[str, Any]:
    """The fields of a result.

    Raises:
        AgymError: there is nothing to compare, no such environment or implementation, or no policy that fits.
    """
    if len(set(config.impls)) < 2:
        raise ArgumentError(
            f"impls must name at least two implementations to compare, such as --impls native jax; got {' '.join(config.impls) or 'none'}."
        )
    played = {impl: play(env_name, impl, config) for impl in config.impls}
    first = played[config.impls[0]]
    return {
        "env": env_name,
        "episodes": config.num_episodes,
        "impl": config.impls[0],
        "success": int(first.success.sum()),
        "return": float(first.returns.mean()),
        "others": {impl: compare(first, played[impl]) for impl in config.impls[1:]},
    }


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; returns the exit status, 2 if something could not be measured."""
    config = tyro.cli(
        ImplementationsConfig, prog="python -m benchmarks.implementations", args=arguments
    )
    return keep_of_shipped(
        "implementations", config.only, lambda name: measure(name, config), config.json
    )


if __name__ == "__main__":
    sys.exit(main())
