"""Physics: what the environment asks of it, and which implementations there are.

``sim.mjx`` is MJX, in JAX or Warp; ``sim.c_mujoco`` is C MuJoCo, for CPUs. Each is imported only when it is used: MJX alone takes seconds to import.
"""

from __future__ import annotations

import importlib.util
from typing import Any, Protocol

import jax
from jax import Array

from agym_jax.errors import ImplementationError, did_you_mean
from agym_jax.sense import Motion
from agym_jax.sim.control import Controller, ControlTargets
from agym_jax.sim.scene import Scene
from agym_jax.sim.sensing import ContactSums
from agym_jax.spec import BatchedOnCpu, Task
from agym_jax.state import Episode

IMPLEMENTATIONS = ("auto", "jax", "warp", "native")


class Physics(Protocol):
    """Moves one environment; knows nothing of tasks. Its ``data`` is what ``sense`` reads."""

    traceable: bool
    """Whether JAX can trace it (``jit``, ``vmap``); if not, only what is around it is compiled, see ``sim.native_rows``."""

    def sized_for(self, num_envs: int) -> Physics:
        """The same physics with buffers for so many environments at once."""
        ...

    def make_data(self) -> Any:
        """Data of an environment in which nothing has begun."""
        ...

    def reset(self, data: Any, episode: Episode, where: Array | None = None) -> Any:
        """Everything at rest at the start of an episode, kinematics up to date.

        Args:
            data: of the environment, or ``make_data``.
            episode: of the environment.
            where: if given, only where it holds; the rest of ``data`` stays as it is ().
        """
        ...

    def step(
        self, data: Any, episode: Episode, targets: ControlTargets
    ) -> tuple[Any, ContactSums, Motion]:
        """One control step; kinematics of the result are up to date.

        Args:
            data: of the environment.
            episode: of the environment.
            targets: to the joints, the same throughout the control step.

        Returns:
            Data after the control step, sums of the contact sensors over its physics steps, and the
            way that tool and person went.
        """
        ...

    def overflow(self, data: Any) -> Array:
        """1.0 where contacts or constraints were lost because buffers were too small ()."""
        ...


def choose_impl(impl: str, traced: bool = True) -> str:
    """The physics implementation that a name stands for on this machine.

    Args:
        impl: one of ``IMPLEMENTATIONS``.
        traced: whether ``reset`` and ``step`` must be pure functions that JAX can trace (``jit``, ``vmap``). Where they
            need not be, ``"auto"`` is C MuJoCo if all that JAX has is one CPU.

    Raises:
        ImplementationError: there is no such implementation, or Warp is not installed.
    """
    if impl not in IMPLEMENTATIONS:
        raise ImplementationError(
            f"Unknown implementation {impl!r}. {did_you_mean(impl, IMPLEMENTATIONS)}"
        )
    has_warp = importlib.util.find_spec("warp") is not None
    if impl == "warp" and not has_warp:
        raise ImplementationError(
            "impl='warp' needs the package warp-lang: pip install 'agym_jax[cuda]' "
            "(or use impl='jax', which runs everywhere)."
        )
    if impl != "auto":
        return impl
    if not traced and jax.default_backend() == "cpu" and jax.device_count() == 1:
        return "native"
    return "warp" if has_warp and jax.default_backend() == "gpu" else "jax"


def build_physics(
    impl: str, scene: Scene, controller: Controller, task: Task, num_envs: int
) -> Physics:
    """The physics of a scene.

    Args:
        impl: from ``choose_impl``.
        scene: what is in the world.
        controller: of its joints.
        task: of the scene.
        num_envs: how many are stepped together; sizes Warp's buffers.
    """
    if impl == "native":
        from agym_jax.sim.c_mujoco import ROWS, NativePhysics

        rows = task.cpu_rows if isinstance(task, BatchedOnCpu) else ROWS
        return NativePhysics(scene, controller, task.control.frame_skip, rows)
    from agym_jax.sim.mjx import MjxPhysics

    return MjxPhysics(impl, scene, controller, task.control.frame_skip, num_envs)


def native_rows_of(env: Any) -> Any:
    """What resets and steps environments of C MuJoCo, made of an environment's functions."""
    from agym_jax.sim.native_rows import NativeRows

    return NativeRows.of(env)


def check_traceable(physics: Physics, *values: Any) -> None:
    """Refuse to compile what cannot be compiled.

    Raises:
        ImplementationError: ``values`` are being traced, but the physics cannot be.
    """
    if not physics.traceable and any(isinstance(value, jax.core.Tracer) for value in values):
        raise ImplementationError(
            "C MuJoCo (impl='native') cannot be traced by jax.jit or jax.vmap; its parts are already compiled. Call "
            "reset and step directly; for many environments, use those of agym_jax.wrappers.vectorize(env, "
            "num_envs). To compile a step into your own program, make the environment with impl='jax' or 'warp'."
        )
