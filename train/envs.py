"""The few things that training asks of an environment: environments, and who sees and moves what."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import jax

from .errors import ActiveHumanError


def make_env(env_name: str, impl: str = "auto") -> Any:
    """An environment by its id."""
    import agym_jax

    return agym_jax.make(env_name, impl=impl)


def vectorize(env: Any, num_envs: int) -> Any:
    """``num_envs`` auto-resetting environments of an environment.

    An environment that has a ``vectorize(num_envs)`` of its own is asked itself.
    """
    if hasattr(env, "vectorize"):
        return env.vectorize(num_envs)
    from agym_jax import wrappers

    return wrappers.vectorize(env, num_envs)


def programs(env: Any) -> tuple[Callable[..., Any], Callable[..., Any]]:
    """``reset`` and ``step`` of one environment, compiled; an environment that has ``programs()`` makes them."""
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
    static = static_name(env.name)
    raise ActiveHumanError(
        f"In {env.name!r} {listed} act together. One policy for both would let the robot read the "
        f"person's observation, which no real robot can. Train the two side by side with python -m "
        f"train.coop --env-name {env.name}, train against a person who holds still with --env-name "
        f"{static}, or allow it on purpose with --allow-joint-observation."
    )


def refuse_static_human(env: Any) -> None:
    """Stop two-agent training where only the robot acts.

    Raises:
        ActiveHumanError: says which id has two agents.
    """
    if len(env.action_sizes) < 2:
        raise ActiveHumanError(
            f"In {env.name!r} the person holds still, so there is only one to train: python -m "
            f"train.ppo --env-name {env.name}. Both act in {active_name(env.name)!r}."
        )


@dataclass(frozen=True)
class Part:
    """What belongs to one agent: columns of the observation and entries of the action."""

    observed: slice
    acted: slice
    layout: str  # version of its observation's layout

    @property
    def sizes(self) -> tuple[int, int]:
        """Columns of the observation, entries of the action."""
        return self.observed.stop - self.observed.start, self.acted.stop - self.acted.start


def parts(env: Any) -> dict[str, Part]:
    """What belongs to "robot" and "person", and to "joint", which is both at once.

    Where only the robot acts, all is the robot's.
    """
    n, m = env.observation_size, env.action_size
    whole = Part(slice(0, n), slice(0, m), env.layout_version)
    if len(env.action_sizes) < 2:
        return {"robot": whole}
    from agym_jax import observe

    seen, moved = env.observation_sizes["robot"], env.action_sizes["robot"]
    robot, human = (observe.layout_version(r) for r in (env.task.robot_obs, env.task.human_obs))
    return {
        "robot": Part(slice(0, seen), slice(0, moved), robot),
        "human": Part(slice(seen, n), slice(moved, m), human),
        "joint": whole,
    }


def static_name(env_name: str) -> str:
    """The id of the same task and robot with a person who holds still."""
    return env_name.replace("Human-", "-")


def active_name(env_name: str) -> str:
    """The id of the same task and robot with a person who acts."""
    stem, _, version = static_name(env_name).rpartition("-")
    return f"{stem}Human-{version}"
