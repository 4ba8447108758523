"""Where the robot stands as an episode begins: a placement that suits the person who was drawn.

Where the bank tells for which mouth each base was chosen, it is one of those for the mouth nearest to the person's.

People of sizes between those of the bank of postures lie in the posture of one of its rows; whether a
placement meets them is then judged by the person of that row, who is of about their size.
"""

from __future__ import annotations

from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from agym_jax.data.banks import Placement, load_bank, load_meets, load_mouths
from agym_jax.human.posture import load_postures
from agym_jax.spec import RobotSpec, Task

ALIKE = 0.5
"""Start poses are alike if all joints are within this [rad]."""


@dataclass(frozen=True)
class Starts:
    """What a pair's episodes draw from."""

    bank: Placement  # K rows
    meets: np.ndarray | None = None  # whether a placement meets a settled posture   (P, K) bool
    mouths: np.ndarray | None = None  # for which each base was chosen, world [m]     (K, 3)
    rare: float = 0.0  # fraction of episodes drawn by rarity


def load_starts(task: Task, robot: RobotSpec, rare: float = 0.0) -> Starts:
    """A pair's placements, and whom they meet or for whom they were chosen, where it matters and the bank tells.

    Args:
        task: the task.
        robot: the robot.
        rare: fraction of episodes in which rare start poses are as likely as common ones.

    Raises:
        MissingPlacementError: see ``data.banks.load_bank``.
        SpecError: the bank does not fit the robot or the postures, or has not a mouth for each placement.
    """
    bank, postures = load_bank(task, robot), task.human.postures
    if not postures:
        return Starts(bank, mouths=load_mouths(task, robot), rare=rare)
    return Starts(bank, load_meets(task, robot, len(load_postures(postures).sex)), rare=rare)


def rarity(angles: np.ndarray) -> np.ndarray:
    """Probability with which each placement is drawn if rare start poses are to be as likely as common ones (K,).

    Inverse kinematics finds several families of poses, some of them seldom. A placement counts as many times less as there are
    placements like it, whose joints are all within ``ALIKE`` of its own.

    Args:
        angles: of the arm in each placement [rad] (K, n_arm).
    """
    weights = 1.0 / (apart(angles, angles) < ALIKE).sum(axis=-1)
    return weights / weights.sum()


def apart(angles: np.ndarray, others: np.ndarray) -> np.ndarray:
    """How far poses of an arm are apart: the difference of the joint that differs most, without whole turns [rad] (K, L).

    Args:
        angles: [rad] (K, n_arm).
        others: [rad] (L, n_arm).
    """
    turns = angles[:, None] - others
    return np.abs((turns + np.pi) % (2 * np.pi) - np.pi).max(axis=-1)


def draw_start(
    key: Array, starts: Starts, posture: Array | None, mouth: Array | None = None
) -> Placement:
    """Draw a placement that suits the person.

    Where one meets the person, another one is drawn that does not, if there is one; where the bank tells for which
    mouths its bases were chosen, one of those for the nearest mouth. In the fraction ``starts.rare`` of the episodes, what is
    drawn first is drawn by ``rarity``.

    Args:
        key: PRNG key.
        starts: of the pair, with ``meets`` or ``mouths`` or neither.
        posture: row of the person's settled posture (), None if there are none.
        mouth: of the person, world [m] (3,); needed if ``starts`` has mouths.
    """
    rows = starts.bank.arm_angles.shape[0]
    row = jax.random.randint(key, (), 0, rows)
    suits = None
    if starts.mouths is not None:
        people, of = np.unique(starts.mouths, axis=0, return_inverse=True)
        order, count = np.argsort(of.reshape(-1), kind="stable"), np.bincount(of.reshape(-1))
        nearest = jnp.argmin(jnp.linalg.norm(people - jnp.asarray(mouth), axis=-1))
        nth = jax.random.randint(key, (), 0, jnp.asarray(count)[nearest])
        row = jnp.asarray(order)[jnp.asarray(np.cumsum(count) - count)[nearest] + nth]
        suits = jnp.asarray(of.reshape(-1)) == nearest
    row = _by_rarity(key, starts, row, suits)
    if posture is not None and starts.meets is not None and starts.meets.any():
        # few postures meet anything: those that meet the same share a line of a small table
        lines, line_of = np.unique(starts.meets, axis=0, return_inverse=True)
        line = jnp.asarray(line_of.reshape(-1))[posture]
        order = np.argsort(lines, axis=1, kind="stable")  # the free ones first
        free = jnp.asarray((~lines).sum(axis=1))[line]
        nth = jax.random.randint(jax.random.fold_in(key, 1), (), 0, jnp.maximum(free, 1))
        again = jnp.asarray(order)[line, nth]
        row = jnp.where(jnp.asarray(lines)[line, row] & (free > 0), again, row)
    return jax.tree.map(lambda x: jnp.asarray(x)[row], starts.bank)


def _by_rarity(key: Array, starts: Starts, row: Array, suits: Array | None = None) -> Array:
    """In the fraction ``starts.rare`` of the episodes, another row, drawn by ``rarity`` among those that suit (K,), or all."""
    if not starts.rare:
        return row
    key_whether, key_row = jax.random.split(jax.random.fold_in(key, 2))
    weights = jnp.asarray(rarity(np.asarray(starts.bank.arm_angles)))
    weights = weights if suits is None else jnp.where(suits, weights, 0.0)
    other = jax.random.categorical(key_row, jnp.log(weights))
    return jnp.where(jax.random.bernoulli(key_whether, starts.rare), other, row)
