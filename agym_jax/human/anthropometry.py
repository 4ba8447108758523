"""Sizes and masses of a person as smooth functions of sex, stature and girth.

Assistive Gym v0.1 ``human_creation.py`` has one table for men and one for women (50th percentile)
with two scales: ``height_scale`` for lengths along the body and ``radius_scale`` for radii. Here
both tables are evaluated at the person's scales and blended by ``sex`` (0 male, 1 female), so that
sizes may also be drawn between and beyond them. All values in metres and kilograms. Everything
works on floats, NumPy and JAX arrays alike. Heads are the same whatever the scales, as AG's meshes are.

DEVIATION(head-capsules): the head is three upright capsules, fitted to rays on AG's eight or nine convex
hulls: skull, lower face with lips, and nose. Within 25 mm of the mouth the surfaces are at most 3.0 mm apart
(1.3 mm in the mean), over the 10 cm around it 2.0 mm in the mean and 8.5 mm at most, where the cheeks end; the
whole head, with ears, 5 to 6 mm in the mean. Hulls would cost more than all other contacts of a meal.
"""

from __future__ import annotations

from typing import Any, NamedTuple

Scalar = Any  # float, np.ndarray () or jax.Array ()


class Dims(NamedTuple):
    """Sizes of one body: radii ``*_r`` and cylinder lengths ``*_l`` of its capsules, joint offsets."""

    chest_r: Scalar
    chest_l: Scalar
    girdle_r: Scalar
    girdle_l: Scalar
    girdle_x: Scalar  # centre of the girdle capsule beside the spine
    clavicle: Scalar  # chest to clavicle pivot, and once more to the next
    neck_z: Scalar
    neck_r: Scalar
    neck_l: Scalar
    neck_centre: Scalar
    head_z: Scalar
    head_r: Scalar
    head_y: Scalar  # of the skull capsule, whose ends are:
    head_low: Scalar
    head_high: Scalar
    face_r: Scalar
    face_y: Scalar  # of the jaw and lips, whose ends are:
    face_low: Scalar
    face_high: Scalar
    nose_r: Scalar
    nose_y: Scalar
    nose_low: Scalar
    nose_high: Scalar
    mouth_y: Scalar
    mouth_z: Scalar
    shoulder_x: Scalar
    upper_arm_r: Scalar
    upper_arm_l: Scalar  # shoulder to elbow
    forearm_r: Scalar
    forearm_l: Scalar
    wrist_z: Scalar  # elbow to wrist
    hand_r: Scalar
    waist_z: Scalar
    waist_r: Scalar
    waist_l: Scalar
    pelvis_z: Scalar
    hips_r: Scalar
    hips_l: Scalar
    hip_x: Scalar
    thigh_r: Scalar
    thigh_l: Scalar
    shin_r: Scalar
    shin_l: Scalar
    ankle_z: Scalar
    foot_r: Scalar
    foot_l: Scalar
    foot_y: Scalar
    foot_z: Scalar
    mass: Scalar


def _male(h: Scalar, r: Scalar) -> Dims:
    """AG v0.1 human_creation.py, gender 'male' (reference humans.md sections 1 to 4)."""
    return Dims(
        chest_r=0.127 * r, chest_l=0.056 + 0.0 * r,
        girdle_r=0.106 * r, girdle_l=0.253 / 8 + 0.0 * r, girdle_x=0.253 / 2.5 - 0.253 / 16 + 0.0 * r,
        clavicle=0.1415 / 2 * h,
        neck_z=0.1515 * h, neck_r=0.06 * r, neck_l=0.124 * h, neck_centre=0.09 * h,
        head_z=(0.399 - 0.1415 - 0.1205) * h,
        head_r=0.0798 + 0.0 * h, head_y=-0.0244 + 0.0 * h, head_low=0.0507 + 0.0 * h, head_high=0.12 + 0.0 * h,
        face_r=0.0361 + 0.0 * h, face_y=-0.0762 + 0.0 * h, face_low=0.0236 + 0.0 * h, face_high=0.0629 + 0.0 * h,
        nose_r=0.0164 + 0.0 * h, nose_y=-0.1079 + 0.0 * h, nose_low=0.0611 + 0.0 * h, nose_high=0.0673 + 0.0 * h,
        mouth_y=-0.11 + 0.0 * h, mouth_z=0.03 + 0.0 * h,
        shoulder_x=0.106 * r + 0.073,
        upper_arm_r=0.043 * r, upper_arm_l=0.279 * h,
        forearm_r=0.033 * r, forearm_l=0.257 * h, wrist_z=0.033 * r + 0.257 * h,
        hand_r=0.043 * r,
        waist_z=0.156 * h, waist_r=0.1205 * r, waist_l=0.049 + 0.0 * r,
        pelvis_z=0.08125 * h, hips_r=0.1335 * r, hips_l=0.094 + 0.0 * r,
        hip_x=0.08 * r + 0.009,
        thigh_r=0.08 * r, thigh_l=0.424 * h,
        shin_r=0.05 * r, shin_l=0.403 * h, ankle_z=0.403 * h + 0.025,
        foot_r=0.05 * r, foot_l=0.215 * h, foot_y=-0.1 * h, foot_z=-0.025 * r,
        mass=78.4 * h * r * r,
    )  # fmt: skip


