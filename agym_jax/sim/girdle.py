"""What a seated person's arm weighs on the girdle, which bears it as ligaments do, see ``human.muscles``.

Gravity alone: MuJoCo's ``qfrc_bias`` also has what the arm's motion asks for, and a girdle that gave that too would do work on an
arm that moves fast. It would speed up until the simulation explodes.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import jax.numpy as jnp
import mujoco
import numpy as np

from agym_jax.sim.index import ancestors


class Burden(NamedTuple):
    """What hangs on the joints of a girdle."""

    mass: Any  # of each body, on each joint that bears it [kg]               (..., n, n_bodies)
    total: Any  # [kg]                                                        (..., n, 1)
    centre: Any  # of mass of each body, in its frame [m]                     (..., n_bodies, 3)


@dataclass(frozen=True, eq=False)  # has arrays in it: equal if identical
class Girdle:
    """The joints of one or both girdles, and what hangs on them.

    Attributes:
        rows: of the person's joints (n,).
        joints: the same, in the model (n,).
        bodies: of the person, that hang on any of them (n_bodies,).
        bears: whether a joint bears a body, float (n, n_bodies).
        count: of the person's joints.
        gravity: acceleration [m/s2].
    """

    rows: np.ndarray
    joints: np.ndarray
    bodies: np.ndarray
    bears: np.ndarray
    count: int
    gravity: float

    @classmethod
    def of(cls, model: mujoco.MjModel, joints: np.ndarray, names: tuple[str, ...]) -> Girdle | None:
        """Of a scene's joints of the person, which have these names; None where none of them is of a girdle."""
        rows = np.array([i for i, name in enumerate(names) if "clavicle" in name], int)
        if not len(rows):
            return None
        own = np.asarray(joints)[rows]
        above = [ancestors(model, body) for body in range(model.nbody)]
        below = np.array([[model.jnt_bodyid[j] in x for x in above] for j in own], np.float32)
        bodies = np.flatnonzero(below.any(axis=0))
        bears = below[:, bodies]
        return cls(rows, own, bodies, bears, len(names), -float(model.opt.gravity[2]))

    def weight(self, model: Any, data: Any, xp: Any = jnp) -> Any:
        """Torque that balances the weight, 0 for joints that are no girdle's [N m] (..., n_person).

        Args:
            model: ``body_mass`` (..., nbody) and ``body_ipos`` (..., nbody, 3) of this person.
            data: ``xpos``, ``xmat``, ``xanchor`` and ``xaxis`` of one moment, world.
            xp: numpy or jax.numpy.
        """
        place = np.zeros((len(self.rows), self.count), np.float32)
        place[np.arange(len(self.rows)), self.rows] = 1.0
        return self.torque(self.burden(model), data, xp) @ place

    def burden(self, model: Any) -> Burden:
        """What hangs on the joints, from ``body_mass`` and ``body_ipos`` of this person."""
        mass = self.bears * model.body_mass[..., None, self.bodies]
        return Burden(mass, mass.sum(-1)[..., None], model.body_ipos[..., self.bodies, :])

    def torque(self, burden: Burden, data: Any, xp: Any = jnp) -> Any:
        """As ``weight``, of the girdle's joints alone (..., n)."""
        bodies, joints = consecutive(self.bodies), consecutive(self.joints)
        turn = data.xmat.reshape(*data.xpos.shape, 3)[..., bodies, :2, :]
        offset = xp.einsum("...bij,...bj->...bi", turn, burden.centre)
        moment = burden.mass @ (data.xpos[..., bodies, :2] + offset)
        lever = moment - burden.total * data.xanchor[..., joints, :2]
        axis = data.xaxis[..., joints, :]
        return self.gravity * (axis[..., 0] * lever[..., 1] - axis[..., 1] * lever[..., 0])


def consecutive(ids: np.ndarray) -> Any:
    """Ids that follow each other as a slice, which NumPy need not copy."""
    first, last = int(ids[0]), int(ids[-1])
    return slice(first, last + 1) if last - first + 1 == len(ids) else ids
