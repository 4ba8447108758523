"""Which placements begin inside a person who lies in a settled posture, by C MuJoCo.

The search for placements keeps them off a typical man and woman (``clearance``). People settle in many other postures: an
arm may have fallen over the edge of the bed, where a robot's elbow is. An episode therefore does not begin with a
placement that meets the posture drawn, see ``sim.starts``.

Every shape is posed once, those of the arms for each placement and those of the person for each posture. Distances are
then measured only between shapes near enough to touch.
"""

from __future__ import annotations

import jax
import mujoco
import numpy as np

from agym_jax.data.banks import Placement
from agym_jax.errors import SpecError
from agym_jax.human import body
from agym_jax.human import pose as human_pose
from agym_jax.human.posture import Postures, load_postures
from agym_jax.offline.clearance import FAR, CompiledScene
from agym_jax.sim.scene import compose
from agym_jax.spec import RobotSpec, Task


def meets_of(
    task: Task, robot: RobotSpec, bank: Placement, postures: Postures | None = None
) -> np.ndarray:
    """Whether the moving arms or their tools are inside the person, for every posture and placement.

    Args:
        task: of the pair.
        robot: of the pair.
        bank: placements, K rows.
        postures: P people and how they lie; by default the task's.

    Returns:
        bool (P, K).

    Raises:
        SpecError: the task has no settled postures.
    """
    if not task.human.postures:
        raise SpecError(
            f"Nobody lies in settled postures in {task.name}: its placements need no table of whom they meet."
        )
    postures = load_postures(task.human.postures) if postures is None else postures
    stage = _Stage(task, robot, bank)
    return np.array([stage.meets(postures.row(i)) for i in range(len(postures.sex))])


class _Stage:
    """The arms as each of K placements has them, and one person, who is moved."""

    def __init__(self, task: Task, robot: RobotSpec, bank: Placement):
        self.spec, self.moving = task.human, task.human.moving(active=False)
        self.joints = [f"human/{j}" for j in self.moving]
        arm_joints = [f"robot/{j}" for arm in robot.arms_for(task) for j in arm.joints]
        self.scene = scene = CompiledScene(compose(task, robot, solid=True), arm_joints)
        self.model, self.data = scene.model, scene.data
        self.bodies = [self.model.body(f"human/{x.name}").id for x in body.LINKS]
        self.people = [self.model.geom(f"human/{x}").id for x in body.SHAPES]
        round_shapes = (mujoco.mjtGeom.mjGEOM_SPHERE, mujoco.mjtGeom.mjGEOM_CAPSULE)
        assert np.isin(self.model.geom_type[self.people], round_shapes).all()  # see _near
        self.hinges = [self.model.joint(x).id for x in self.joints]
        self.arms = np.unique(scene.outside[:, 0])
        self.pos, self.mat = [], []
        for k in range(len(bank.arm_angles)):
            scene.set_placement(jax.tree.map(lambda x: x[k], bank), arm_joints)  # noqa: B023
            self.pos.append(self.data.geom_xpos[self.arms])
            self.mat.append(self.data.geom_xmat[self.arms])
        self.centres = np.array(self.pos)  # (K, n_arm, 3)

    def lay(self, human: Postures) -> None:
        """Give the person this one's sizes and posture."""
        m, size = self.model, human.dims
        pose = human_pose.BodyPose(human.root_pos, human.root_quat, human.angles)
        rows = human_pose.rows(self.spec, pose, size, self.moving, human.limit_scale, np)
        m.body_pos[self.bodies], m.body_quat[self.bodies] = rows.body_pos, rows.body_quat
        m.geom_pos[self.people], m.geom_size[self.people] = rows.geom_pos, rows.geom_size
        m.geom_rbound[self.people], m.jnt_pos[self.hinges] = rows.geom_rbound, rows.jnt_pos
        angles = human_pose.start_angles(pose, self.moving, human.limit_scale, np)
        self.scene.set_angles(self.joints, angles)
        mujoco.mj_kinematics(m, self.data)

    def meets(self, human: Postures) -> np.ndarray:
        """Whether each placement meets a person (K,)."""
        self.lay(human)
        near = self._near()
        found = np.zeros(len(near), bool)
        for k in np.flatnonzero(near.any(axis=(1, 2))):
            self.data.geom_xpos[self.arms] = self.pos[k]
            self.data.geom_xmat[self.arms] = self.mat[k]
            found[k] = any(
                self._distance(self.arms[a], self.people[p]) < 0.0 for a, p in np.argwhere(near[k])
            )
        return found

    def _near(self) -> np.ndarray:
        """Whether the bounding ball of a shape of an arm meets a shape of the person (K, n_arm, n_human).

        The person's are spheres and capsules: all points at most a radius from a segment, their z axis.
        """
        m, d = self.model, self.data
        radius, half = m.geom_size[self.people, 0], m.geom_size[self.people, 1]
        axis = d.geom_xmat[self.people].reshape(-1, 3, 3)[:, :, 2]
        centre = d.geom_xpos[self.people]
        along = self.centres @ axis.T - np.sum(centre * axis, axis=1)
        square = np.sum(self.centres**2, axis=2)[..., None] - 2 * self.centres @ centre.T
        square = square + np.sum(centre**2, axis=1)  # of the distances of the centres
        beyond = along - np.clip(along, -half, half)
        apart = square - along**2 + beyond**2
        reach = m.geom_rbound[self.arms][:, None] + radius + 1e-6
        return apart < reach**2

    def _distance(self, one: int, other: int) -> float:
        return mujoco.mj_geomDistance(self.model, self.data, int(one), int(other), FAR, None)