def _female(h: Scalar, r: Scalar) -> Dims:
    """AG v0.1 human_creation.py, gender 'female' (reference humans.md sections 1 to 4)."""
    return Dims(
        chest_r=0.127 * r, chest_l=0.010 + 0.0 * r,
        girdle_r=0.092 * r, girdle_l=0.225 / 8 + 0.0 * r, girdle_x=0.225 / 2.5 - 0.225 / 16 + 0.0 * r,
        clavicle=0.132 / 2 * h,
        neck_z=0.132 * h, neck_r=0.05 * r, neck_l=0.121 * h, neck_centre=0.09 * h,
        head_z=0.12 * h,
        head_r=0.0749 + 0.0 * h, head_y=-0.018 + 0.0 * h, head_low=0.0595 + 0.0 * h, head_high=0.1095 + 0.0 * h,
        face_r=0.0372 + 0.0 * h, face_y=-0.0617 + 0.0 * h, face_low=0.0269 + 0.0 * h, face_high=0.0495 + 0.0 * h,
        nose_r=0.0145 + 0.0 * h, nose_y=-0.0964 + 0.0 * h, nose_low=0.0528 + 0.0 * h, nose_high=0.0665 + 0.0 * h,
        mouth_y=-0.10 + 0.0 * h, mouth_z=0.03 + 0.0 * h,
        shoulder_x=0.092 * r + 0.067,
        upper_arm_r=0.0355 * r, upper_arm_l=0.264 * h,
        forearm_r=0.027 * r, forearm_l=0.234 * h, wrist_z=0.027 * r + 0.234 * h,
        hand_r=0.0355 * r,
        waist_z=0.15 * h, waist_r=0.11 * r, waist_l=0.009 + 0.0 * r,
        pelvis_z=0.075 * h, hips_r=0.127 * r, hips_l=0.117 + 0.0 * r,
        hip_x=0.0775 * r + 0.0145,
        thigh_r=0.0775 * r, thigh_l=0.391 * h,
        shin_r=0.045 * r, shin_l=0.367 * h, ankle_z=0.367 * h + 0.0225,
        foot_r=0.045 * r, foot_l=0.195 * h, foot_y=-0.09 * h, foot_z=-0.0225 * r,
        mass=62.5 * h * r * r,
    )  # fmt: skip


def dims(sex: Scalar = 0.0, stature: Scalar = 1.0, girth: Scalar = 1.0) -> Dims:
    """Sizes of one person.

    Args:
        sex: 0 male, 1 female; values between and a little beyond blend the tables. Shape ().
        stature: AG's height_scale, multiplies lengths and mass. Shape ().
        girth: AG's radius_scale, multiplies radii and, squared, mass. Shape ().
    """
    male, female = _male(stature, girth), _female(stature, girth)
    return Dims(*(m + sex * (f - m) for m, f in zip(male, female, strict=True)))


def sitting_height(d: Dims, sex: Scalar, stature: Scalar, girth: Scalar) -> Scalar:
    """Height of the chest [m] of a person whose thighs rest on the seat as AG's two people's do.

    AG puts the chest at 0.89 m (male) or 0.86 m (female); other sizes keep the thigh's underside
    where the blend of those two has it.
    """
    reference = dims(sex)
    drop = d.waist_z + 2 * d.pelvis_z + d.thigh_r
    reference_drop = reference.waist_z + 2 * reference.pelvis_z + reference.thigh_r
    return 0.89 - 0.03 * sex + (drop - reference_drop) + 0.0 * (stature + girth)
