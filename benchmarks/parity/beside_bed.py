"""The arm beside the bed.

Postures of ArmManipulation episodes that were played in AG: how far Jaco's third link, which lies on the nightstand's edge in most
of them, is from the nightstand, and how far the person's hanging forearm and hand are from its front; AG's distances are Bullet's between
convex hulls. And the limp arm that lies on the bed's edge, 1 s after the start, when a force at the elbow suddenly pushes it along the bed
towards the feet (ten people, AG's masses, no robot).
"""

from __future__ import annotations

import copy
import functools

import mujoco
import numpy as np

from agym_jax.human import body
from agym_jax.robots import ROBOTS
from agym_jax.sim.scene import build_scene
from agym_jax.tasks import TASKS
from benchmarks.parity.limp_arm import Person
from benchmarks.parity.row import Row, traces

TASK, ROBOT = TASKS["ArmManipulation"], ROBOTS["Jaco"]
NIGHTSTAND = "mount/nightstand_collision"
FORE = {7: "human/right_forearm", 9: "human/right_hand"}  # links of AG's person


def robot_distances() -> tuple[np.ndarray, np.ndarray]:
    """Of Jaco's third link from the nightstand, here and in AG [m] (n,), (n,)."""
    t, scene = traces("beside_bed"), build_scene(TASK, ROBOT)
    model, index = copy.copy(scene.model), scene.index
    link, stand = (model.geom(x).id for x in ("robot/link_3_corners", NIGHTSTAND))
    data, ours = mujoco.MjData(model), []
    for base, angles in zip(t["robot_base"], t["robot_arm"], strict=True):
        model.body_pos[[index.robot_base, *index.mount]] = base[:3]
        model.body_quat[index.robot_base] = base[[6, 3, 4, 5]]
        data.qpos[index.robot_qpos] = angles
        mujoco.mj_kinematics(model, data)
        ours.append(mujoco.mj_geomDistance(model, data, link, stand, 1.0, None))
    return np.array(ours), t["robot_distance"]


def person_distances() -> tuple[np.ndarray, np.ndarray]:
    """Of forearm or hand from what they meet of the nightstand, here and in AG [m] (n,), (n,)."""
    t, ours = traces("beside_bed"), []
    front = f"mount/{ROBOT.mount_fronts['bed'][0]}"
    for i, link in enumerate(t["person_link"]):
        who = _lying("person", i)
        model, index = who.model, who.scene.index
        model.body_pos[index.mount] = t["person_base"][i, :3]
        data = mujoco.MjData(model)
        data.qpos[index.human_qpos] = t["person_q"][i, : len(body.RIGHT_ARM)]
        mujoco.mj_kinematics(model, data)
        limb = model.geom(FORE[int(link)]).id
        ours.append(mujoco.mj_geomDistance(model, data, limb, model.geom(front).id, 1.0, None))
    return np.array(ours), t["person_distance"]


@functools.cache
def moved() -> np.ndarray:
    """How far each push has moved the elbow, from the start on after every physics step [m] (n, steps + 1)."""
    t, ours = traces("beside_bed"), []
    for i, strength in enumerate(t["push_force"]):
        who = _lying("push", i)
        model, index = who.model, who.scene.index
        data, elbow = mujoco.MjData(model), model.body("human/right_forearm").id
        data.qpos[index.human_qpos] = t["push_q"][i, : len(body.RIGHT_ARM)]
        data.qvel[index.human_dof] = t["push_qd"][i]
        places, force = [], np.array((0.0, -strength, 0.0))
        for _ in range(t["push_moved"].shape[1]):
            mujoco.mj_kinematics(model, data)
            mujoco.mj_comPos(model, data)
            places.append(data.xpos[elbow].copy())
            moment = np.cross(data.xpos[elbow] - data.xipos[elbow], force)
            data.xfrc_applied[elbow] = *force, *moment
            mujoco.mj_step(model, data)
            who.after_step(data)
        ours.append(np.linalg.norm(np.array(places) - places[0], axis=1))
    return np.array(ours)


def _lying(kind: str, i: int) -> Person:
    """A recorded person, masses as AG's."""
    t = traces("beside_bed")
    sex, scale = int(t[f"{kind}_sex"][i]), float(t[f"{kind}_scale"][i])
    return Person.lying(
        sex, t[f"{kind}_person"][i], t[f"{kind}_q"][i], True, TASK.name, limit_scale=scale
    )


def rows() -> list[Row]:
    """The comparison."""
    found = []
    for what, (ours, ag) in (
        ("Jaco's third link from the nightstand", robot_distances()),
        ("hanging forearm or hand from the nightstand", person_distances()),
    ):
        off = ours - ag
        found += [
            Row(f"{what}, ours less AG's, median", "m", 0.0, float(np.median(off)), 0.003, "nightstand"),
            Row(f"{what}, difference, 90th percentile", "m", 0.0, float(np.quantile(abs(off), 0.9)), 0.005, "nightstand"),
        ]  # fmt: skip
    t = traces("beside_bed")
    for strength in np.unique(t["push_force"]):
        ag, ours = (
            float(np.median(x[t["push_force"] == strength, -1])) for x in (t["push_moved"], moved())
        )
        quantity = f"elbow moved by {strength:.0f} N towards the feet after 0.5 s, median"
        found.append(Row(quantity, "m", ag, ours, 0.02, "bed-contact"))
    return found
