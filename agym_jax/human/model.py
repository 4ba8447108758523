"""The person as a MuJoCo model: bodies and collision shapes, and looks for pictures."""

from __future__ import annotations

import mujoco
import numpy as np

from agym_jax.human.anthropometry import Dims
from agym_jax.human.body import (
    LINKS,
    SHAPES,
    BodyFields,
    is_free,
    parent_in_model,
    shape,
    shapes_of,
)
from agym_jax.human.muscles import LIMIT_MARGIN

SKIN = (0.87, 0.68, 0.55, 1.0)
SHIRT = (0.36, 0.55, 0.66, 1.0)
TROUSERS = (0.24, 0.27, 0.36, 1.0)
SHOES = (0.16, 0.15, 0.16, 1.0)
HAIR = (0.25, 0.17, 0.12, 1.0)
LIPS = (0.72, 0.40, 0.37, 1.0)
EYES = (0.12, 0.10, 0.10, 1.0)
CLOTHES = {
    "chest": SHIRT, "girdle": SHIRT, "waist": SHIRT, "hips": TROUSERS,
    "thigh": TROUSERS, "shin": TROUSERS, "foot": SHOES,
}  # fmt: skip

SKIN_ARMATURE = 0.01
"""Rotor-like inertia of the person's hinges [kg m^2]: keeps light wrists stable. An estimate."""


def build(
    rows: BodyFields, free: tuple[str, ...], d: Dims, links: tuple[str, ...], visual: bool
) -> mujoco.MjSpec:
    """The person as an MjSpec whose collision geoms carry the names of ``body.SHAPES``.

    Args:
        rows: of ``body.fields``, in NumPy.
        free: joints that are hinges; the others are welded.
        d: sizes, for the looks.
        links: which links the model has, at least the moving ones and those that carry them.
        visual: add the geoms that people look at (group 2).
    """
    spec = mujoco.MjSpec()
    spec.compiler.degree = False
    bodies = {"": spec.worldbody}
    n_free = 0
    for i, link in enumerate(LINKS):
        if link.name not in links:
            continue
        body = bodies[parent_in_model(link, free)].add_body(
            name=link.name,
            pos=rows.body_pos[i],
            quat=rows.body_quat[i],
            mass=float(rows.body_mass[i]),
            ipos=rows.body_ipos[i],
            iquat=(1, 0, 0, 0),
            inertia=rows.body_inertia[i],
            explicitinertial=True,
        )
        bodies[link.name] = body
        for joint in link.joints if is_free(link, free) else ():
            body.add_joint(
                name=joint.name,
                type=mujoco.mjtJoint.mjJNT_HINGE,
                axis=joint.axis,
                pos=rows.jnt_pos[n_free],
                range=rows.jnt_range[n_free],
                limited=mujoco.mjtLimited.mjLIMITED_TRUE,
                margin=LIMIT_MARGIN,
                armature=SKIN_ARMATURE,
                damping=1.0,  # replaced per person, see muscles.damping
            )
            n_free += 1
        for name in shapes_of([link.name]):
            s, row = shape(name, d), list(SHAPES).index(name)
            body.add_geom(
                name=name,
                type=mujoco.mjtGeom.mjGEOM_CAPSULE if s.axis else mujoco.mjtGeom.mjGEOM_SPHERE,
                size=rows.geom_size[row],
                pos=rows.geom_pos[row],
                quat=_AXIS_QUAT[s.axis],
                contype=0,
                conaffinity=0,
                group=2 if visual and link.name != "head" else 3,
                rgba=_colour(link.name),
            )
    if visual:
        _dress(bodies, d)
    return spec


_H = np.sqrt(0.5)
_AXIS_QUAT = {"x": (_H, 0, _H, 0), "y": (_H, _H, 0, 0), "z": (1, 0, 0, 0), "": (1, 0, 0, 0)}


def _colour(link: str) -> tuple[float, ...]:
    kind = link.split("_", 1)[1] if link.split("_")[0] in ("right", "left") else link
    return CLOTHES.get(kind, SKIN)


