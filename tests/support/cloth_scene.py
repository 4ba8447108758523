"""An arm and a scripted hand that pulls the gown onto it, for tests and for the study of many pulls."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from agym_jax.matter.cloth.garment import Garment
from agym_jax.matter.cloth.sleeve import (
    SleeveArm,
    crossed,
    dressing_distance,
    progress,
    sleeve_state,
    watched_vertices,
)
from agym_jax.matter.cloth.solver import Cloth, ClothContact, in_hand, initial, slip, step
from agym_jax.matter.cloth.topology import ClothSpec
from agym_jax.matter.shapes import Capsules, capsule_distances, no_capsules
from agym_jax.tasks.dressing import BELOW_HAND, UP, held_at

DT = 0.01
NOTHING = no_capsules()
ABOVE = 0.15
"""Height of the gripper above the arm's axis while it pulls [m]."""


def sheet(width: float, height: float, edge: float, anchors: str = "top") -> Garment:
    """A flat cloth in the xz-plane; its cuff is its whole boundary.

    Args:
        width: along x [m].
        height: along z, downwards [m].
        edge: length of edges [m].
        anchors: held vertices: "top" row, "ends" of a strip (first and last column), or "corner".
    """
    c, r = round(width / edge) + 1, round(height / edge) + 1
    ids = np.arange(c * r).reshape(r, c)
    x, z = np.meshgrid(np.arange(c) * edge, -np.arange(r) * edge)
    a, b, d, e = ids[:-1, :-1], ids[:-1, 1:], ids[1:, :-1], ids[1:, 1:]
    held = {"top": ids[0], "ends": np.concatenate([ids[:, 0], ids[:, -1]]), "corner": ids[:1, 0]}
    return Garment(
        name="sheet",
        vertices=np.stack([x.ravel(), 0.0 * x.ravel(), z.ravel()], -1),
        triangles=np.concatenate(
            [np.stack([a, b, e], -1).reshape(-1, 3), np.stack([a, e, d], -1).reshape(-1, 3)]
        ),
        cuff=np.concatenate([ids[0], ids[1:, -1], ids[-1, -2::-1], ids[-2:0:-1, 0]]),
        anchors=held[anchors],
    )


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Pull:
    """One scripted pull; what varies between pulls."""

    size: Array  # of AG's man                                              ()
    girth: Array  # of AG's man                                             ()
    miss_w: Array  # how far the hand's path lies off [m]                   (3,)
    speed: Array  # [m/s]                                                   ()
    bend: Array  # angle of the elbow; pi/2 in AG's Dressing [rad]          ()


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Outcome:
    """What a pull came to."""

    progress: Array  # the best of it                                          ()
    dressed: Array  # AG's r_dress at the end [m]                           ()
    best: Array  # the best of it [m]                                       ()
    through: Array  # most triangles that the arm's axis went through       () int32
    deepest: Array  # most that a vertex sank into the arm's surface [m]    ()
    force: Array  # greatest sum of force sizes on the arm [N]              ()
    slid: Array  # most that the gown slid through the fingers [m]          ()
    broken: Array  # () bool


def draw_pull(key: Array) -> Pull:
    """A pull over the range of people: AG's woman is 0.91 long and 0.82 thick."""
    low = jnp.array([0.85, 0.75, -0.02, -0.02, -0.02, 0.15, 1.3])
    high = jnp.array([1.1, 1.0, 0.02, 0.02, 0.005, 0.3, 1.6])
    x = jax.random.uniform(key, (7,), minval=low, maxval=high)
    return Pull(size=x[0], girth=x[1], miss_w=x[2:5], speed=x[5], bend=x[6])


def arm_of(pull: Pull) -> tuple[SleeveArm, Capsules]:
    """The arm, its elbow at the origin and its forearm along -y, and its capsules: AG's man, scaled."""
    radius = 0.043 * pull.girth
    elbow = jnp.zeros(3)
    wrist = jnp.array([0.0, -0.29, 0.0]) * pull.size
    upper = jnp.stack([-jnp.sin(pull.bend), jnp.cos(pull.bend), 0.0])
    shoulder = 0.279 * pull.size * upper
    arm = SleeveArm(shoulder, elbow, wrist, radius)
    hand = wrist + jnp.array([0.0, -1.0, 0.0]) * radius
    a = jnp.stack([shoulder, elbow, hand, elbow])
    b = jnp.stack([elbow, wrist, hand, elbow])
    radii = jnp.array([0.043, 0.033, 0.043, 0.043]) * pull.girth
    return arm, Capsules(a, b, radii)


