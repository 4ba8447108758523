"""Inverse kinematics as Assistive Gym's engine solves it: damped least squares, pulled towards a rest pose.

Which of a pose's many solutions is found, and how far it stays from the wanted pose, follows from the method: with the
same rest poses this module gives the joint angles that Assistive Gym v0.1 recorded, to a thousandth of a radian. Facts
from Bullet (branch v0.1 of the fork): ``IKTrajectoryHelper.cpp`` computeIK and computeNullspaceVel, BussIK
``Jacobian.cpp`` CalcDeltaThetasDLSwithNullspace, ``PhysicsServerCommandProcessor.cpp``
processCalculateInverseKinematicsCommand.

In NumPy and double precision, as Bullet, with the batch as the last axis: thousands of poses at once on one core.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from agym_jax.offline.kinematics import Chain

DAMPING = 0.36
"""Square of BussIK's DefaultDampingLambda."""
TO_REST = 0.001
"""Share of the way to the rest pose that an iteration asks for (stayCloseToZeroGain)."""
INTO_LIMITS = 10.0
"""Gain towards a limit that is exceeded, per range of the joint (stayAwayFromLimitsGain)."""
LARGEST_STEP = np.pi / 4
"""No joint turns further in an iteration [rad] (MaxAngleDLS)."""
CLOSE = 1e-4
"""Iterations end within this distance [m]; the orientation does not count."""
TURNS = 2 * np.pi
"""Limit [rad] that AG gives joints without one, on either side (``util.py`` ik)."""
CHUNK = 2048


@dataclass(frozen=True)
class Limits:
    """Joint limits of a chain as the inverse kinematics knows them [rad] (n,)."""

    lower: np.ndarray
    upper: np.ndarray
    span: np.ndarray  # that the gain into the limits is divided by


def limits_of(chain: Chain, half_range: bool = False) -> Limits:
    """Limits of a chain; joints without any get two turns either way.

    Args:
        chain: n hinges.
        half_range: the span is half of the range, as AG has it for Baxter.
    """
    lower, upper = (np.clip(x.astype(float), -TURNS, TURNS) for x in (chain.lower, chain.upper))
    return Limits(lower, upper, (upper - lower) * (0.5 if half_range else 1.0))


