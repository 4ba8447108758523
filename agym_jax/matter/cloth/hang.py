"""A garment that hangs from its anchors: the shape in which it comes to rest, and how it is swung when an episode begins.

Assistive Gym drops the gown from its mesh at every reset and lets it settle for 2 s at half the gravity
(dressing.py reset). Here it settles once, until it is at rest. The packaged gown has its hanging shape in the file;
a garment without one is settled at first use.

DEVIATION(gown-start): AG drops the gown before each episode; it hangs like a curtain before the hand, its cuff 5 cm before the
tip, with the rest of the gown on the lap. Here a gown that hangs still begins swung forward and sideways, by as much as is
drawn: its cuff is 27 to 35 cm before the tip (10th and 90th percentile of 24 starts), and 13 to 18 cm after it has swung back for 2 s. How far
is set so that hands which move at once, or high above the arm, miss the sleeve, as their replayed paths do in AG. With ``settled_gown``, a share
of the episodes begins with one of 80 gowns recorded in AG, the one in front of the hand that was nearest to the person's, relative to the gripper.
"""

from __future__ import annotations

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from agym_jax.matter.cloth.garment import Garment
from agym_jax.matter.cloth.solver import anchor_positions, initial, step
from agym_jax.matter.cloth.topology import ClothSpec, Fabric, build_cloth
from agym_jax.matter.shapes import Capsules, no_capsules

DT = 0.01  # physics step [s]
DURATION = 12.0  # of settling [s]
DAMPING = 4.0  # of velocities while it settles [1/s]
BEFORE, BESIDE = (0.08, 0.2), (-0.03, 0.06)
"""Ranges of how far the gown is initially swung forward of the person's hand, at the height of the hand, and to the person's
left [m]: the hand is at the opening of the gown, not inside the gown. Seen from the tip of the hand, the cloth fills 0.2 to 0.5
of all directions (AG: 0.28 to 0.52); AG's cuff is 1 to 5 cm to the left of the gripper. With a gown closer to the hand, hand
paths that miss the sleeve in AG would dress people here."""


def settle(
    garment: Garment,
    fabric: Fabric = Fabric(),  # noqa: B008  frozen
    around: Capsules | None = None,
) -> Garment:
    """The same garment, with ``hanging`` set to the shape in which it comes to rest.

    Args:
        garment: upright in its frame, held at its anchors.
        fabric: properties of its cloth.
        around: what it hangs around, in its frame; nothing if left out.
    """
    spec: ClothSpec = build_cloth(garment, replace(fabric, damping=DAMPING))
    anchors, solids = anchor_positions(spec, jnp.zeros(3)), around or no_capsules()

    @jax.jit
    def hang() -> jax.Array:
        def one(cloth, _):
            return step(spec, cloth, solids, solids, anchors, anchors, DT)[0], None

        return jax.lax.scan(one, initial(spec, jnp.zeros(3)), length=round(DURATION / DT))[0].pos_w

    return replace(garment, hanging=np.asarray(hang()))


def hanging(garment: Garment, fabric: Fabric) -> Garment:
    """The garment with its hanging shape, in which it is settled if its file has none."""
    if garment.hanging is not None:
        return garment
    with jax.ensure_compile_time_eval():  # it is the same in every program that asks for it
        return settle(garment, fabric)


def drawn_swing(key: Array) -> Array:
    """Draw how far a gown is swung when an episode begins, to the person's left and forward of the hand [m] (2,)."""
    low, high = jnp.array([BESIDE, BEFORE]).T
    return jax.random.uniform(key, (2,), minval=low, maxval=high)


def swung(pos_w: Array, held_w: Array, hand_w: Array, off: Array) -> Array:
    """Swing a hanging gown to a place in front of a hand, world [m] (n, 3).

    Args:
        pos_w: vertices of the gown hanging straight down [m] (n, 3).
        held_w: where it is held [m] (3,).
        hand_w: tip of the person's hand [m] (3,).
        off: how far it is swung at the height of the hand, to the person's left and forward of the hand [m] (2,).
    """
    below = hand_w - held_w
    swing = jnp.array([off[0], jnp.minimum(below[1] - off[1], 0.0), 0.0])
    return pos_w + swing * jnp.clip((pos_w[:, 2:] - held_w[2]) / below[2], 0.0, 1.0)
