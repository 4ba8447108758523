"""The human body: links, joints, masses and shapes, for MuJoCo and for a batch of different people.

42 joints of Assistive Gym v0.1 (``human_creation.py``, reference humans.md section 2) on 19 links.
Joints that a task does not move are welded at the episode's angle; the others are hinges. The
same functions fill an ``MjSpec`` and, evaluated on JAX arrays per environment, the fields of
``mjx.Model`` in which people differ.

Frames: x = the person's left, -y = front, z = up; every link frame is aligned with the chest at
zero angles, and lies at the link's (last) joint.

DEVIATION(person-mass): mass sits at the centre of each limb's capsule with the inertia of a solid
capsule, and the 13 % that AG keeps on a shapeless pelvis link is the waist's. AG has every centre
of mass at the proximal joint, so that holding a man's arm out sideways takes 6.9 N m at the shoulder and 1.4 at the elbow
instead of 12.5 and 3.5. ``Population(masses="ag")`` is AG's distribution.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

from agym_jax.errors import UnknownNameError
from agym_jax.human.anthropometry import Dims
from agym_jax.math3d import axis_angle_quat, joined, quat_mul, rotate, split

Array = Any
X, Y, Z = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)


class Joint(NamedTuple):
    """A hinge of the body. Limits in degrees, as in AG's source."""

    name: str
    axis: tuple[float, float, float]
    lower: float
    upper: float
    scaled: bool  # by the impairment's limit_scale


class Link(NamedTuple):
    """A rigid link: its parent, its joints from the root outwards, and its share of the mass."""

    name: str
    parent: str
    joints: tuple[Joint, ...]
    mass: float


def _arm(side: str) -> tuple[Link, ...]:
    """Joints 0 to 9 (right) and 10 to 19 (left) of humans.md section 2."""
    s, right = side[0], side == "right"
    y_limits = (-10, 30) if right else (-30, 10)
    shoulder = (5, 198) if right else (-198, -5)
    wrist = (-27, 47) if right else (-47, 27)
    return (
        Link(f"{side}_girdle", "chest", (
            Joint(f"{s}_clavicle_x", X, -10, 10, True),
            Joint(f"{s}_clavicle_y", Y, *y_limits, True),
            Joint(f"{s}_clavicle_z", Z, -35, 35, True)), 0.05),
        Link(f"{side}_upper_arm", f"{side}_girdle", (
            Joint(f"{s}_shoulder_y", Y, *shoulder, True),
            Joint(f"{s}_shoulder_x", X, -188, 61, True),
            Joint(f"{s}_shoulder_z", Z, -90, 90, True)), 0.033),
        Link(f"{side}_forearm", f"{side}_upper_arm", (
            Joint(f"{s}_elbow_x", X, -128, 0, True),
            Joint(f"{s}_forearm_roll_z", Z, -90, 90, True)), 0.019),
        Link(f"{side}_hand", f"{side}_forearm", (
            Joint(f"{s}_wrist_x", X, -81, 90, True),
            Joint(f"{s}_wrist_y", Y, *wrist, True)), 0.0065),
    )  # fmt: skip


def _leg(side: str) -> tuple[Link, ...]:
    """Joints 28 to 34 (right) and 35 to 41 (left) of humans.md section 2."""
    s, right = side[0], side == "right"
    hip_y, hip_z = ((-40, 45), (-45, 40)) if right else ((-45, 40), (-40, 45))
    ankle_y, ankle_z = ((-23, 24), (-43, 35)) if right else ((-24, 23), (-35, 43))
    return (
        Link(f"{side}_thigh", "hips", (
            Joint(f"{s}_hip_x", X, -127, 30, False),
            Joint(f"{s}_hip_y", Y, *hip_y, False),
            Joint(f"{s}_hip_z", Z, *hip_z, False)), 0.105),
        Link(f"{side}_shin", f"{side}_thigh", (Joint(f"{s}_knee_x", X, 0, 130, False),), 0.0475),
        Link(f"{side}_foot", f"{side}_shin", (
            Joint(f"{s}_ankle_x", X, -35, 38, False),
            Joint(f"{s}_ankle_y", Y, *ankle_y, False),
            Joint(f"{s}_ankle_z", Z, *ankle_z, False)), 0.014),
    )  # fmt: skip


