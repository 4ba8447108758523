"""The interface between training and environments: making and batching environments, and checks of their agents."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax

from agym_jax.flags import PolicyFlags
from agym_jax.memory import MEMORY
from agym_jax.policy.check import settings_for
from agym_jax.policy.files import PolicyFiles, find_policies
from agym_jax.registry import active_id, static_id

from .errors import ActiveHumanError


def make_env(env_name: str, impl: str = "auto", **options: Any) -> Any:
    """Make an environment by its id; on a CPU, ``"auto"`` means C MuJoCo, as nothing here traces through the physics.

    Args:
        env_name: environment id.
        impl: physics.
        **options: further arguments of ``agym_jax.make``.
    """
    import agym_jax
    from agym_jax.sim.physics import choose_impl

    return agym_jax.make(env_name, impl=choose_impl(impl, traced=False), **options)


def env_and_policies(
    config: PolicyFlags, impl: str, make: Callable[..., Any]
) -> tuple[Any, PolicyFiles]:
    """Return the environment and the policies that flags name; the environment has the policy's memory if they name none.

    Args:
        config: the flags.
        impl: physics.
        make: makes environments, as ``make_env`` does.

    Raises:
        UnknownNameError: if there is no such id.
        PolicyNotFoundError: if there is no such policy.
    """
    options = config.options()
    env = make(config.env_name, impl, **options)  # first: it knows which ids there are
    given = (config.load_dir, config.policy, config.human_policy)
    files = find_policies(config.env_name, *given, memory=config.memory)
    trained = settings_for(files.robot, config.env_name)
    if MEMORY in trained and not config.memory:
        env = make(config.env_name, impl, **options, memory=trained[MEMORY])
    return env, files


def changed(env: Any) -> dict[str, Any]:
    """Return the settings that differ from the id's defaults, for a result line; empty if there are none."""
    return {"changes": env.changes} if getattr(env, "changes", None) else {}


def is_native(env: Any) -> bool:
    """Return whether an environment, or a batch, runs on C MuJoCo, whose functions are called from Python."""
    return getattr(env, "impl", None) == "native"


def vectorize(env: Any, num_envs: int) -> Any:
    """Make a batch of ``num_envs`` copies of an environment, with auto-reset.

    If the environment has its own ``vectorize(num_envs)``, that method is used.
    """
    if hasattr(env, "vectorize"):
        return env.vectorize(num_envs)
    from agym_jax import wrappers

    return wrappers.vectorize(env, num_envs)


def jit_functions(env: Any) -> tuple[Callable[..., Any], Callable[..., Any]]:
    """Return compiled ``reset`` and ``step`` of one environment, from its own ``jit_functions()`` if it has them."""
    if hasattr(env, "jit_functions"):
        return env.jit_functions()
    return jax.jit(env.reset), jax.jit(env.step)


def refuse_active_human(env: Any, allow_joint_observation: bool) -> None:
    """Reject single-agent training if the person acts too.

    Raises:
        ActiveHumanError: if more than one agent acts, and joint training was not allowed.
    """
    agents = env.action_sizes
    if len(agents) <= 1 or allow_joint_observation:
        return
    listed = " and ".join(f"{name} ({size} actions)" for name, size in agents.items())
    static = static_id(env.name)
    raise ActiveHumanError(
        f"In {env.name!r} {listed} act together. One policy for both would let the robot read the "
        f"person's observation, which no real robot can. Train the two side by side with "
        f"agym-jax coop --env-name {env.name}, train against a person who holds still with --env-name "
        f"{static}, or allow it explicitly with --allow-joint-observation."
    )


def refuse_static_human(env: Any) -> None:
    """Reject two-agent training if only the robot acts.

    Raises:
        ActiveHumanError: if so; the message says which id has two agents.
    """
    if len(env.action_sizes) < 2:
        raise ActiveHumanError(
            f"In {env.name!r} the person holds still, so there is only one agent to train: "
            f"agym-jax train --env-name {env.name}. Both act in {active_id(env.name)!r}."
        )
