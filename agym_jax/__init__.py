"""Robots that help humans, by the thousand: Assistive Gym in JAX and MuJoCo MJX.

>>> import agym_jax
>>> env = agym_jax.make("ScratchItchJaco-v0")
>>> state = env.reset(jax.random.key(0))
>>> state = env.step(state, jnp.zeros(env.action_size))
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from agym_jax import compilation_cache as _cache
from agym_jax.errors import AgymError

if TYPE_CHECKING:
    from agym_jax.env import AssistiveEnv as Env
    from agym_jax.state import State

__version__ = "0.1.0"
__all__ = ["AgymError", "Env", "State", "list_envs", "make", "register_envs"]

_cache.enable()


def make(name: str, impl: str = "auto", humans: Any = None, num_envs: int = 1) -> Env:
    """Build an environment.

    Args:
        name: its id, such as ``"ScratchItchJaco-v0"``; ``list_envs()`` has them all.
        impl: physics: MJX in ``"jax"`` (anywhere) or ``"warp"`` (NVIDIA GPUs), ``"auto"`` for the one that
            fits, or ``"native"``: C MuJoCo, for one environment on the CPU, not to be jitted or vmapped.
        humans: an ``agym_jax.human.population.Population``, if not Assistive Gym's men and women.
        num_envs: how many environments will be stepped together; sizes Warp's buffers.
            ``agym_jax.wrappers.vectorize`` sets it for you.

    Raises:
        UnknownNameError: there is no such id; the message has the nearest.
        ImplementationError: Warp was asked for and is not installed.
    """
    from agym_jax.env import AssistiveEnv
    from agym_jax.registry import parse

    recipe = parse(name)
    return AssistiveEnv(recipe.task, recipe.robot, recipe.active, impl, humans, num_envs)


def list_envs() -> list[str]:
    """Every environment id."""
    from agym_jax.registry import list_envs as ids

    return ids()


def __getattr__(name: str) -> Any:
    if name == "Env":
        from agym_jax.env import AssistiveEnv

        return AssistiveEnv
    if name == "State":
        from agym_jax.state import State

        return State
    raise AttributeError(f"module 'agym_jax' has no attribute {name!r}")


def register_envs() -> None:
    """Make every id known to gymnasium, which builds ``agym_jax.adapters.gymnasium.GymnasiumEnv``.

    Done on import; do it again after ``agym_jax.registry`` was given a task or a robot.
    """
    import gymnasium

    for name in list_envs():
        if name not in gymnasium.registry:
            gymnasium.register(
                name, "agym_jax.adapters.gymnasium:GymnasiumEnv", kwargs={"env_id": name}
            )


register_envs()
