"""Assistive Gym in JAX and MuJoCo MJX: simulated robots that assist people.

>>> import agym_jax
>>> env = agym_jax.make("ScratchItchJaco-v0")
>>> state = env.reset(jax.random.key(0))
>>> state = env.step(state, jnp.zeros(env.action_size))

Importing the package does not import JAX or any task: each is loaded on first use.
"""

from __future__ import annotations

from agym_jax.interrupts import is_program, leave_quietly

if is_program():  # Gymnasium and NumPy take a while, and an interrupt in them says nothing
    leave_quietly()

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from agym_jax.errors import AgymError

if TYPE_CHECKING:
    from agym_jax.env import AssistiveEnv as Env
    from agym_jax.human.population import Population
    from agym_jax.policy import Pair, Policy
    from agym_jax.state import State
    from agym_jax.variation import RobotVariation

__version__ = "0.1.0"
__all__ = [
    "AgymError",
    "Env",
    "Population",
    "RobotVariation",
    "State",
    "list_envs",
    "load_policy",
    "make",
    "register_envs",
]


def make(
    name: str,
    impl: str = "auto",
    humans: Any = None,
    num_envs: int = 1,
    *,
    config: Any = None,
    episode_length: int | None = None,
    robot: RobotVariation | None = None,
    memory: Sequence[float] | None = None,
) -> Env:
    """Build an environment.

    Args:
        name: environment id, such as ``"ScratchItchJaco-v0"``; ``list_envs()`` returns all of them.
        impl: physics implementation: ``"jax"`` (MJX, any device), ``"warp"`` (MJX, NVIDIA GPUs), ``"auto"`` to
            choose between these two for the device, or ``"native"`` (C MuJoCo on the CPU; steps one environment or a
            batch with ``wrappers.vectorize``, but cannot be jitted or vmapped).
        humans: an ``agym_jax.Population``; defaults to Assistive Gym's men and women.
        num_envs: number of environments that will be stepped together; determines the size of Warp's buffers.
            ``agym_jax.wrappers.vectorize`` sets it for you.
        config: task weights and thresholds to override, such as ``{"scratch": 3.0,
            "preferences": {"velocity": 0.5}}``; ``agym-jax settings ID`` prints what can be set.
        episode_length: control steps per episode; defaults to the task's own length of 200.
        robot: an ``agym_jax.RobotVariation``: the ranges of friction, motor strength, latency and sensor noise from
            which every episode draws; None for a robot that does not vary.
        memory: time constants [s] of running averages that are appended to each agent's observation, such as ``(0.3, 4.0)``,
            see ``agym_jax.memory``; None for Assistive Gym's observation, which shows the present only.

    Raises:
        UnknownNameError: if there is no such id or setting; the message suggests the closest match.
        ImplementationError: if Warp was requested but is not installed.
        ArgumentError: if a setting, the length, the population, the variation or the memory is invalid.
    """
    from agym_jax.changes import change_task
    from agym_jax.env import AssistiveEnv
    from agym_jax.jax_settings import enable_compilation_cache, run_inline
    from agym_jax.registry import parse

    enable_compilation_cache()
    if impl == "native":
        run_inline()
    recipe = parse(name)
    task = change_task(recipe.task, config, episode_length)
    return AssistiveEnv(task, recipe.robot, recipe.active, impl, humans, num_envs, robot, memory)


def load_policy(source: str | Path, env: Env | None = None) -> Policy | Pair:
    """Load a policy: a function ``policy(obs) -> action`` for one observation or a batch.

    Args:
        source: an environment id, to load the policy shipped for it (the robot's policy, or for ``...Human-v0`` the
            pair of robot and person; if ``env`` has a memory, one that has it too); or the path of a policy file or of a
            training run's folder.
        env: environment that the policy must fit; its population and episode length may differ from those used in
            training. None skips this check.

    Raises:
        PolicyNotFoundError: if there is no such policy; the message suggests the closest match and how to train one.
        PolicyDamagedError: if the file is damaged or is not a policy.
        PolicyEnvironmentError: if the policy was trained for another task, robot or agent than ``env``'s, or with
            different weights, thresholds, robot variation or memory.
        PolicyLayoutError: if the policy expects a different observation from ``env``'s.
    """
    from agym_jax.policy import load_policy as load

    return load(source, env)


def list_envs() -> list[str]:
    """Return every environment id."""
    from agym_jax.registry import list_envs as ids

    return ids()


def __getattr__(name: str) -> Any:
    if name == "Env":
        from agym_jax.env import AssistiveEnv

        return AssistiveEnv
    if name == "State":
        from agym_jax.state import State

        return State
    if name == "Population":
        from agym_jax.human.population import Population

        return Population
    if name == "RobotVariation":
        from agym_jax.variation import RobotVariation

        return RobotVariation
    raise AttributeError(f"module 'agym_jax' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*__all__, "__version__"})


def register_envs() -> None:
    """Register every id with Gymnasium's ``make`` and ``make_vec``.

    They build ``agym_jax.adapters.gymnasium.GymnasiumEnv`` and ``agym_jax.adapters.vector.GymnasiumVectorEnv``.
    This runs when the package is imported and registers names only: Gymnasium 1.0 dropped its plug-in entry point and
    knows only the ids of packages that have been imported. Call it again after adding a task or robot to
    ``agym_jax.registry``.
    """
    import gymnasium

    for name in list_envs():
        if name not in gymnasium.registry:
            gymnasium.register(
                name,
                "agym_jax.adapters.gymnasium:GymnasiumEnv",
                vector_entry_point="agym_jax.adapters.vector:GymnasiumVectorEnv",
                kwargs={"env_id": name},
            )


register_envs()