LINKS: tuple[Link, ...] = (
    Link("chest", "", (), 0.10),
    *_arm("right"),
    *_arm("left"),
    Link("neck", "chest", (Joint("neck_x", X, -10, 20, True),), 0.01),
    Link("head", "neck", (
        Joint("head_x", X, -50, 50, True),
        Joint("head_y", Y, -34, 34, True),
        Joint("head_z", Z, -70, 70, True)), 0.07),
    Link("waist", "chest", (), 0.13),
    Link("hips", "waist", (
        Joint("pelvis_x", X, -75, 30, False),
        Joint("pelvis_y", Y, -30, 30, False),
        Joint("pelvis_z", Z, -30, 30, False)), 0.14),
    *_leg("right"),
    *_leg("left"),
)  # fmt: skip
"""Every link, parents first. The fixed joint 24 (waist) of AG's 42 is the waist's weld."""

LINK = {link.name: link for link in LINKS}
JOINTS: dict[str, Joint] = {joint.name: joint for link in LINKS for joint in link.joints}
RIGHT_ARM = tuple(j.name for link in _arm("right") for j in link.joints)
LEFT_ARM = tuple(j.name for link in _arm("left") for j in link.joints)
RIGHT_ARM_LINKS = ("right_upper_arm", "right_forearm", "right_hand")
"""Their origins are the shoulder, the elbow and the wrist."""
HEAD = ("neck_x", "head_x", "head_y", "head_z")


@dataclass(frozen=True)
class Shape:
    """A collision shape of a link: capsule (radius, cylinder length) or sphere (radius)."""

    axis: str  # "x", "y", "z", or "" for a sphere
    radius: Array
    length: Array
    centre: tuple[Array, Array, Array]


SHAPES: dict[str, str] = {**{x.name: x.name for x in LINKS}, "face": "head", "nose": "head"}
"""Collision shapes and the links they belong to: a link's own, then what else the head has."""


def shapes_of(links: Iterable[str]) -> tuple[str, ...]:
    """Names of the collision shapes of links, link by link, each link's own first."""
    return tuple(s for link in links for s, owner in SHAPES.items() if owner == link)


def offsets(link: str, d: Dims) -> tuple[Array, ...]:
    """Where each joint of a link lies, from the one before (the first from the parent) [m]."""
    side = -1.0 if link.startswith("right") else 1.0
    zero = 0.0 * d.mass
    kind = link.split("_", 1)[1] if link.split("_")[0] in ("right", "left") else link
    first = {
        "chest": (zero, zero, zero),
        "girdle": (zero, zero, d.clavicle),
        "upper_arm": (side * d.shoulder_x, zero, zero),
        "forearm": (zero, zero, -d.upper_arm_l),
        "hand": (zero, zero, -d.wrist_z),
        "neck": (zero, zero, d.neck_z),
        "head": (zero, zero, d.head_z),
        "waist": (zero, zero, -d.waist_z),
        "hips": (zero, zero, -d.pelvis_z),
        "thigh": (side * d.hip_x, zero, -d.pelvis_z),
        "shin": (zero, zero, -d.thigh_l),
        "foot": (zero, zero, -d.ankle_z),
    }[kind]
    rest = (zero, zero, zero)
    count = max(1, len(LINK[link].joints))
    if kind == "girdle":  # joint 0 at one clavicle length, joints 1 and 2 at two
        return (first, first, rest)
    return (first, *([rest] * (count - 1)))


def shape(name: str, d: Dims) -> Shape:
    """One of ``SHAPES``, in its link's frame. AG v0.1 human_creation.py; humans.md sections 3 and 4."""
    side = -1.0 if name.startswith("right") else 1.0
    zero = 0.0 * d.mass
    kind = name.split("_", 1)[1] if name.split("_")[0] in ("right", "left") else name
    middle = (zero, zero, zero)
    return {
        "chest": Shape("x", d.chest_r, d.chest_l, middle),
        "girdle": Shape("x", d.girdle_r, d.girdle_l, (side * d.girdle_x, zero, zero)),
        "upper_arm": Shape("z", d.upper_arm_r, d.upper_arm_l, (zero, zero, -d.upper_arm_l / 2)),
        "forearm": Shape("z", d.forearm_r, d.forearm_l, (zero, zero, -d.forearm_l / 2)),
        "hand": Shape("", d.hand_r, zero, (zero, zero, -d.hand_r)),
        "neck": Shape("z", d.neck_r, d.neck_l, (zero, zero, d.neck_centre)),
        "head": Shape(
            "z",
            d.head_r,
            d.head_high - d.head_low,
            (zero, d.head_y, (d.head_low + d.head_high) / 2),
        ),
        "face": Shape(
            "z",
            d.face_r,
            d.face_high - d.face_low,
            (zero, d.face_y, (d.face_low + d.face_high) / 2),
        ),
        "nose": Shape(
            "z",
            d.nose_r,
            d.nose_high - d.nose_low,
            (zero, d.nose_y, (d.nose_low + d.nose_high) / 2),
        ),
        "waist": Shape("x", d.waist_r, d.waist_l, middle),
        "hips": Shape("x", d.hips_r, d.hips_l, (zero, zero, -d.pelvis_z)),
        "thigh": Shape("z", d.thigh_r, d.thigh_l, (zero, zero, -d.thigh_l / 2)),
        "shin": Shape("z", d.shin_r, d.shin_l, (zero, zero, -d.shin_l / 2)),
        "foot": Shape("y", d.foot_r, d.foot_l, (zero, d.foot_y, d.foot_z)),
    }[kind]


