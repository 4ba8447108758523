"""The limp arm of ArmManipulation.

The arm is released from rest in the poses that were recorded, in the task's own scene in C MuJoCo at its 20 ms, the
robot far away. "AG's masses" are people of `Population(masses="ag")`: centres of mass at the joints, no damping but Bullet's
drag, joints that stop dead at their limits. "Impact" is AG's first contact of the arm with the bed after the release. Rows
of the seated arm are of ScratchItch. Medians are over twelve drops, or over ten people who lie as after AG's reset.
"""

from __future__ import annotations

import copy
import functools
from dataclasses import dataclass

import jax.numpy as jnp
import mujoco
import numpy as np

from agym_jax.human import anthropometry, body, muscles
from agym_jax.human import pose as human_pose
from agym_jax.robots import ROBOTS
from agym_jax.sim.control import Controller
from agym_jax.sim.motors import Aim
from agym_jax.sim.scene import Scene, build_scene
from agym_jax.tasks import TASKS
from benchmarks.parity.row import Row, traces

SEXES = ("male", "female")
ELBOW, WRIST = 0, 1
FAR = (20.0, 20.0, 0.0)  # where the robot is [m]
HEAVY = 1e3  # its rotors [kg m2]
FIRST_SECOND = 51  # samples of 20 ms
JOINTS = tuple(body.JOINTS)