def before_hand(arm: SleeveArm) -> Array:
    """Where a pull begins, but for its height [m] (3,)."""
    return arm.hand_end_w - 0.02 * along_forearm(arm)


def along_forearm(arm: SleeveArm) -> Array:
    """Direction from wrist to elbow (3,)."""
    return (arm.elbow_w - arm.wrist_w) / jnp.linalg.norm(arm.elbow_w - arm.wrist_w)


def up_the_arm(arm: SleeveArm) -> Array:
    """Places that a good pull passes, but for its height [m] (4, 3): on past the elbow, then over the shoulder."""
    fore = along_forearm(arm)
    return jnp.stack(
        [before_hand(arm), arm.elbow_w, arm.elbow_w + 0.45 * fore, arm.shoulder_w + 0.3 * fore]
    )


def path_of(pull: Pull, places: Array, n: int) -> Array:
    """Where the hand is at n moments [m] (n, 3), straight from place to place (p, 3)."""
    lengths = jnp.linalg.norm(jnp.diff(places, axis=0), axis=1)
    way = jnp.concatenate([jnp.zeros(1), jnp.cumsum(lengths)])
    done = jnp.arange(n) * DT * pull.speed
    pos = jnp.stack([jnp.interp(done, way, x) for x in places.T], -1)
    return pos + pull.miss_w + ABOVE * UP


def pull_on(
    spec: ClothSpec, pull: Pull, n: int, through: Callable[[SleeveArm], Array] = up_the_arm
) -> tuple[Outcome, Cloth, ClothContact, Array]:
    """Pull the gown in n physics steps: outcome, cloth and touch at the end, and all positions.

    Args:
        spec: of the gown.
        pull: its person, speed and so on.
        n: physics steps.
        through: places that the hand passes, of the arm (p, 3) [m].
    """
    arm, capsules = arm_of(pull)
    pos = path_of(pull, through(arm), n + 1)
    watched = watched_vertices(spec.garment)
    triangles = spec.garment.triangles
    axis = jnp.stack([arm.shoulder_w, arm.elbow_w, arm.wrist_w, capsules.a_w[2]])

    def one(carry: tuple, now: tuple) -> tuple[tuple, Array]:
        cloth, slid, latched, out = carry
        before, after = now
        held = held_at(spec, before + slid), held_at(spec, after + slid)
        cloth, touch = step(spec, cloth, capsules, capsules, *held, DT, in_hand(slid))
        slid = slip(slid, touch, DT)
        points = cloth.pos_w[watched]
        latched = sleeve_state(points, arm).after(latched)
        corners = cloth.pos_w[triangles]
        through = sum(crossed(axis[i], axis[i + 1], corners).sum() for i in range(3))
        off = _depth(cloth.pos_w, capsules, spec)
        reached = dressing_distance(points, arm, latched)
        out = replace(
            out,
            progress=jnp.maximum(out.progress, progress(points, arm)),
            dressed=reached,
            best=jnp.maximum(out.best, reached),
            through=jnp.maximum(out.through, through.astype(jnp.int32)),
            deepest=jnp.maximum(out.deepest, off),
            force=jnp.maximum(out.force, touch.total.sum()),
            slid=jnp.maximum(out.slid, jnp.linalg.norm(slid)),
            broken=out.broken | touch.broken,
        )
        return (cloth, slid, latched, out), (cloth.pos_w, touch)

    zero = jnp.float32(0.0)
    out = Outcome(zero, zero, jnp.float32(-9.0), jnp.int32(0), zero, zero, zero, jnp.array(False))
    cloth = initial(spec, pos[0] - BELOW_HAND * UP)
    nothing = sleeve_state(cloth.pos_w[watched] + 99.0, arm)
    carry = (cloth, jnp.zeros(3), nothing, out)
    (cloth, *_, out), (seen, touch) = jax.lax.scan(one, carry, (pos[:-1], pos[1:]))
    return out, cloth, jax.tree.map(lambda x: x[-1], touch), seen


def _depth(pos_w: Array, capsules: Capsules, spec: ClothSpec) -> Array:
    """Most that a free vertex lies inside the arm's surface [m] ()."""
    points = tuple(pos_w[:, i] for i in range(3))
    ends = capsules.ends()
    dist = capsule_distances(points, ends, ends, capsules.radius).dist.min(0)
    return jnp.maximum(-jnp.where(jnp.asarray(spec.held < 0), dist, 1.0).min(), 0.0)