def solid_inertia(s: Shape, mass: Array) -> tuple[Array, Array, Array]:
    """Principal moments (about x, y, z of the link frame) of a solid capsule or sphere [kg m^2]."""
    r, length = s.radius, s.length
    cylinder, ball = math.pi * r**2 * length, 4.0 / 3.0 * math.pi * r**3
    m_cylinder, m_ball = mass * cylinder / (cylinder + ball), mass * ball / (cylinder + ball)
    along = m_cylinder * r**2 / 2 + m_ball * 2 * r**2 / 5
    across = (
        m_cylinder * (length**2 / 12 + r**2 / 4)
        + m_ball * (2 * r**2 / 5 + length**2 / 4 + 3 * length * r / 8)
    )  # fmt: skip
    return {
        "x": (along, across, across),
        "y": (across, along, across),
        "z": (across, across, along),
        "": (along, along, along),
    }[s.axis]


AG_MASS = {"waist": 1e-9, "hips": 0.27}
"""Shares of the mass that are not a link's own where every centre of mass is at the joint: AG's waist weighs
nothing, its 13 % are on a link without a shape beside the hips."""


def box_inertia(s: Shape, mass: Array) -> tuple[Array, Array, Array]:
    """Moments of the box around a shape, about x, y, z of the link frame [kg m^2], as Bullet has them."""
    x, y, z = ((2.0 * s.radius + (s.length if s.axis == a else 0.0)) ** 2 for a in "xyz")
    return mass / 12.0 * (y + z), mass / 12.0 * (x + z), mass / 12.0 * (x + y)


def joint_limits(names: tuple[str, ...], limit_scale: Array = 1.0, xp: Any = jnp) -> Array:
    """Lower and upper limits [rad] of joints, narrowed by an impairment (AG: both are multiplied).

    Args:
        names: joints.
        limit_scale: 1 for a full range of motion, at least 0.5 otherwise. Shape ().
        xp: numpy or jax.numpy.

    Returns:
        (len(names), 2)
    """
    radians, scaled = _full_limits(tuple(names))
    return xp.where(scaled, limit_scale, 1.0) * radians


@cache
def _full_limits(names: tuple[str, ...]) -> tuple[np.ndarray, np.ndarray]:
    """Limits without impairment [rad] (n, 2), and which of them an impairment narrows (n, 1)."""
    for name in names:
        if name not in JOINTS:
            raise UnknownNameError("human joint", name, JOINTS)
    degrees = np.array([(JOINTS[n].lower, JOINTS[n].upper) for n in names], np.float32)
    return np.deg2rad(degrees), np.array([JOINTS[n].scaled for n in names])[:, None]


class BodyFields(NamedTuple):
    """What differs between people in a MuJoCo model; rows follow LINKS, SHAPES and the free joints.

    Links that hang on the world through welded joints only are posed in the world, the others in
    their parent's frame: flat trees are what MJX compiles and runs fastest.
    """

    body_pos: Array  # (19, 3)
    body_quat: Array  # (19, 4) wxyz
    body_mass: Array  # (19,)
    body_ipos: Array  # (19, 3)
    body_inertia: Array  # (19, 3)
    geom_size: Array  # (21, 3)
    geom_pos: Array  # (21, 3)
    geom_rbound: Array  # (21,)
    jnt_pos: Array  # (n_free, 3)
    jnt_range: Array  # (n_free, 2)


def is_free(link: Link, free: tuple[str, ...]) -> bool:
    """Whether a link's joints are hinges in the scene."""
    return bool(link.joints) and link.joints[0].name in free


def parent_in_model(link: Link, free: tuple[str, ...]) -> str:
    """Name of the link that carries this one in the model; "" is the world."""
    above = link.parent
    while above and not is_free(LINK[above], free):
        above = LINK[above].parent
    return link.parent if above else ""


