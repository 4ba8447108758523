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


@dataclass(frozen=True)
class Starts:
    """What a pair's episodes draw from."""

    bank: Placement  # K rows
    meets: np.ndarray | None = None  # whether a placement meets a settled posture   (P, K) bool
    mouths: np.ndarray | None = None  # for which each base was chosen, world [m]     (K, 3)


def load_starts(task: Task, robot: RobotSpec) -> Starts:
    """A pair's placements, and whom they meet or for whom they were chosen, where it matters and the bank tells.

    Raises:
        MissingPlacementError: see ``data.banks.load_bank``.
        SpecError: the bank does not fit the robot or the postures, or has not a mouth for each placement.
    """
    bank, postures = load_bank(task, robot), task.human.postures
    if not postures:
        return Starts(bank, mouths=load_mouths(task, robot))
    return Starts(bank, load_meets(task, robot, len(load_postures(postures).sex)))


def draw_start(
    key: Array, starts: Starts, posture: Array | None, mouth: Array | None = None
) -> Placement:
    """Draw a placement that suits the person.

    Where one meets the person, another one is drawn that does not, if there is one; where the bank tells for which
    mouths its bases were chosen, one of those for the nearest mouth.

    Args:
        key: PRNG key.
        starts: of the pair, with ``meets`` or ``mouths`` or neither.
        posture: row of the person's settled posture (), None if there are none.
        mouth: of the person, world [m] (3,); needed if ``starts`` has mouths.
    """
    rows = starts.bank.arm_angles.shape[0]
    row = jax.random.randint(key, (), 0, rows)
    if posture is not None and starts.meets is not None and starts.meets.any():
        # few postures meet anything: those that meet the same share a line of a small table
        lines, line_of = np.unique(starts.meets, axis=0, return_inverse=True)
        line = jnp.asarray(line_of.reshape(-1))[posture]
        order = np.argsort(lines, axis=1, kind="stable")  # the free ones first
        free = jnp.asarray((~lines).sum(axis=1))[line]
        nth = jax.random.randint(jax.random.fold_in(key, 1), (), 0, jnp.maximum(free, 1))
        again = jnp.asarray(order)[line, nth]
        row = jnp.where(jnp.asarray(lines)[line, row] & (free > 0), again, row)
    if starts.mouths is not None:
        people, of = np.unique(starts.mouths, axis=0, return_inverse=True)
        order, count = np.argsort(of.reshape(-1), kind="stable"), np.bincount(of.reshape(-1))
        nearest = jnp.argmin(jnp.linalg.norm(people - jnp.asarray(mouth), axis=-1))
        nth = jax.random.randint(key, (), 0, jnp.asarray(count)[nearest])
        row = jnp.asarray(order)[jnp.asarray(np.cumsum(count) - count)[nearest] + nth]
    return jax.tree.map(lambda x: jnp.asarray(x)[row], starts.bank)
