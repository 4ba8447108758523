"""Assistive Gym in JAX and MuJoCo MJX: simulated robots that assist people.

>>> import agym_jax
>>> env = agym_jax.make("ScratchItchJaco-v0")
>>> state = env.reset(jax.random.key(0))
>>> state = env.step(state, jnp.zeros(env.action_size))

Importing the package imports neither JAX nor a task: each is loaded when it is first needed.
"""

from __future__ import annotations

from agym_jax.interrupts import is_program, leave_quietly

if is_program():  # Gymnasium and NumPy take a while, and an interrupt in them says nothing
    leave_quietly()

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
) -> Env:
    """Build an environment.

    Args:
        name: its id, such as ``"ScratchItchJaco-v0"``; ``list_envs()`` has them all.
        impl: physics: MJX in ``"jax"`` (anywhere) or ``"warp"`` (NVIDIA GPUs), ``"auto"`` for the one that
            fits, or ``"native"``: C MuJoCo on the CPU, alone or in batches (``wrappers.vectorize``), not to be jitted or vmapped.
        humans: an ``agym_jax.Population``, if not Assistive Gym's men and women.
        num_envs: how many environments will be stepped together; sizes Warp's buffers.
            ``agym_jax.wrappers.vectorize`` sets it for you.
        config: weights and thresholds of the task that are other than its own, such as ``{"scratch": 3.0,
            "preferences": {"velocity": 0.5}}``; ``agym-jax settings ID`` prints what there is.
        episode_length: control steps of an episode, if not the task's 200.
        robot: an ``agym_jax.RobotVariation``: ranges of friction, strength of motors, latency and noise of sensors, from which
            every episode draws; None for a robot that is always the same.

    Raises:
        UnknownNameError: there is no such id or setting; the message has the nearest.
        ImplementationError: Warp was asked for and is not installed.
        ArgumentError: a setting, length, population or variation that makes no sense.
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
    return AssistiveEnv(task, recipe.robot, recipe.active, impl, humans, num_envs, robot)


def load_policy(source: str | Path, env: Env | None = None) -> Policy | Pair:
    """Load a policy: a function ``policy(obs) -> action``, for one observation or a batch.

    Args:
        source: an environment id, whose shipped policy is meant: the robot's, or for ``...Human-v0``
            the pair of robot and person; or the path of a policy file or of a training run's folder.
        env: environment that it must fit; its people and length of episodes may be others than in training. None skips
            that check.

    Raises:
        PolicyNotFoundError: there is none; the message has the nearest, and how to train one.
        PolicyDamagedError: the file is not whole, or no policy.
        PolicyEnvironmentError: it was trained for another task, robot or agent than ``env``'s, or with other weights,
            thresholds or variations of the robot.
        PolicyLayoutError: it reads another observation than ``env``'s.
    """
    from agym_jax.policy import load_policy as load

    return load(source, env)


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
    if name == "Population":
        from agym_jax.human.population import Population

        return Population
    if name == "RobotVariation":
        from agym_jax.variation import RobotVariation

        return RobotVariation
    raise AttributeError(f"module 'agym_jax' has no attribute {name!r}")


def register_envs() -> None:
    """Make every id known to gymnasium's ``make`` and ``make_vec``.

    They build ``agym_jax.adapters.gymnasium.GymnasiumEnv`` and ``agym_jax.adapters.vector.GymnasiumVectorEnv``.
    Done on import, by name only: Gymnasium 1.0 dropped the entry point of plug-ins, and finds ids of
    packages that have been imported. Do it again after ``agym_jax.registry`` was given a task or robot.
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
