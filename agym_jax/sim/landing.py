"""A limp arm with AG's masses stops at the surface of the bed, as Bullet's contacts let it.

MuJoCo knows a contact once two shapes overlap, so a limb that falls at 1.7 m/s is up to 3 cm inside the bed before
anything stops it. Bullet sees what is within 2 cm of touching and lets it come as far as the surface in the physics step
(btMultiBodyConstraintSolver: the velocity along the normal is at least ``-distance / time step``). That law is
applied here to the velocities that MuJoCo's step has found, with friction of the same impulse: distances, normals and Jacobians
are those at the beginning of the step, as in Bullet. What lies on the bed already is MuJoCo's.

Only people of ``Population(masses="ag")`` land so, as only their arms are meant to fall as AG's do.
"""

from __future__ import annotations

import copy
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np

from agym_jax.sim.index import Index, ancestors

REACH = 0.02  # Bullet's contact breaking threshold: how far away a contact is seen [m]
RESTING = 0.001  # a contact of MuJoCo's begins so early, and holds what has landed [m]
SWEEPS = 32  # of the solver over all contacts
CAPSULE, SPHERE = mujoco.mjtGeom.mjGEOM_CAPSULE, mujoco.mjtGeom.mjGEOM_SPHERE


def hold_early(model: mujoco.MjModel, pairs: np.ndarray) -> mujoco.MjModel:
    """A copy in which contacts of limbs and bed begin ``RESTING`` above the surface."""
    model = copy.copy(model)
    model.pair_margin[pairs] = RESTING
    return model


@dataclass(frozen=True, eq=False)  # has arrays in it: equal if identical
class Landing:
    """Places of the arm that may meet the bed: ends of capsules over boxes, capsules beside capsules.

    Attributes:
        limb: geom of the person, for each place (n,).
        bed: geom of the bed (n,).
        end: which end of the limb's axis, -1 or 1, or 0 where the bed's shape is a capsule (n,).
        capsule: whether the limb is one; or a sphere (n,).
        moves: whether a joint moves the limb (n, n_person).
        friction: of the pair (n,).
        half: half sizes of the bed's shapes [m] (n, 3).
        joints: of the person, in the model (n_person,).
        pairs: of the model, that these are.
    """

    limb: np.ndarray
    bed: np.ndarray
    end: np.ndarray
    capsule: np.ndarray
    moves: np.ndarray
    friction: np.ndarray
    half: np.ndarray
    joints: np.ndarray
    pairs: np.ndarray

    @classmethod
    def of(cls, model: mujoco.MjModel, index: Index) -> Landing | None:
        """Of a scene; none where nothing of the person may fall onto a bed."""
        name = [model.geom(g).name for g in range(model.ngeom)]
        found, pairs = [], []
        for k in range(model.npair):
            one, other = int(model.pair_geom1[k]), int(model.pair_geom2[k])
            if name[other].startswith("human/"):
                one, other = other, one
            if not (name[one].startswith("human/") and name[other].startswith("seat/")):
                continue
            pairs.append(k)
            sphere = model.geom_type[one] == SPHERE
            ends = (0,) if sphere or model.geom_type[other] == CAPSULE else (-1, 1)
            found += [(one, other, end, model.pair_friction[k, 0]) for end in ends]
        if not found or not any("mattress" in name[other] for _, other, _, _ in found):
            return None
        limb, bed, end, friction = (np.array(x) for x in zip(*found, strict=True))
        capsule = np.where(model.geom_type[limb] == CAPSULE, 1.0, 0.0)
        above = [ancestors(model, int(model.geom_bodyid[g])) for g in limb]
        joints = np.asarray(index.human_joint)
        moves = np.array([[model.jnt_bodyid[j] in x for j in joints] for x in above], float)
        half = model.geom_size[bed].copy()
        return cls(limb, bed, end, capsule, moves, friction, half, joints, np.array(pairs))

    def stop(self, v: Any, mobility: Any, model: Any, data: Any, time_step: float, xp: Any) -> Any:
        """Velocities with which nothing enters the bed in this step [rad/s] (n_person,).

        Args:
            v: that the step has found [rad/s] (n_person,).
            mobility: inverse of the joints' inertia (n_person, n_person).
            model: with the sizes of this person.
            data: where everything was as the step began.
            time_step: of the physics [s].
            xp: numpy or jax.numpy.
        """
        distance, point, frame = self._nearest(model, data, xp)
        axes, anchors = data.xaxis[self.joints], data.xanchor[self.joints]
        arms = point[:, None] - anchors
        jac = xp.cross(axes[None], arms) * self.moves[:, :, None]  # (n, n_person, 3)
        near = xp.where((distance < REACH) & (distance > -RESTING), 1.0, 0.0)
        # rows: normal, two tangents
        jac = xp.einsum("nij,nkj->nik", frame, jac) * near[:, None, None]
        rows = jac.reshape(-1, jac.shape[-1])
        allowed = -near * xp.maximum(distance, 0.0) / time_step
        wanted = xp.stack([allowed, 0.0 * allowed, 0.0 * allowed], axis=1)
        matrix = rows @ mobility @ rows.T
        impulse = _impulses(matrix, (rows @ v).reshape(-1, 3) - wanted, self.friction, xp)
        return v + mobility @ (rows.T @ impulse.reshape(-1))

    def _nearest(self, model: Any, data: Any, xp: Any) -> tuple[Any, Any, Any]:
        """Distances [m] (n,), points on the bed, world [m] (n, 3), and frames, the normal first (n, 3, 3)."""
        axis = lambda g: data.geom_xmat[g].reshape(-1, 3, 3)[:, :, 2]  # noqa: E731
        size = model.geom_size[self.limb]
        centre, along = data.geom_xpos[self.limb], axis(self.limb)
        length = size[:, 1] * self.capsule
        place, turn = data.geom_xpos[self.bed], data.geom_xmat[self.bed].reshape(-1, 3, 3)
        # an end over a box
        tip = centre + (self.end * length)[:, None] * along
        inside = xp.einsum("nji,nj->ni", turn, tip - place)
        face = xp.clip(inside, -self.half, self.half)
        # if its centre is inside, the way out is up
        deep = xp.sum((inside - face) ** 2, axis=1) < 1e-12
        face = xp.where(
            deep[:, None], xp.stack([inside[:, 0], inside[:, 1], self.half[:, 2]], 1), face
        )
        on_box = place + xp.einsum("nij,nj->ni", turn, face)
        # two capsules
        a, b = _closest(centre, along, length, place, turn[:, :, 2], self.half[:, 1], xp)
        capsule = (self.end == 0) & (self.half[:, 2] == 0.0)
        tip = xp.where(capsule[:, None], a, tip)
        core = xp.where(capsule[:, None], b, on_box)
        way = tip - core
        far = xp.sqrt(xp.sum(way**2, axis=1) + 1e-12)
        normal = way / far[:, None]
        normal = xp.where((deep & ~capsule)[:, None], turn[:, :, 2], normal)
        far = xp.where(deep & ~capsule, -far, far)
        skin = xp.where(capsule, self.half[:, 0], 0.0)
        beside = xp.where(xp.abs(normal[:, 1:2]) < 0.9, np.eye(3)[1], np.eye(3)[0])
        first = xp.cross(normal, beside)
        first = first / xp.sqrt(xp.sum(first**2, axis=1))[:, None]
        frame = xp.stack([normal, first, xp.cross(normal, first)], axis=1)
        return far - size[:, 0] - skin, core + skin[:, None] * normal, frame


