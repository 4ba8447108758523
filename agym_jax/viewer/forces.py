"""Forces of contacts as the physics computes them, one mean over a control step for each pair of geoms that touch."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np

from agym_jax.viewer.picture import Forces

PERSON = "human/"
FAINT = 0.05  # what is not drawn [N]


class ContactForces:
    """Watches the physics of a single environment (``sim.c_mujoco.Watcher``).

    Attributes:
        forces: of the last control step.
    """

    def __init__(self) -> None:
        self.forces: Forces | None = None
        self._begin()

    def _begin(self) -> None:
        self._sums: dict[tuple[int, int], list[np.ndarray]] = {}
        self._steps = 0
        self._model: Any = None

    def before(self, data: mujoco.MjData, load: np.ndarray) -> None:
        """Nothing is needed of what was before."""

    def after(self, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        """Add up the forces of a physics step."""
        self._steps, self._model, wrench = self._steps + 1, model, np.zeros(6)
        for i in range(data.ncon):
            contact = data.contact[i]
            mujoco.mj_contactForce(model, data, i, wrench)
            size = float(np.linalg.norm(wrench[:3]))
            if size <= 0.0:
                continue
            pair = (int(contact.geom[0]), int(contact.geom[1]))
            force = contact.frame.reshape(3, 3).T @ wrench[:3]  # on the second geom
            sums = self._sums.setdefault(pair, [np.zeros(3), np.zeros(3), np.zeros(1)])
            for total, value in zip(sums, (force, size * contact.pos, size), strict=True):
                total += value

    def finish(self) -> None:
        """A control step is over."""
        points, vectors, on_person = [], [], []
        for (first, second), (force, point, size) in self._sums.items():
            mean = force / max(1, self._steps)
            if np.linalg.norm(mean) < FAINT:
                continue
            names = [self._model.geom(g).name for g in (first, second)]
            person = [name.startswith(PERSON) for name in names]
            points.append(point / size)
            vectors.append(-mean if person[0] and not person[1] else mean)  # on the person, if any
            other = names[1] if person[0] else names[0]
            on_person.append(any(person) and not other.startswith(("seat/", PERSON)))
        self.forces = Forces(
            np.array(points).reshape(-1, 3), np.array(vectors).reshape(-1, 3), np.array(on_person, bool)
        )  # fmt: skip
        self._begin()
