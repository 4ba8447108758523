"""What a task may have besides ``Task``: each protocol is recognised by its methods."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

import jax


@runtime_checkable
class Privileged(Protocol):
    """What a task has besides if rewards to come depend on more than is observed."""

    @property
    def privileged_obs_size(self) -> int:
        """Entries of ``privileged_obs``."""
        ...

    def privileged_obs(self, state: Any) -> jax.Array:
        """What nobody observes; for value functions, in training only (privileged_obs_size,)."""
        ...


@dataclass(frozen=True)
class Measure:
    """A number of a task in the units of care, in ``State.metrics`` under ``task/<name>``."""

    name: str
    unit: str  # "1" for counts and shares
    words: str  # what it is, for tables


@runtime_checkable
class Measured(Protocol):
    """What a task has besides if it tells more of how it goes than whether it is done."""

    @property
    def measures(self) -> tuple[Measure, ...]:
        """What it tells."""
        ...

    def measure(self, state: Any) -> dict[str, jax.Array]:
        """Name of each of ``measures``, in their order -> its value now ()."""
        ...


@runtime_checkable
class Loaded(Protocol):
    """What a task has besides if its tool weighs on the arm that holds it."""

    def load(self, state: Any) -> tuple[jax.Array, jax.Array]:
        """Weight of the first tool and what is in it [N] (), and where it acts, world [m] (3,)."""
        ...


@runtime_checkable
class Comfortable(Protocol):
    """What a task has besides if other forces than ``human.regions.Region.comfort`` are comfortable in it."""

    @property
    def comfort(self) -> tuple[tuple[str, float], ...]:
        """Names of regions and their comfort limits [N]; those that are left out have the region's own."""
        ...


@runtime_checkable
class BatchedOnCpu(Protocol):
    """What a task has besides if its functions are so large that a CPU runs smaller batches of them faster."""

    @property
    def cpu_rows(self) -> tuple[int, int]:
        """Environments that C MuJoCo runs in one call of them: alone, and of a batch; see ``sim.c_mujoco.ROWS``."""
        ...


@dataclass(frozen=True)
class Surface:
    """A triangle mesh to draw, seen from both sides."""

    vertices: Any  # world [m]                                              (n, 3)
    triangles: Any  # vertices of each                                      (t, 3)
    rgba: tuple[float, float, float, float]


@runtime_checkable
class Surfaced(Protocol):
    """What a task has besides if it draws more than points."""

    def surfaces(self, state: Any) -> list[Surface]:
        """Meshes to draw; their triangles are the same in every state."""
        ...


@runtime_checkable
class Prepared(Protocol):
    """What a task has besides if it makes something of its data before the first episode: a mesh of a file."""

    def prepare(self) -> None:
        """Make it, and refuse data that it cannot be made of; called whenever a scene is built.

        Raises:
            AgymError: says what is wrong where.
        """
        ...


@runtime_checkable
class Furnished(Protocol):
    """What a task has besides if some of its seat's props stand elsewhere in every episode."""

    def props(self, state: Any) -> dict[str, jax.Array]:
        """Name of a prop -> where it stands, world [m] (3,)."""
        ...