def _closest(
    centre: Any, along: Any, length: Any, other: Any, axis: Any, half: Any, xp: Any
) -> tuple[Any, Any]:
    """The points of two lines of finite length that are nearest to each other, world [m] (n, 3), (n, 3)."""
    dot = lambda x, y: xp.sum(x * y, axis=1)  # noqa: E731
    between, cosine = centre - other, dot(along, axis)
    slope = xp.maximum(1.0 - cosine**2, 1e-9)
    s = xp.clip((cosine * dot(axis, between) - dot(along, between)) / slope, -length, length)
    t = xp.clip(dot(axis, between) + s * cosine, -half, half)
    s = xp.clip(t * cosine - dot(along, between), -length, length)
    return centre + s[:, None] * along, other + t[:, None] * axis


def _impulses(matrix: Any, slip: Any, friction: Any, xp: Any) -> Any:
    """Impulses of contacts that only push, with round friction cones [N s] (n, 3).

    Every contact is moved towards its solution at once, by what all that act on it leave room for.

    Args:
        matrix: velocities that impulses cause (3 n, 3 n).
        slip: velocities without impulses, less those allowed [m/s] (n, 3).
        friction: coefficients (n,).
        xp: numpy or jax.numpy.
    """
    n = slip.shape[0]
    spread = xp.sum(xp.abs(matrix), axis=1).reshape(n, 3)
    rate = 1.0 / xp.maximum(spread, 1e-6)
    rate = xp.stack([rate[:, 0], *2 * [xp.minimum(rate[:, 1], rate[:, 2])]], axis=1)

    impulse = 0.0 * slip
    # no fori_loop: inside the scan over physics steps XLA's for CPUs gave other numbers
    for _ in range(SWEEPS):
        moved = impulse - rate * (slip + (matrix @ impulse.reshape(-1)).reshape(n, 3))
        normal, side = xp.maximum(moved[:, :1], 0.0), moved[:, 1:]
        most = friction[:, None] * normal
        long = xp.sqrt(xp.sum(side**2, axis=1, keepdims=True) + 1e-12)
        impulse = xp.concatenate([normal, side * xp.minimum(1.0, most / long)], axis=1)
    return impulse