class Solver:
    """A chain with its hinges turned onto the z axes of their frames, which saves most of the products.

    Args:
        chain: n hinges.
        limits: of the hinges.
        half_turn: 1 or -1, which way the hand goes that is exactly half a turn away, as that of an arm at 0 may be.
            In Bullet rounding decides.
    """

    def __init__(self, chain: Chain, limits: Limits, half_turn: float = 1.0):
        self.limits, self.n, self.half_turn = limits, len(chain.lower), half_turn
        onto = [_onto_z(a) for a in chain.axis.astype(float)]
        before = [np.eye(3), *onto[:-1]]
        self._offset = [b.T @ p for b, p in zip(before, chain.pos.astype(float), strict=True)]
        self._turn = [
            b.T @ r @ o for b, r, o in zip(before, chain.rot.astype(float), onto, strict=True)
        ]
        self._tip = onto[-1].T @ chain.tip_pos.astype(float)
        self._tip_rot = onto[-1].T @ chain.tip_rot.astype(float)

    def forward(self, angles: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Pose of the tip in the base frame, and its Jacobian.

        Args:
            angles: [rad] (n, B).

        Returns:
            position [m] (3, B), rotation matrix (3, 3, B), Jacobian (6, n, B): linear rows first.
        """
        batch = angles.shape[1]
        pos, rot = np.zeros((3, batch)), np.broadcast_to(np.eye(3)[:, :, None], (3, 3, batch))
        cos, sin = np.cos(angles), np.sin(angles)
        anchors, axes = np.empty((self.n, 3, batch)), np.empty((self.n, 3, batch))
        for i in range(self.n):
            pos = pos + self._offset[i] @ rot
            rot = self._turn[i].T @ rot
            anchors[i], axes[i] = pos, rot[:, 2]
            x, y = rot[:, 0], rot[:, 1]
            rot = np.stack([cos[i] * x + sin[i] * y, cos[i] * y - sin[i] * x, rot[:, 2]], axis=1)
        tip = pos + self._tip @ rot
        arm = tip - anchors
        jacobian = np.empty((6, self.n, batch))
        for a, b, c in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
            jacobian[a] = axes[:, b] * arm[:, c] - axes[:, c] * arm[:, b]
            jacobian[3 + a] = axes[:, a]
        return tip, self._tip_rot.T @ rot, jacobian

    def solve(
        self,
        start: np.ndarray,
        rest: np.ndarray,
        pos: np.ndarray,
        rot: np.ndarray | None,
        iterations: int,
    ) -> np.ndarray:
        """Joint angles, not yet clipped to the limits [rad] (B, n).

        Args:
            start: where the arm is [rad] (B, n).
            rest: pose that the null space is pulled to [rad] (B, n).
            pos: wanted for the tip, in the base frame [m] (B, 3).
            rot: rotation matrices (B, 3, 3); None leaves the orientation free.
            iterations: at most.
        """
        out = np.empty((len(start), self.n))
        for at in range(0, len(start), CHUNK):
            rows = slice(at, at + CHUNK)
            wanted = None if rot is None else bullet_quat(np.moveaxis(rot[rows], 0, -1))
            out[rows] = self._solve(start[rows].T, rest[rows].T, pos[rows].T, wanted, iterations).T
        return out

    def _solve(
        self,
        start: np.ndarray,
        rest: np.ndarray,
        pos: np.ndarray,
        rot: np.ndarray | None,
        iterations: int,
    ) -> np.ndarray:
        """The same with the batch last; wanted rotations as quaternions (4, B)."""
        q, left = start.copy(), np.arange(start.shape[1])
        for _ in range(iterations):
            now = q[:, left]
            tip, tip_rot, jacobian = self.forward(now)
            error = pos - tip
            close = np.sqrt((error * error).sum(axis=0)) <= CLOSE
            if rot is None:
                jacobian = jacobian[:3]
            else:
                error = np.concatenate([error, _rotation_vector(tip_rot, rot, self.half_turn)])
            step = self._step(jacobian, error, self._drift(now, rest))
            q[:, left] = now + step
            if close.any():  # such a pose has had its last step
                keep = ~close
                left, rest, pos = left[keep], rest[:, keep], pos[:, keep]
                rot = None if rot is None else rot[:, keep]
                if not len(left):
                    break
        return q

    def _drift(self, q: np.ndarray, rest: np.ndarray) -> np.ndarray:
        """Motion that is asked of the null space [rad] (n, B)."""
        lower, upper, span = (
            x[:, None] for x in (self.limits.lower, self.limits.upper, self.limits.span)
        )
        beyond = np.minimum(upper - q, 0.0) + np.maximum(lower - q, 0.0)
        return TO_REST * (rest - q) + INTO_LIMITS * beyond / span

    @staticmethod
    def _step(jacobian: np.ndarray, error: np.ndarray, drift: np.ndarray) -> np.ndarray:
        """One damped step, J^T (J J^T + d)^-1 (e - J v) + v, shortened to the largest (n, B)."""
        rows = len(jacobian)
        left = error - (jacobian * drift).sum(axis=1)
        gram = np.empty((rows, rows, left.shape[1]))
        for i in range(rows):
            gram[i, : i + 1] = (jacobian[i] * jacobian[: i + 1]).sum(axis=1)
            gram[i, i] += DAMPING
        pull = _solve_positive(gram, left)
        step = (jacobian * pull[:, None]).sum(axis=0) + drift
        largest = np.abs(step).max(axis=0)
        return step * np.minimum(1.0, LARGEST_STEP / np.maximum(largest, 1e-12))


def isotropy(
    jacobian: np.ndarray, angles: np.ndarray, limits: Limits, endless: np.ndarray
) -> np.ndarray:
    """Joint-limit-weighted kinematic isotropy, 0 (singular or at a limit) to 1 (B,).

    AG v0.1 ``env.py`` joint_limited_weighting and position_robot_toc (reference robots.md section 7).

    Args:
        jacobian: (6, n, B).
        angles: [rad] (n, B).
        limits: of the chain.
        endless: joints without limits, which weigh 1 (n,) bool.
    """
    half = ((limits.upper - limits.lower) / 2)[:, None]
    room = half - np.abs(half - angles + limits.lower[:, None])
    weight = np.maximum(0.001, 1.0 - 0.5 ** (room / (0.05 * half) + 1.0))
    weight = np.where(endless[:, None], 1.0, weight)
    gram = np.einsum("inb,nb,jnb->bij", jacobian, weight, jacobian)
    determinant = np.maximum(np.linalg.det(gram), 0.0)
    return determinant ** (1 / 6) / (np.trace(gram, axis1=1, axis2=2) / 6)


def _onto_z(axis: np.ndarray) -> np.ndarray:
    """A rotation matrix whose third column is the unit axis (3, 3)."""
    other = np.eye(3)[np.argmin(np.abs(axis))]
    x = np.cross(other, axis)
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(axis, x), axis], axis=1)


def bullet_quat(rot: np.ndarray) -> np.ndarray:
    """Quaternions wxyz (4, B) of rotation matrices (3, 3, B), with the sign that Bullet's getRotation gives them.

    w is positive where the trace is; elsewhere the part of the greatest diagonal entry is. That is the rule of
    ``math3d.first_sign``, which applies it to quaternions; here it also says which part the others are divided by, so
    the sign comes with the conversion.
    """
    diagonal = np.stack([rot[0, 0], rot[1, 1], rot[2, 2]])
    trace = diagonal.sum(axis=0)
    first = np.where(trace > 0, 0, 1 + np.argmax(diagonal, axis=0))
    # 4 times the products of the quaternion's parts: the row of the part that is divided by
    skew = [rot[2, 1] - rot[1, 2], rot[0, 2] - rot[2, 0], rot[1, 0] - rot[0, 1]]
    even = [rot[2, 1] + rot[1, 2], rot[0, 2] + rot[2, 0], rot[1, 0] + rot[0, 1]]
    rows = np.stack([
        np.stack([1 + trace, *skew]),
        np.stack([skew[0], 1 + 2 * diagonal[0] - trace, even[2], even[1]]),
        np.stack([skew[1], even[2], 1 + 2 * diagonal[1] - trace, even[0]]),
        np.stack([skew[2], even[1], even[0], 1 + 2 * diagonal[2] - trace]),
    ])  # fmt: skip
    row = np.take_along_axis(rows, first[None, None], axis=0)[0]
    return row / np.sqrt((row * row).sum(axis=0))


def _rotation_vector(rot: np.ndarray, goal: np.ndarray, half_turn: float) -> np.ndarray:
    """Rotation vectors from ``rot`` (3, 3, B) to quaternions ``goal`` (4, B), in the parent frame [rad] (3, B).

    Args:
        rot: rotation matrices.
        goal: quaternions wxyz with Bullet's sign.
        half_turn: sign of what is exactly half a turn.
    """
    (aw, *a), (bw, *b) = goal, bullet_quat(rot)
    a, b = np.stack(a), np.stack(b)
    w = np.clip(aw * bw + (a * b).sum(axis=0), -1.0, 1.0)
    axis = bw * a - aw * b - np.cross(a, b, axis=0)
    angle = 2 * np.arccos(w)
    angle = np.where(np.abs(w) < 1e-6, half_turn * np.pi, angle)
    angle = np.where(angle > np.pi, angle - 2 * np.pi, angle)
    return axis * (angle / np.maximum(np.sqrt((axis * axis).sum(axis=0)), 1e-12))


def _solve_positive(matrix: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Solutions (k, B) for positive matrices (k, k, B), of which the lower half is read, by Cholesky."""
    k = len(matrix)
    low = matrix
    for j in range(k):
        for m in range(j):
            low[j:, j] -= low[j:, m] * low[j, m]
        low[j:, j] /= np.sqrt(low[j, j])
    y = right.copy()
    for i in range(k):
        for m in range(i):
            y[i] -= low[i, m] * y[m]
        y[i] /= low[i, i]
    for i in reversed(range(k)):
        for m in range(i + 1, k):
            y[i] -= low[m, i] * y[m]
        y[i] /= low[i, i]
    return y
