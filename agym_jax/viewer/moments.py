"""What is drawn of environments at a time: joint angles, and what MuJoCo does not know (gown, food, water, targets)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import jax
import numpy as np

from agym_jax.spec import Surface, Surfaced


@dataclass(frozen=True)
class Moment:
    """Several environments at a time, side by side."""

    qpos: np.ndarray  # joint angles [rad]                                     (n, nq)
    points: tuple[np.ndarray, ...] = ()  # of ``Drawn.marks`` [m], NaN is not drawn  each (n, k, 3)
    sheets: tuple[np.ndarray, ...] = ()  # vertices of ``Drawn.surfaces`` [m]   each (n, k, 3)

    def towards(self, later: Moment, share: float) -> Moment:
        """Between this and a later one: 0 is this, 1 the later one."""
        mix = lambda a, b: a + share * (b - a)  # noqa: E731
        return Moment(*jax.tree.map(mix, *((m.qpos, m.points, m.sheets) for m in (self, later))))


@dataclass(frozen=True)
class Marks:
    """Balls of one kind."""

    radius: float  # [m]
    rgba: tuple[float, float, float, float]


class Drawn:
    """Reads moments from the states of an environment's task.

    Args:
        env: whose task it is.
        task_state: of one environment, for what stays: colours, sizes and triangles.
    """

    def __init__(self, env: Any, task_state: Any):
        task = env.task
        self.marks = tuple(
            Marks(float(radius), (float(r), float(g), float(b), float(a)))
            for _, radius, (r, g, b, a) in task.markers(task_state)
        )
        has_sheets = isinstance(task, Surfaced)
        self.surfaces: list[Surface] = task.surfaces(task_state) if has_sheets else []

        def read(state: Any) -> tuple[list[Any], list[Any]]:
            points = [x.reshape(-1, 3) for x, _, _ in task.markers(state)]
            return points, [s.vertices for s in task.surfaces(state)] if has_sheets else []

        self._read = jax.jit(jax.vmap(read))

    def moment(self, states: Any) -> Moment:
        """Of environments as they are now.

        Args:
            states: of all of them (n, ...).
        """
        points, sheets = jax.device_get(self._read(states.task))
        return Moment(np.array(states.data.qpos), tuple(points), tuple(sheets))
