"""Where the robot stands as an episode begins: a placement that does not meet the person who was drawn.

People of sizes between those of the bank of postures lie in the posture of one of its rows; whether a
placement meets them is then judged by the person of that row, who is of about their size.
"""

from __future__ import annotations

from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from agym_jax.data.banks import Placement, load_bank, load_meets
from agym_jax.human.posture import load_postures
from agym_jax.spec import RobotSpec, Task


@dataclass(frozen=True)
class Starts:
    """What a pair's episodes draw from."""

    bank: Placement  # K rows
    meets: np.ndarray | None  # whether a placement meets a settled posture   (P, K) bool


def load_starts(task: Task, robot: RobotSpec) -> Starts:
    """A pair's placements, and whom they meet, where people lie in settled postures and the bank tells.

    Raises:
        MissingPlacementError: see ``data.banks.load_bank``.
        SpecError: the bank does not fit the robot or the postures.
    """
    bank, postures = load_bank(task, robot), task.human.postures
    if not postures:
        return Starts(bank, None)
    return Starts(bank, load_meets(task, robot, len(load_postures(postures).sex)))


def draw_start(key: Array, starts: Starts, posture: Array | None) -> Placement:
    """Draw a placement; where it meets the person, another one that does not, if there is one.

    Args:
        key: PRNG key.
        starts: of the pair.
        posture: row of the person's settled posture (), None if there are none.
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
    return jax.tree.map(lambda x: jnp.asarray(x)[row], starts.bank)
