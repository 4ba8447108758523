"""Whether and how far the sleeve is on the arm: Assistive Gym's rules as functions of six points on the cuff.

Facts: reference tasks.md section 6. The points form two interleaved triangles that span the opening. The sleeve is
on a segment of the arm where the segment crosses one of the triangles and the points lie on both sides of it.
All functions are for one environment, in world coordinates [m].

DEVIATION(sleeve-now): what counts is the segment that the sleeve is on now, or was on within the last 0.5 s: in a
pull around the elbow it is on neither segment for 0.2 to 0.4 s. AG's flags stay set for the rest of the episode, so
that a sleeve that has once been on the forearm is rewarded wherever it is: PPO learned to put it on, take it off and
hold it beside the elbow. In 24 episodes of that policy no arm was in the sleeve at the end, and 9 counted as a success.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from agym_jax.matter.cloth.garment import Garment
from agym_jax.matter.shapes import TINY

AG_LOOP = 26
"""Vertices of the cuff of AG's gown."""
AG_TRIANGLES = ((0, 8, 16), (21, 4, 12))
"""Positions of AG's sleeve triangles on its cuff: AG dressing.py reset."""
MEMORY_STEPS = 5
"""Control steps for which a sleeve that is on no segment counts as on the one it was on."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class SleeveArm:
    """Joints of the arm to be dressed, and its thickness."""

    shoulder_w: Array  # [m]                                                (3,)
    elbow_w: Array  # [m]                                                   (3,)
    wrist_w: Array  # [m]                                                   (3,)
    radius: Array  # of hand, elbow and shoulder (AG: 0.043, 0.0355) [m]    ()

    @property
    def hand_end_w(self) -> Array:
        """Tip of the hand (3,)."""
        return self.wrist_w + 2.0 * self.radius * _unit(self.wrist_w - self.elbow_w)

    @property
    def elbow_end_w(self) -> Array:
        """Surface of the elbow, on the forearm's axis (3,)."""
        return self.elbow_w + self.radius * _unit(self.elbow_w - self.wrist_w)

    @property
    def shoulder_end_w(self) -> Array:
        """Surface of the shoulder, on the upper arm's axis (3,)."""
        return self.shoulder_w + self.radius * _unit(self.shoulder_w - self.elbow_w)

    @property
    def forearm_length(self) -> Array:
        """From the tip of the hand to the surface of the elbow ()."""
        return _norm(self.hand_end_w - self.elbow_end_w)

    @property
    def upper_length(self) -> Array:
        """From the elbow to the shoulder ()."""
        return _norm(self.elbow_w - self.shoulder_w)


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class SleeveState:
    """Segments of the arm that the sleeve is on."""

    forearm: Array  # () bool
    upper_arm: Array  # () bool
    steps_off: Array = field(
        default_factory=lambda: jnp.int32(0)
    )  # control steps since it was on either ()

    def after(self, earlier: SleeveState) -> SleeveState:
        """This state; if the sleeve is on no segment, the earlier state for ``MEMORY_STEPS`` control steps."""
        on = self.forearm | self.upper_arm
        steps_off = jnp.where(on, 0, jnp.minimum(earlier.steps_off + 1, MEMORY_STEPS + 1))
        recall = ~on & (steps_off <= MEMORY_STEPS)
        return SleeveState(
            forearm=self.forearm | (recall & earlier.forearm),
            upper_arm=self.upper_arm | (recall & earlier.upper_arm),
            steps_off=steps_off,
        )


def watched_vertices(garment: Garment) -> np.ndarray:
    """Vertices of the two triangles, at AG's fractions of the cuff's loop (2, 3)."""
    share = np.array(AG_TRIANGLES) / AG_LOOP
    return garment.cuff[np.round(share * len(garment.cuff)).astype(int) % len(garment.cuff)]


