"""The wiper on the arm.

Assistive Gym's wiper was lowered onto the middle of a limb in 648 orientations (man and woman, upper arm and forearm,
long side along and across the limb, pitch and roll from -40 to 40 degrees) and held with at most 10 N. Here the same
wiper, with the rims that touch in the task, is pressed with 10 N onto the same limb in C MuJoCo. Points are those that
the task would wipe: within 2.5 cm of the pad's contact.
"""

from __future__ import annotations

import itertools
from typing import NamedTuple

import mujoco
import numpy as np

from agym_jax.data.assets import asset_path
from agym_jax.human.anthropometry import dims
from agym_jax.human.body import shape
from agym_jax.sim.contacts import SOLIMP, SOLREF
from agym_jax.tasks.bed_bathing import BED_BATHING, WIPER
from benchmarks.parity.row import Row, traces

ANGLES = np.deg2rad(np.arange(-40, 41, 10))
PRESS = 10.0  # [N]
DAMPING, STEPS = 100.0, 40  # of the slide [N s/m], physics steps until it is at rest
CASES = tuple(itertools.product(("male", "female"), (5, 7), (0, 1)))
"""Sex, AG's link (upper arm, forearm), whether the long side lies across."""
LIMBS = {5: "right_upper_arm", 7: "right_forearm"}


class Touch(NamedTuple):
    """How the pressed wiper touches the limb, for every pitch and roll."""

    pad_bears: np.ndarray  # rather than the plate, bool                       (9, 9)
    point: np.ndarray  # of the pad's contact in the limb's frame, NaN if none [m] (9, 9, 3)
    height: np.ndarray  # of the cloth's centre above the top of the limb [m]   (9, 9)


def rotation(axis: int, angle: float) -> np.ndarray:
    """Rotation matrix about a coordinate axis."""
    turn, i, j = np.eye(3), (axis + 1) % 3, (axis + 2) % 3
    turn[i, i] = turn[j, j] = np.cos(angle)
    turn[j, i], turn[i, j] = np.sin(angle), -np.sin(angle)
    return turn


def orientation(limb: np.ndarray, across: int, pitch: float, roll: float) -> np.ndarray:
    """Of the wiper in the world: x along the limb, level; then yaw, pitch about its y, roll about its x.

    Args:
        limb: its pose (7), middle (3) and axis (3).
        across: 1 turns the long side across.
        pitch: [rad].
        roll: [rad].
    """
    along = limb[10:13] * [1.0, 1.0, 0.0]
    along /= np.linalg.norm(along)
    level = np.column_stack([along, np.cross([0.0, 0.0, 1.0], along), [0.0, 0.0, 1.0]])
    return level @ rotation(2, across * np.pi / 2) @ rotation(1, pitch) @ rotation(0, roll)


def pressing_model(sex: str, link: int, limb: np.ndarray) -> mujoco.MjModel:
    """A wiper that slides up and down above a limb, with the contacts of the task."""
    form = shape(LIMBS[link], dims(float(sex == "female")))
    spec = mujoco.MjSpec()
    spec.option.timestep, spec.option.gravity = BED_BATHING.control.time_step, (0.0, 0.0, 0.0)
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    spec.option.cone = mujoco.mjtCone.mjCONE_PYRAMIDAL
    arm = spec.worldbody.add_body(name="limb", pos=limb[:3], quat=limb[[6, 3, 4, 5]])
    arm.add_geom(
        name="limb", type=mujoco.mjtGeom.mjGEOM_CAPSULE,
        size=[form.radius, form.length / 2, 0.0], pos=[float(x) for x in form.centre],
    )  # fmt: skip
    carriage = spec.worldbody.add_body(name="carriage")
    carriage.add_joint(type=mujoco.mjtJoint.mjJNT_SLIDE, axis=(0.0, 0.0, 1.0), damping=[DAMPING, 0, 0])  # fmt: skip
    spec.attach(
        mujoco.MjSpec.from_file(str(asset_path(WIPER.model))),
        frame=carriage.add_frame(),
        prefix="tool/",
    )
    mu = BED_BATHING.human.friction * WIPER.friction
    for name in WIPER.geoms:
        spec.add_pair(
            name=name, geomname1=f"tool/{name}", geomname2="limb", condim=3,
            friction=[mu, mu, 0.005, 1e-4, 1e-4], solref=SOLREF, solimp=SOLIMP,
        )  # fmt: skip
    return spec.compile()


