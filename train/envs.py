"""The few things that training asks of an environment, and the refusal of two-agent ones."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax

from train.errors import ActiveHumanError


def make_env(env_name: str, impl: str = "auto") -> Any:
    """An environment by its id."""
    import agym_jax

    return agym_jax.make(env_name, impl=impl)


def vectorize(env: Any, num_envs: int) -> Any:
    """``num_envs`` auto-resetting worlds of an environment.

    An environment that has a ``vectorize(num_envs)`` of its own is asked itself.
    """
    if hasattr(env, "vectorize"):
        return env.vectorize(num_envs)
    from agym_jax import wrappers

    return wrappers.vectorize(env, num_envs)


def programs(env: Any) -> tuple[Callable[..., Any], Callable[..., Any]]:
    """``reset`` and ``step`` of one world, compiled; an environment that has ``programs()`` makes them."""
    if hasattr(env, "programs"):
        return env.programs()
    return jax.jit(env.reset), jax.jit(env.step)


def refuse_active_human(env: Any, allow_joint_observation: bool) -> None:
    """Stop single-agent training where the person acts too.

    Raises:
        ActiveHumanError: more than one agent acts, and it was not allowed.
    """
    agents = env.action_sizes
    if len(agents) <= 1 or allow_joint_observation:
        return
    listed = " and ".join(f"{name} ({size} actions)" for name, size in agents.items())
    static = env.name.replace("Human-", "-")
    raise ActiveHumanError(
        f"In {env.name!r} {listed} act together. One policy for both would let the robot read the "
        f"person's observation, which no real robot can. Train the two side by side with "
        f"train.coop, train against a person who holds still with --env-name {static}, or allow "
        f"it on purpose with --allow-joint-observation."
    )