def _dress(bodies: dict, d: Dims) -> None:
    """Looks only: head and face, hair, sleeves, elbows. Nothing here takes part in physics."""
    capsule, sphere = mujoco.mjtGeom.mjGEOM_CAPSULE, mujoco.mjtGeom.mjGEOM_SPHERE
    ellipsoid = mujoco.mjtGeom.mjGEOM_ELLIPSOID

    def add(body: str, kind, size, pos, rgba, quat=(1, 0, 0, 0)) -> None:
        bodies[body].add_geom(
            type=kind, size=np.array(size, float), pos=np.array(pos, float), quat=quat,
            rgba=rgba, group=2, contype=0, conaffinity=0, mass=0,
        )  # fmt: skip

    r, y, low, high = (float(v) for v in (d.head_r, d.head_y, d.head_low, d.head_high))
    mouth_y, mouth_z = float(d.mouth_y), float(d.mouth_z)
    middle = (low + high) / 2
    skull = (0.91 * r, 1.06 * r, r + (high - low) / 2 - 0.004)
    add("head", ellipsoid, skull, (0, y, middle), SKIN)
    # jaw and lips: the mouth lies on the surface
    add("head", ellipsoid, (0.58 * r, 0.055, 0.045), (0, mouth_y + 0.05, mouth_z - 0.004), SKIN)
    add("head", ellipsoid, (0.021, 0.007, 0.007), (0, mouth_y + 0.004, mouth_z), LIPS)
    face = y - 1.06 * r
    tip, nose_z = float(d.nose_y - d.nose_r), float((d.nose_low + d.nose_high) / 2)
    add("head", ellipsoid, (0.012, 0.017, 0.018), (0, tip + 0.017, nose_z + 0.003), SKIN)
    for side in (-1, 1):
        add(
            "head",
            ellipsoid,
            (0.010, 0.006, 0.0065),
            (side * 0.030, face + 0.0125, mouth_z + 0.063),
            (0.97, 0.97, 0.95, 1),
        )
        add("head", sphere, (0.0052, 0, 0), (side * 0.030, face + 0.0085, mouth_z + 0.063), EYES)
        add(
            "head",
            ellipsoid,
            (0.015, 0.005, 0.0028),
            (side * 0.030, face + 0.010, mouth_z + 0.081),
            HAIR,
        )
        add(
            "head",
            ellipsoid,
            (0.008, 0.014, 0.023),
            (side * 0.92 * r, y + 0.008, middle - 0.012),
            SKIN,
        )
    add(
        "head",
        ellipsoid,
        (1.03 * skull[0], 1.02 * skull[1], 0.80 * skull[2]),
        (0, y + 0.018, middle + 0.040),
        HAIR,
    )
    # belly and neck line close the gaps between the torso's capsules
    chest_r, waist_r = float(d.chest_r), float(d.waist_r)
    half = float(d.shoulder_x) - 0.03
    add("chest", ellipsoid, (half, 0.86 * chest_r, 0.155), (0, 0.004, 0.005), SHIRT)
    add(
        "waist",
        ellipsoid,
        (0.93 * (waist_r + float(d.waist_l) / 2 + 0.02), 0.95 * waist_r, 0.16),
        (0, 0, 0.03),
        SHIRT,
    )
    for side in ("right", "left"):
        sign = -1.0 if side == "right" else 1.0
        upper, fore = float(d.upper_arm_r), float(d.forearm_r)
        elbow = (upper + fore) / 2
        add(f"{side}_forearm", sphere, (elbow, 0, 0), (0, 0.006, 0), SKIN)
        sleeve = float(d.upper_arm_l) * 0.42
        add(
            f"{side}_upper_arm", capsule, (upper + 0.006, sleeve / 2, 0), (0, 0, -sleeve / 2), SHIRT
        )
        hand = float(d.hand_r)
        for finger in range(4):
            x = (finger - 1.5) * 0.42 * hand
            add(f"{side}_hand", capsule, (0.19 * hand, 0.5 * hand, 0), (x, 0, -2.25 * hand), SKIN)
        add(
            f"{side}_hand",
            capsule,
            (0.2 * hand, 0.45 * hand, 0),
            (-sign * 0.85 * hand, -0.2 * hand, -1.45 * hand),
            SKIN,
            (0.95, 0, -sign * 0.3, 0),
        )
        add(f"{side}_shin", sphere, (float(d.shin_r) + 0.012, 0, 0), (0, 0, 0), TROUSERS)
        add(f"{side}_foot", sphere, (float(d.foot_r), 0, 0), (0, 0, 0.01), TROUSERS)