def press(sex: str, link: int, across: int) -> Touch:
    """Press the wiper onto a limb in every orientation."""
    limb = traces("wiper")[f"{sex}_{link}_limb"].astype(float)
    model = pressing_model(sex, link, limb)
    data, target = mujoco.MjData(model), model.geom("limb").id
    rims = np.array([model.geom(f"tool/{g}").id for g in WIPER.geoms])
    tip, body = model.site(f"tool/{WIPER.tip}").pos, model.body("tool/wiper").id
    top = limb[9] + float(shape(LIMBS[link], dims(float(sex == "female"))).radius)
    quat, line = np.zeros(4), np.zeros(6)
    out = Touch(np.zeros((9, 9), bool), np.full((9, 9, 3), np.nan), np.zeros((9, 9)))
    for i, j in np.ndindex(9, 9):
        turn = orientation(limb, across, ANGLES[i], ANGLES[j])
        mujoco.mju_mat2Quat(quat, turn.ravel())
        model.body_quat[body] = quat
        model.body_pos[body] = [*limb[7:9], top + 0.09] - turn @ tip
        mujoco.mj_resetData(model, data)
        for _ in range(30):  # down to where it touches
            mujoco.mj_kinematics(model, data)
            gap = min(mujoco.mj_geomDistance(model, data, g, target, 1.0, line) for g in rims)
            data.qpos[0] -= gap
            if gap < 1e-6:
                break
        data.qfrc_applied[0] = -PRESS
        mujoco.mj_step(model, data, STEPS)
        mujoco.mj_forward(model, data)
        force, moment = _forces(model, data, rims)
        pad = slice(0, WIPER.n_working)
        out.pad_bears[i, j] = force[pad].sum() > force.sum() / 2
        out.height[i, j] = data.site_xpos[model.site(f"tool/{WIPER.tip}").id][2] - top
        if force[pad].sum() > 0:
            centre = moment[pad].sum(0) / force[pad].sum()
            out.point[i, j] = data.xmat[model.body("limb").id].reshape(3, 3).T @ (centre - limb[:3])
    return out


def _forces(model: mujoco.MjModel, data: mujoco.MjData, rims: np.ndarray) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
    """Normal force of each rim [N] and that times the place [N m]."""
    force, moment, wrench = np.zeros(len(rims)), np.zeros((len(rims), 3)), np.zeros(6)
    for k in range(data.ncon):
        mujoco.mj_contactForce(model, data, k, wrench)
        (row,) = np.flatnonzero(np.isin(rims, data.contact.geom[k]))
        force[row] += wrench[0]
        moment[row] += wrench[0] * data.contact.pos[k]
    return force, moment


def recorded(sex: str, link: int, across: int) -> Touch:
    """The same in Assistive Gym."""
    kept, name = traces("wiper"), f"{sex}_{link}_yaw{across}"
    limb = kept[f"{sex}_{link}_limb"].astype(float)
    top = limb[9] + float(shape(LIMBS[link], dims(float(sex == "female"))).radius)
    frame, quat = np.zeros(9), limb[[6, 3, 4, 5]]
    mujoco.mju_quat2Mat(frame, quat)
    point = np.full((9, 9, 3), np.nan)
    for i, j in np.ndindex(9, 9):
        turn = orientation(limb, across, ANGLES[i], ANGLES[j])
        centre = np.array([*limb[7:9], top + kept[f"{name}_height"][i, j]])
        world = centre + turn @ kept[f"{name}_point"][i, j]
        point[i, j] = frame.reshape(3, 3).T @ (world - limb[:3])
    return Touch(kept[f"{name}_pad_bears"], point, kept[f"{name}_height"])


def wiped(sex: str, link: int, point: np.ndarray) -> np.ndarray:
    """How many points of a limb lie within reach of contacts (n,).

    Args:
        sex: of the person.
        link: AG's.
        point: of the contacts in the limb's frame, NaN if none [m] (n, 3).
    """
    form = shape(LIMBS[link], dims(float(sex == "female")))
    places, exists = (np.asarray(x) for x in BED_BATHING._cover(form.length, form.radius))
    apart = np.linalg.norm(places[exists > 0] - point[:, None], axis=-1)
    return (apart < BED_BATHING.config.reach).sum(1)


def rows() -> list[Row]:
    """The comparison."""
    both = [{case: how(*case) for case in CASES} for how in (recorded, press)]
    theirs, ours = both
    same = {c: theirs[c].pad_bears & ours[c].pad_bears for c in CASES}
    away = np.concatenate([
        np.linalg.norm(theirs[c].point - ours[c].point, axis=-1)[same[c]] for c in CASES
    ])  # fmt: skip
    share = [
        [float(np.mean([x[c].pad_bears for c in CASES if c[2] == across])) for x in both]
        for across in (0, 1)
    ]
    other = float(sum(np.sum(theirs[c].pad_bears != ours[c].pad_bears) for c in CASES))
    height = [1e3 * float(np.median([x[c].height for c in CASES])) for x in both]
    gap = 1e3 * float(np.median(away))
    everywhere = {c: np.ones((9, 9), bool) for c in CASES}
    on_pad, on_any = ([_mean_wiped(x, which) for x in both] for which in (same, everywhere))
    bears = "share of orientations in which the pad bears the load, long side"
    most = "points wiped by a press, mean of all orientations"
    return [
        Row(f"{bears} along the limb", "", share[0][0], share[0][1], 0.02),
        Row(f"{bears} across the limb", "", share[1][0], share[1][1], 0.02),
        Row("orientations, of 648, in which another part bears it", "", 0.0, other, 13.0),
        Row("height of the pad above the limb, median", "mm", height[0], height[1], 1.0),
        Row("distance between both contacts of the pad, median", "mm", 0.0, gap, 1.0),
        Row("points wiped by a press, mean where the pad bears it", "", on_pad[0], on_pad[1], 0.05 * on_pad[0]),
        Row(most, "", on_any[0], on_any[1], 0.05 * on_any[0], "wiper-shape"),
    ]  # fmt: skip


def _mean_wiped(touches: dict[tuple, Touch], which: dict[tuple, np.ndarray]) -> float:
    """Points that one press wipes, on average over the orientations that are given."""
    return float(np.mean(np.concatenate([
        wiped(sex, link, touches[sex, link, across].point[which[sex, link, across]])
        for sex, link, across in CASES
    ])))  # fmt: skip