def crossed(start_w: Array, end_w: Array, triangles_w: Array) -> Array:
    """Which triangles a segment crosses (t,) bool.

    Args:
        start_w: one end of the segment (3,).
        end_w: the other end (3,).
        triangles_w: corners (t, 3, 3).
    """
    a, b, c = (triangles_w[:, i] for i in range(3))
    apart = _volume(start_w, a, b, c) * _volume(end_w, a, b, c) < 0
    turns = [_volume(start_w, end_w, u, v) for u, v in ((a, b), (b, c), (c, a))]
    inside = ((turns[0] > 0) == (turns[1] > 0)) & ((turns[1] > 0) == (turns[2] > 0))
    return apart & inside


def surrounds(points_w: Array, distal_w: Array, proximal_w: Array) -> Array:
    """Whether the six points surround a segment of the arm () bool.

    Args:
        points_w: the two triangles (2, 3, 3).
        distal_w: end of the segment towards the hand (3,).
        proximal_w: its other end (3,).
    """
    along = _unit(distal_w - proximal_w)
    across = jnp.cross(jnp.array([1.0, 1.0, 0.0]), along)  # AG util.py
    spare = jnp.cross(jnp.array([0.0, 0.0, 1.0]), along)
    across = _unit(jnp.where(_norm(across) > 1e-3, across, spare))
    other = _unit(jnp.cross(across, along))
    from_axis = points_w.reshape(6, 3) - proximal_w
    sides = jnp.stack([from_axis @ across, from_axis @ other])
    both = ((sides > 0).any(1) & (sides < 0).any(1)).all()
    return both & crossed(distal_w, proximal_w, points_w).any()


def sleeve_state(points_w: Array, arm: SleeveArm) -> SleeveState:
    """Segments that the sleeve is on now.

    Args:
        points_w: the two triangles (2, 3, 3).
        arm: of the person.
    """
    return SleeveState(
        forearm=surrounds(points_w, arm.hand_end_w, arm.elbow_end_w),
        upper_arm=surrounds(points_w, arm.elbow_end_w, arm.shoulder_end_w),
    )


def dressing_distance(points_w: Array, arm: SleeveArm, on_arm: SleeveState) -> Array:
    """AG's r_dress [m] (): distance along the arm, or minus the distance to the hand.

    Args:
        points_w: the two triangles (2, 3, 3).
        arm: of the person.
        on_arm: segments that the sleeve is on or was on.
    """
    centre = points_w.reshape(6, 3).mean(0)
    from_hand, from_elbow = _norm(centre - arm.hand_end_w), _norm(centre - arm.elbow_w)
    on_upper = arm.forearm_length + jnp.where(from_elbow < arm.upper_length, from_elbow, 0.0)
    on_forearm = on_arm.forearm & (from_hand < arm.forearm_length)
    return jnp.where(on_arm.upper_arm, on_upper, jnp.where(on_forearm, from_hand, -from_hand))


def progress(points_w: Array, arm: SleeveArm) -> Array:
    """How far the sleeve is up the arm: 0 at the tip of the hand, 1 at the shoulder ().

    Zero while the sleeve is on neither segment. Unlike AG's distance, it is relative to the length of the arm.

    Args:
        points_w: the two triangles (2, 3, 3).
        arm: of the person.
    """
    centre, on = points_w.reshape(6, 3).mean(0), sleeve_state(points_w, arm)
    forearm = arm.elbow_w - arm.hand_end_w
    upper = arm.shoulder_w - arm.elbow_w
    lengths = _norm(forearm), _norm(upper)
    along_forearm = jnp.clip((centre - arm.hand_end_w) @ _unit(forearm), 0.0, lengths[0])
    along_upper = lengths[0] + jnp.clip((centre - arm.elbow_w) @ _unit(upper), 0.0, lengths[1])
    done = jnp.where(on.upper_arm, along_upper, jnp.where(on.forearm, along_forearm, 0.0))
    return done / (lengths[0] + lengths[1])


def _volume(a: Array, b: Array, c: Array, d: Array) -> Array:
    """Six times the signed volume of tetrahedra (...)."""
    return jnp.sum(jnp.cross(b - a, c - a) * (d - a), -1)


def _norm(a: Array) -> Array:
    return jnp.sqrt(jnp.maximum(jnp.sum(a * a, -1), TINY))


def _unit(a: Array) -> Array:
    return a / _norm(a)[..., None]