@dataclass(frozen=True)
class Person:
    """A limp person in a task's scene, alone.

    Attributes:
        scene: where; its model is not written into.
        model: a copy with this person in it.
        controller: what drives this person, by whose masses.
    """

    scene: Scene
    model: mujoco.MjModel
    controller: Controller

    @classmethod
    def lying(
        cls,
        sex: int,
        base: np.ndarray,
        angles: np.ndarray,
        at_joints: bool,
        task: str,
        limit_scale: float = 1.0,
    ) -> Person:
        """Somebody of AG's size.

        Args:
            sex: 0 male, 1 female.
            base: pose of the chest, position and quaternion xyzw (7,).
            angles: of every joint [rad] (41,).
            at_joints: whether masses are AG's.
            task: whose scene it is.
            limit_scale: of the joints' range.
        """
        spec, scene = TASKS[task].human, build_scene(TASKS[task], ROBOTS["Jaco"])
        controller = Controller.of(scene, TASKS[task], False, "ag" if at_joints else "body")
        model = copy.copy(controller.model_of(scene.model))
        index, d = scene.index, anthropometry.dims(float(sex))
        pose = human_pose.BodyPose(base[:3], base[[6, 3, 4, 5]], angles)
        rows = human_pose.rows(spec, pose, d, scene.moving, limit_scale, np, float(at_joints))
        for ids, kept, names in (
            (index.human_body, index.human_row, ("body_pos", "body_quat", "body_mass", "body_ipos", "body_inertia")),
            (index.human_geom, index.shape_row, ("geom_size", "geom_pos", "geom_rbound")),
            (index.human_joint, slice(None), ("jnt_pos", "jnt_range")),
        ):  # fmt: skip
            for name in names:
                getattr(model, name)[ids] = getattr(rows, name)[kept]
        model.geom_sameframe[index.human_geom] = mujoco.mjtSameFrame.mjSAMEFRAME_NONE
        model.body_sameframe[index.human_body] = mujoco.mjtSameFrame.mjSAMEFRAME_NONE
        model.body_pos[index.robot_base] = FAR
        model.dof_armature[index.robot_dof] = HEAVY  # nobody drives it
        model.dof_damping[index.robot_dof] = 0.0
        damping = 0.0 if at_joints else muscles.TISSUE_DAMPING
        model.dof_damping[index.human_dof] = damping
        model.dof_frictionloss[index.human_dof] = 0.0  # no muscle pulls
        model.dof_frictionloss[index.human_dof] = 0.0  # limp
        model.dof_armature[index.human_dof] *= 0.0 if at_joints else 1.0
        model.dof_armature[index.human_dof] += damping * model.opt.timestep
        return cls(scene, model, controller)

    def released(self, q: np.ndarray, v: np.ndarray | float = 0.0, steps: int = 150) -> np.ndarray:
        """Elbow and wrist after every physics step, the start first, world [m] (steps + 1, 2, 3)."""
        model, index = self.model, self.scene.index
        data = mujoco.MjData(model)
        data.qpos[index.human_qpos], data.qvel[index.human_dof] = q, v
        links = [model.body(f"human/right_{x}").id for x in ("forearm", "hand")]
        path = []
        for step in range(steps + 1):
            mujoco.mj_kinematics(model, data)
            path.append(data.xpos[links].copy())
            if step < steps:
                mujoco.mj_step(model, data)
                self.after_step(data)
        return np.array(path)

    def after_step(self, data: mujoco.MjData) -> None:
        """What ``Controller.after_step`` does."""
        if self.controller.at_joints:
            index, model = self.scene.index, self.model
            after = self.controller.after_step(model, data, data.M, 1.0, np)
            data.qpos[index.human_qpos], data.qvel[index.human_dof] = after

    def load(self, q: np.ndarray) -> np.ndarray:
        """Torques that hold the arm [N m] (10,)."""
        data, index = mujoco.MjData(self.model), self.scene.index
        data.qpos[index.human_qpos] = q
        mujoco.mj_forward(self.model, data)
        return data.qfrc_bias[index.human_dof].copy()

    def speed_after_a_second(self, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Joint speeds after 1 s without gravity [rad/s] (10,)."""
        model, index = self.model, self.scene.index
        data, gravity = mujoco.MjData(model), model.opt.gravity.copy()
        model.opt.gravity[:] = 0.0
        data.qpos[index.human_qpos], data.qvel[index.human_dof] = q, v
        for _ in range(FIRST_SECOND - 1):
            mujoco.mj_step(model, data)
            self.after_step(data)
        model.opt.gravity[:] = gravity
        return data.qvel[index.human_dof].copy()


def apart(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Distances of points [m] (...,)."""
    return np.linalg.norm(a - b, axis=-1)


def person(sex: int, at_joints: bool = True) -> Person:
    """AG's man or woman in bed, as when drops were recorded."""
    t, who = traces("limp_arm"), SEXES[sex]
    return Person.lying(
        sex, t[f"{who}_base"], t[f"{who}_angles"], at_joints, "ArmManipulation"
    )  # fmt: skip


@functools.cache
def drops(sex: int, at_joints: bool = True) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """How far twelve arms that fall onto the bed are from AG's [m] (12,).

    Returns:
        the wrist at most, until the impact; the wrist on average over the first second; the elbow at rest.
    """
    t, who, arm = traces("limp_arm"), SEXES[sex], person(sex, at_joints)
    before, second, rest = [], [], []
    for i, start in enumerate(t[f"{who}_bed_start"]):
        path = arm.released(start)
        gap = apart(path[:FIRST_SECOND, WRIST], t[f"{who}_bed_wrist"][i])
        before.append(gap[: int(t[f"{who}_impact"][i])].max())
        second.append(gap.mean())
        rest.append(apart(path[-1, ELBOW], t[f"{who}_rest"][i, ELBOW]))
    return np.array(before), np.array(second), np.array(rest)


@functools.cache
def resting(sex: int, at_joints: bool) -> tuple[np.ndarray, np.ndarray]:
    """Elbow and wrist 3 s after the start of ten episodes, ours and AG's, world [m] (10, 2, 3)."""
    t = traces("limp_arm")
    ours, ag = [], []
    for i in np.flatnonzero(t["reset_person"][:, 1] == sex):
        angles = t[f"{SEXES[sex]}_angles"]
        who = Person.lying(sex, t["reset_person"][i, 5:12], angles, at_joints, "ArmManipulation")
        ours.append(who.released(t["reset_q"][i], t["reset_qd"][i] if at_joints else 0.0)[-1])
        ag.append(t["reset_pos"][i, -1])
    return np.array(ours), np.array(ag)


def seated(run: int, at_joints: bool) -> float:
    """Fall of the wrist of one of the recorded people who sit and hold still, within 2 s [m]."""
    _, sex, _, limit_scale, strength = (float(x) for x in traces("limp_arm")["seated_person"][run])
    spec, d = TASKS["ScratchItch"].human, anthropometry.dims(sex)
    pose = human_pose.seated(spec, d, sex, 1.0, 1.0, np, limit_scale)
    base = np.concatenate([pose.root_pos, pose.root_quat[[1, 2, 3, 0]]])
    who = Person.lying(int(sex), base, pose.angles, at_joints, "ScratchItch")
    model, index, still = who.model, who.scene.index, jnp.bool_(False)
    pull = muscles.muscles_of(spec, jnp.float32(strength), still, float(at_joints))
    pull = muscles.Muscles(*(np.asarray(x) for x in pull))
    model.dof_armature[index.human_dof] += (
        pull.damping - model.dof_damping[index.human_dof]
    ) * model.opt.timestep
    model.dof_damping[index.human_dof] = pull.damping
    model.dof_frictionloss[index.human_dof] = pull.bound
    data, hand = mujoco.MjData(model), model.body("human/right_hand").id
    held = human_pose.start_angles(pose, who.scene.moving, limit_scale, np)
    data.qpos[index.human_qpos], data.M[:] = held, 0.0
    mujoco.mj_kinematics(model, data)
    start, aim = data.xpos[hand, 2], Aim(held, pull.rate, pull.bound, pull.damping)
    for _ in range(100):
        load = data.qfrc_bias[index.human_dof].copy()
        besides = who.controller.support(pull.passive, model, data, np)
        who.controller.human_motors.prepare(model, data, aim, load - besides, besides)
        mujoco.mj_step(model, data)
        who.after_step(data)
    return float(start - data.xpos[hand, 2])


def rows() -> list[Row]:
    """Loads, drag, drops and where the arm comes to rest."""
    t, found = traces("limp_arm"), []
    for sex, who in enumerate(SEXES):
        arm, held = person(sex), t[f"{who}_hold_q"]
        out = held[0]  # sideways, the elbow straight
        for joint, row, label in (("r_shoulder_x", 4, "shoulder"), ("r_elbow_x", 6, "elbow")):
            ag = abs(float(t[f"{who}_hold_torque"][0, row]))
            for masses, at_joints in (("AG's masses", True), ("our masses", False)):
                load = person(sex, at_joints).load(out)[list(body.RIGHT_ARM).index(joint)]
                found.append(
                    Row(
                        f"{who}: holding the arm out sideways, {label}, {masses}", "N m", ag,
                        abs(float(load)), 0.05 * ag, "" if at_joints else "person-mass",
                    )
                )  # fmt: skip
        q, (start, end) = t[f"{who}_decay_q"], t[f"{who}_decay_qd"].transpose(1, 0, 2)
        ours = arm.speed_after_a_second(q[3], start[3])[3]
        found.append(
            Row(f"{who}: shoulder at 1 rad/s, after 1 s", "rad/s", float(end[3, 3]), float(ours), 0.02)
        )  # fmt: skip
        before, second, rest = (float(np.median(x)) for x in drops(sex))
        found += [
            Row(f"{who}: drop, wrist from AG's before the impact, AG's masses", "m", 0.0, before, 0.02, "bed-contact"),
            Row(f"{who}: drop, wrist from AG's, mean of 1 s, AG's masses", "m", 0.0, second, 0.02, "bed-contact"),
            Row(f"{who}: drop, elbow at rest from AG's, AG's masses", "m", 0.0, rest, 0.02, "bed-contact"),
        ]  # fmt: skip
        for masses, at_joints in (("AG's masses", True), ("our masses", False)):
            ours, ag = resting(sex, at_joints)
            for part, label in ((ELBOW, "elbow"), (WRIST, "wrist")):
                for axis, name in ((0, "x"), (1, "y"), (2, "z")):
                    found.append(
                        Row(
                            f"{who}: {label} {name} 3 s after the start, mean, {masses}", "m",
                            float(ag[:, part, axis].mean()), float(ours[:, part, axis].mean()), 0.02,
                            "bed-contact",
                        )
                    )  # fmt: skip
    fall = t["seated_pos"][:, 0, 2, 2] - t["seated_pos"][:, 4, 2, 2]  # within 2 s
    for run, who in ((0, "man of full strength"), (3, "weak man"), (7, "weak woman")):
        for masses, at_joints, why in (
            ("AG's masses", True, "person-mass"),
            ("our masses", False, "girdle-support"),
        ):
            found.append(
                Row(f"seated {who}: fall of the wrist within 2 s, {masses}", "m", float(fall[run]), seated(run, at_joints), 0.005, why)
            )  # fmt: skip
    return found
