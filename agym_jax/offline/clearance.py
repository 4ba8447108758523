"""Distances of a robot, its tools and its mount from the person, the furniture and itself, by C MuJoCo."""

from __future__ import annotations

import mujoco
import numpy as np

from agym_jax.data.banks import Placement
from agym_jax.human import pose as human_pose
from agym_jax.sim.scene import compose
from agym_jax.sim.validate import COLLISION
from agym_jax.spec import RobotSpec, Task

FAR = 0.1
"""Distances beyond this are not resolved [m]."""


class Clearance:
    """Least distances between the collision geoms of a scene, over AG's man and woman."""

    def __init__(self, task: Task, robot: RobotSpec):
        moving = task.human.moving(active=False)
        self.joints = [f"robot/{j}" for arm in robot.arms_for(task) for j in arm.joints]
        self.scenes = []
        for sex in (0.0, 1.0):
            angles = human_pose.start_angles(human_pose.typical(task.human, sex), moving, 1.0, np)
            mount = robot.solid_mounts.get(task.seat.name, ())
            scene = CompiledScene(compose(task, robot, sex=sex, solid=True), self.joints, mount)
            scene.set_angles([f"human/{j}" for j in moving], angles)
            self.scenes.append(scene)

    def outside(self, place: Placement) -> float:
        """Distance of the moving arms and their tools from person, furniture and mount, at most ``FAR`` [m]."""
        nearest = FAR
        for scene in self.scenes:
            scene.set_placement(place, self.joints)
            nearest = min(nearest, scene.least(scene.outside, stop=0.0))
        return nearest

    def inside(self, place: Placement) -> float:
        """Distance of the moving arms and tools from each other and the rest of the robot [m]."""
        scene = self.scenes[0]
        scene.set_placement(place, self.joints)
        return scene.least(scene.inside, stop=0.0)


class CompiledScene:
    """A compiled scene and the geom pairs whose distances count."""

    def __init__(self, model: mujoco.MjModel, joints: list[str], mount: tuple[str, ...] = ()):
        self.model, self.data = model, mujoco.MjData(model)
        moving = {model.joint(name).id for name in joints}
        names = [model.geom(i).name for i in range(model.ngeom)]
        of = lambda *prefix: [  # noqa: E731
            i for i, n in enumerate(names) if n.startswith(prefix) and COLLISION in n
        ]
        robot = of("robot/", "tool")
        rest = [i for i, n in enumerate(names) if n.startswith("human/")] + of("seat/")
        mounts = [names.index(f"mount/{g}") for g in mount]
        rest += mounts
        self.mount = np.unique(model.geom_bodyid[mounts]) if mounts else np.zeros(0, int)
        self.root = int(model.body_rootid[model.geom_bodyid[robot[0]]])
        arms = [g for g in robot if self._joints_above(model.geom_bodyid[g]) & moving]
        self.outside = np.array([(a, b) for a in arms for b in rest])
        self.inside = self._inside(robot)

    def _inside(self, geoms: list[int]) -> np.ndarray:
        """Pairs of the robot's own geoms with at least three joints between them."""
        m = self.model
        path = {g: self._joints_above(m.geom_bodyid[g]) for g in geoms}
        pairs = []
        for i, a in enumerate(geoms):
            for b in geoms[i + 1 :]:
                apart = len(path[a] ^ path[b])
                if apart >= 3:
                    pairs.append((a, b))
        return np.array(pairs).reshape(-1, 2)

    def _joints_above(self, body: int) -> set[int]:
        """Joints between a body and the world."""
        m, joints = self.model, set()
        while body:
            first = m.body_jntadr[body]
            joints |= set(range(first, first + m.body_jntnum[body]))
            body = int(m.body_parentid[body])
        return joints

    def set_placement(self, place: Placement, joints: list[str]) -> None:
        """Move the base, bend the arms' joints and update the kinematics."""
        self.model.body_pos[self.root] = place.base_pos
        self.model.body_quat[self.root] = place.base_quat
        self.model.body_pos[self.mount] = place.base_pos  # it does not turn
        self.set_angles(joints, np.asarray(place.arm_angles))
        mujoco.mj_kinematics(self.model, self.data)

    def set_angles(self, joints: list[str], angles: np.ndarray) -> None:
        """Set joint angles [rad]."""
        for name, angle in zip(joints, angles, strict=True):
            self.data.qpos[self.model.joint(name).qposadr[0]] = angle

    def least(self, pairs: np.ndarray, stop: float) -> float:
        """Least distance over geom pairs, at most ``FAR``; the search ends below ``stop`` [m]."""
        m, d = self.model, self.data
        a, b = pairs.T
        apart = np.linalg.norm(d.geom_xpos[a] - d.geom_xpos[b], axis=1)
        near = apart - m.geom_rbound[a] - m.geom_rbound[b] < FAR
        nearest = FAR
        for i, j in pairs[near]:
            nearest = min(nearest, mujoco.mj_geomDistance(m, d, int(i), int(j), FAR, None))
            if nearest < stop:
                break
        return nearest
