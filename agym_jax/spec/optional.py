"""Optional protocols that a task may implement in addition to ``Task``; each is recognised by its methods."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

import jax


@runtime_checkable
class Privileged(Protocol):
    """Optional protocol of tasks whose future rewards depend on more than is observed."""

    @property
    def privileged_obs_size(self) -> int:
        """Length of ``privileged_obs``."""
        ...

    def privileged_obs(self, state: Any) -> jax.Array:
        """Return quantities that neither agent observes, for value functions during training only (privileged_obs_size,)."""
        ...


@dataclass(frozen=True)
class Measure:
    """A measure of a task's progress in practical units, reported in ``State.metrics`` as ``task/<name>``."""

    name: str
    unit: str  # "1" for counts and shares
    words: str  # what it is, for tables


@runtime_checkable
class Measured(Protocol):
    """Optional protocol of tasks that report their progress in more detail than success or failure."""

    @property
    def measures(self) -> tuple[Measure, ...]:
        """Measures that the task reports."""
        ...

    def measure(self, state: Any) -> dict[str, jax.Array]:
        """Return the current value () of each of ``measures``, by name and in the same order."""
        ...


@dataclass(frozen=True)
class Ending:
    """A way in which episodes fail, recognised by a measure at the end of the episode."""

    words: str  # "nothing was poured"
    measure: str  # name of a ``Measure``
    low: float = -math.inf  # the measure is at least this,
    high: float = math.inf  # and less than this


@runtime_checkable
class Diagnosed(Protocol):
    """Optional protocol of measured tasks that can tell how an episode failed."""

    @property
    def endings(self) -> tuple[Ending, ...]:
        """Ways to fail; of an episode that fails, the first one that applies counts. One of them always applies."""
        ...


@runtime_checkable
class Loaded(Protocol):
    """Optional protocol of tasks whose tool loads the arm that holds it with its weight."""

    def load(self, state: Any) -> tuple[jax.Array, jax.Array]:
        """Return the weight of the first tool with its contents [N] (), and where it acts, world [m] (3,)."""
        ...


@runtime_checkable
class Comfortable(Protocol):
    """Optional protocol of tasks whose comfort limits differ from ``human.regions.Region.comfort``."""

    @property
    def comfort(self) -> tuple[tuple[str, float], ...]:
        """Names of regions and their comfort limits [N]; regions that are not listed keep their own limit."""
        ...


@runtime_checkable
class BatchedOnCpu(Protocol):
    """Optional protocol of tasks whose functions are so large that a CPU evaluates them faster in smaller batches."""

    @property
    def cpu_rows(self) -> tuple[int, int]:
        """Environments per call with C MuJoCo, for a single environment and in a batch; see ``sim.c_mujoco.ROWS``."""
        ...


@dataclass(frozen=True)
class Surface:
    """A triangle mesh to draw, visible from both sides."""

    vertices: Any  # world [m]                                              (n, 3)
    triangles: Any  # vertices of each                                      (t, 3)
    rgba: tuple[float, float, float, float]


@runtime_checkable
class Surfaced(Protocol):
    """Optional protocol of tasks that draw more than points."""

    def surfaces(self, state: Any) -> list[Surface]:
        """Return meshes to draw; their triangles are the same in every state."""
        ...


@runtime_checkable
class Prepared(Protocol):
    """Optional protocol of tasks that must prepare data before the first episode, such as loading a mesh from a file."""

    def prepare(self) -> None:
        """Prepare the data and reject invalid data; called whenever a scene is built.

        Raises:
            AgymError: if the data is invalid; the message says what is wrong and where.
        """
        ...


@runtime_checkable
class Furnished(Protocol):
    """Optional protocol of tasks in which some of the seat's props stand in a different place in every episode."""

    def props(self, state: Any) -> dict[str, jax.Array]:
        """Return the position of each such prop by name, world [m] (3,)."""
        ...
