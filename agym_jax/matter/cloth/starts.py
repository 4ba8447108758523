"""How a gown begins: swung to the hand, or as the packaged one hung in front of a hand when an episode of Assistive Gym began, recorded there.

Assistive Gym drops the gown at every reset and lets it settle for 2 s (v0.1 ``dressing.py`` reset). 80 such resets were recorded: the positions of the points
of its gown that correspond to the vertices of the packaged one (which is the part from the cuff to where it is held), relative to the gripper, in float16,
and the tip of the person's hand. The programs that recorded and matched them are not in this repository.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import jax.numpy as jnp
import numpy as np
from jax import Array

from agym_jax.data.assets import asset_path
from agym_jax.data.npz import read_arrays
from agym_jax.matter.cloth.garment import GarmentError
from agym_jax.matter.cloth.hang import drawn_swing, swung
from agym_jax.matter.cloth.solver import Cloth, initial
from agym_jax.matter.cloth.topology import ClothSpec

STARTS = "garments/gown_starts.npz"


@dataclass(frozen=True, eq=False)
class Starts:
    """s recorded gowns of n vertices.

    Attributes:
        vertices: relative to the gripper, world axes [m] (s, n, 3).
        hand: tip of the person's hand, likewise [m] (s, 3).
    """

    vertices: np.ndarray
    hand: np.ndarray

    def nearest(self, gripper_w: Array, hand_w: Array) -> Array:
        """Return the gown that hung in front of the most similarly placed hand, world [m] (n, 3).

        It lies against the hand: where the hand is farther forward (-y) or back than the recorded one, so is the gown at the height of
        the hand. The held vertices follow the gripper, not the recording.

        Args:
            gripper_w: position of the gripper [m] (3,).
            hand_w: tip of the person's hand [m] (3,).
        """
        away = jnp.asarray(self.hand, jnp.float32) - (hand_w - gripper_w)
        which = jnp.argmin(jnp.sum(away * away, -1))
        hung = jnp.asarray(self.vertices, jnp.float32)[which]
        below = jnp.clip(hung[:, 2] / (hand_w - gripper_w)[2], 0.0, 1.0)
        return gripper_w + hung.at[:, 1].add(-away[which, 1] * below)


def gown_at_start(
    spec: ClothSpec, starts: Starts | None, settled: Array, key: Array, gripper_w: Array, below: float, hand_w: Array,
) -> Cloth:  # fmt: skip
    """Return a gown as a new episode begins: swung to the hand, or as one hung in AG.

    Args:
        spec: of the gown.
        starts: recorded gowns; None: it is swung.
        settled: whether it is one of these, () bool.
        key: of how far it is swung otherwise.
        gripper_w: position of the gripper [m] (3,).
        below: how far below that the gown is held [m].
        hand_w: tip of the person's hand [m] (3,).
    """
    held_w = gripper_w - jnp.array([0.0, 0.0, below])
    cloth = initial(spec, held_w)
    pos_w = swung(cloth.pos_w, held_w, hand_w, drawn_swing(key))
    if starts is not None:
        pos_w = jnp.where(settled, starts.nearest(gripper_w, hand_w), pos_w)
    return replace(cloth, pos_w=jnp.where(spec.held[:, None] < 0, pos_w, cloth.pos_w))


def load_starts(vertices: int) -> Starts:
    """Return the recorded gowns.

    Args:
        vertices: of the packaged gown.

    Raises:
        GarmentError: if the file is damaged, or of a gown with other vertices.
        MissingAssetError: if there is no such file.
    """
    needed = {"vertices": ("starts", vertices, 3), "hand": ("starts", 3)}
    remedy = "Restore the file from the package."
    arrays = read_arrays(
        asset_path(STARTS), "recorded starts of the gown", needed, GarmentError, remedy
    )
    return Starts(arrays["vertices"].astype(np.float32), arrays["hand"].astype(np.float32))
