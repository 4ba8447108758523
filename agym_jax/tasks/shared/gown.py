"""The gown of Dressing before the arm: how it hangs when an episode begins, and the arm as it meets it.

DEVIATION(gown-start): AG drops the gown before each episode and waits for 2 s; it then hangs like a curtain before the hand, its
cuff 5 cm before the tip, held in place by the rest of the gown on the lap. Here an episode begins with one of 80 gowns that hung
so in AG, the part that is simulated; drawn among the four whose hand was nearest to the person's as seen from the gripper, and
moved forward or back at the height of the hand by as much as the hands differ. It then hangs by itself: its cuff stays within 3 cm.
"""

from __future__ import annotations

from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from agym_jax.data.assets import asset_path
from agym_jax.data.npz import read_arrays
from agym_jax.human.anthropometry import Dims
from agym_jax.human.body import shape
from agym_jax.matter.cloth.garment import GarmentError
from agym_jax.matter.cloth.grid import GridShapes, cell_numbers

STARTS = "garments/gown_starts.npz"
"""Gowns that hung in AG."""
NEAREST = 4
"""Of these one is drawn."""


@dataclass(frozen=True, eq=False)
class Starts:
    """How s gowns of n vertices hung in AG when an episode began."""

    vertices: np.ndarray  # from the gripper, world axes [m]                (s, n, 3)
    hand: np.ndarray  # tip of the person's hand, likewise [m]              (s, 3)

    def draw(self, key: Array, gripper_w: Array, hand_w: Array) -> Array:
        """A gown that hung before a hand that was nearly here, world [m] (n, 3).

        Args:
            key: of the draw.
            gripper_w: [m] (3,).
            hand_w: tip of the person's hand [m] (3,).
        """
        off = jnp.asarray(self.hand, jnp.float32) - (hand_w - gripper_w)
        _, nearest = jax.lax.top_k(-jnp.sum(off * off, -1), NEAREST)
        which = jax.random.choice(key, nearest)
        hung = jnp.asarray(self.vertices, jnp.float32)[which]
        # it rests against the hand: a few centimetres nearer or farther, it hangs as much nearer or farther there
        depth = jnp.clip(hung[:, 2] / (hand_w - gripper_w)[2], 0.0, 1.0)
        return gripper_w + hung.at[:, 1].add(-off[which, 1] * depth)


def load_starts(vertices: int) -> Starts:
    """The starts of a gown.

    Args:
        vertices: of the gown.

    Raises:
        GarmentError: the file is damaged, or of another gown.
    """
    needed = {"vertices": ("starts", vertices, 3), "hand": ("starts", 3)}
    remedy = "They are of the packaged gown; another one begins as it hangs."
    arrays = read_arrays(asset_path(STARTS), "starts of a gown", needed, GarmentError, remedy)
    return Starts(arrays["vertices"].astype(np.float32), arrays["hand"].astype(np.float32))


def arm_shapes(
    d: Dims, links: tuple[str, str, str], pos_w: dict[str, Array], rot_w: dict[str, Array]
) -> GridShapes:
    """The arm as the gown meets it in AG: its links, then the spheres that AG adds at shoulder, elbow and wrist.

    Args:
        d: sizes of the person.
        links: upper arm, forearm and hand.
        pos_w: link -> its joint, world [m] (n, 3).
        rot_w: link -> rotation matrix (n, 3, 3).
    """
    shapes = [shape(link, d) for link in links]
    pos, rot = (jnp.stack([x[link] for link in links], 1) for x in (pos_w, rot_w))
    off = _numbers(x for s in shapes for x in s.centre).reshape(3, 3)
    upper, fore, _ = (s.radius for s in shapes)
    numbers = cell_numbers(
        _numbers([*(s.radius for s in shapes), upper, upper, fore]),
        _numbers([*(s.length for s in shapes), 0.0, 0.0, 0.0]),
    )
    return GridShapes(
        centre_w=jnp.concatenate([pos + jnp.einsum("nkij,kj->nki", rot, off), pos], 1),
        rot_w=jnp.concatenate([rot, rot], 1),
        numbers=jnp.broadcast_to(numbers, (len(pos), *numbers.shape)),
    )


def _numbers(values: object) -> Array:
    return jnp.stack([jnp.asarray(x, jnp.float32) for x in values])  # type: ignore[attr-defined]