def fields(
    d: Dims,
    angles: Mapping[str, Array],
    free: tuple[str, ...],
    limit_scale: Array = 1.0,
    root: Array = (0.0, 0.0, 0.0),
    root_quat: Array = (1.0, 0.0, 0.0, 0.0),
    xp: Any = jnp,
    at_joints: Array = 0.0,
) -> BodyFields:
    """The person's rows of a MuJoCo model.

    Args:
        d: sizes.
        angles: joint -> angle [rad] of the welded joints; missing ones are 0. Clamped to the limits.
        free: joints that stay hinges. All joints of a link are free, or none.
        limit_scale: of the person's impairment. Shape ().
        root: position of the chest, world [m] (3,).
        root_quat: orientation of the chest, world (4,) wxyz.
        xp: numpy or jax.numpy.
        at_joints: 1 where masses are AG's, with their centres at the joints, 0 where the body is. Shape ().
    """
    rows: dict[str, list] = {name: [] for name in ("body_pos", "body_quat", "jnt_pos")}
    world: dict[str, tuple[Array, Array]] = {}  # poses of links that do not move
    zero = 0.0 * d.mass
    bent = _bent(angles, free, limit_scale, zero, xp)
    for link in LINKS:
        pivots = [joined(o, xp) for o in offsets(link.name, d)]
        if not link.parent:
            pos, quat = xp.asarray(root) + pivots[0], xp.asarray(root_quat) + zero
        elif is_free(link, free):
            pos, quat = sum(pivots[1:], pivots[0]), xp.asarray((1.0, 0.0, 0.0, 0.0)) + zero
            for i in range(len(link.joints)):
                rows["jnt_pos"].append(-sum(pivots[i + 1 :], 0.0 * pivots[0]))
        else:
            pos, quat = _welded(link, pivots, bent, xp)
        if link.parent and not parent_in_model(link, free):
            parent_pos, parent_quat = world[link.parent]
            pos = parent_pos + rotate(parent_quat, pos, xp)
            quat = quat_mul(parent_quat, quat, xp)
        if not parent_in_model(link, free) and not is_free(link, free):
            world[link.name] = (pos, quat)
        rows["body_pos"].append(pos)
        rows["body_quat"].append(quat)
    shapes = [shape(name, d) for name in SHAPES]
    radius, half = (
        joined(values, xp)
        for values in ([s.radius for s in shapes], [s.length / 2 for s in shapes])
    )
    masses = [link.mass * d.mass for link in LINKS]
    own = list(zip(shapes[: len(LINKS)], masses, strict=True))
    inertia = xp.stack([joined(solid_inertia(s, m), xp) for s, m in own])
    boxes = xp.stack([joined(box_inertia(s, m), xp) for s, m in own])
    at = xp.asarray(at_joints)
    mass = joined(masses, xp)
    ag_mass = joined([AG_MASS.get(x.name, x.mass) * d.mass for x in LINKS], xp)
    centre = xp.stack([joined(s.centre, xp) for s in shapes])
    moving = tuple(j.name for link in LINKS if is_free(link, free) for j in link.joints)
    return BodyFields(
        body_pos=xp.stack(rows["body_pos"]),
        body_quat=xp.stack(rows["body_quat"]),
        body_mass=mass + at * (ag_mass - mass),
        body_ipos=(1.0 - at) * centre[: len(LINKS)],
        body_inertia=inertia + at * (boxes - inertia),
        geom_size=xp.stack([radius, half, 0.0 * radius], -1),
        geom_pos=centre,
        geom_rbound=radius + half,
        jnt_pos=xp.stack(rows["jnt_pos"]) if moving else xp.zeros((0, 3)),
        jnt_range=joint_limits(moving, limit_scale, xp) if moving else xp.zeros((0, 2)),
    )


def _bent(
    angles: Mapping[str, Array], free: tuple[str, ...], limit_scale: Array, zero: Array, xp: Any
) -> dict[str, Array]:
    """Angles of the welded joints that are not 0 [rad]: as given, or the limit nearest to 0, as for a shoulder."""
    welded = [j for link in LINKS if link.parent and not is_free(link, free) for j in link.joints]
    names = tuple(j.name for j in welded if j.name in angles or not j.lower <= 0.0 <= j.upper)
    if not names:
        return {}
    low, high = joint_limits(names, limit_scale, xp).T
    wanted = joined([angles.get(name, zero) for name in names], xp)
    return dict(zip(names, split(xp.clip(wanted, low, high)), strict=True))


def _welded(link: Link, pivots: list, bent: Mapping[str, Array], xp: Any) -> tuple[Array, Array]:
    """Pose of a link in its parent's frame with its joints at fixed angles."""
    pos, quat = pivots[0], xp.asarray((1.0, 0.0, 0.0, 0.0))
    for i, joint in enumerate(link.joints):
        if i:
            pos = pos + rotate(quat, pivots[i], xp)
        if joint.name in bent:
            turn = axis_angle_quat(np.array(joint.axis), bent[joint.name], xp)
            quat = quat_mul(quat, turn, xp)
    return pos, quat
