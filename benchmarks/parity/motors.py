"""The robot's motors.

In Assistive Gym robots moved far from everything: from each of three start configurations one joint at a time for 15 control
steps (full action), and all joints under ten series of 25 random actions. The same actions are played here from the same joint
angles in C MuJoCo (ArmManipulation with AG's bound of 5 N m). The last rows play the recorded presses on the arm of the
section above and compare joints whose action is below 0.05: they have to hold against the person and the other joints.
"""

from __future__ import annotations

import copy
import dataclasses
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

import agym_jax
from agym_jax.robots import ROBOTS
from agym_jax.sim.control import Controller
from agym_jax.sim.scene import build_scene
from agym_jax.tasks import TASKS, drinking
from benchmarks.parity import pressing
from benchmarks.parity.row import Row, traces

AG_TORQUE = {"ArmManipulation": 5.0}  # AG's bound where ours is another [N m]
AWAY = (0.0, 0.0, 30.0)  # of a base that is far from everything [m]
SPARED = 0.05  # largest action of a joint that counts as not driven
ENDS = 0.03  # issue 17: how far 25 random actions may end apart [rad]


class Arm:
    """The arms of one pair, alone in the world."""

    def __init__(self, task_name: str, robot_name: str):
        task: Any = TASKS[task_name]
        torque = AG_TORQUE.get(task_name, task.control.max_torque)
        task = dataclasses.replace(
            task, control=dataclasses.replace(task.control, max_torque=torque)
        )
        scene = build_scene(task, ROBOTS[robot_name])
        self.control, self.controller = task.control, Controller.of(scene, task, False)
        self.model = copy.copy(scene.model)
        self.model.body_pos[scene.index.robot_base] = AWAY
        self.data = mujoco.MjData(self.model)
        self.task_name, self.tip = task_name, scene.index.tools[0].tip
        self.qpos = scene.index.robot_qpos

    def load(self) -> np.ndarray:
        """Torque of the empty cup about the joints, where there is one [N m] (n,)."""
        if self.task_name != "Drinking":
            return np.zeros(len(self.qpos))
        mujoco.mj_kinematics(self.model, self.data)
        weight, at = drinking.CUP_MASS * drinking.GRAVITY, self.data.site_xpos[self.tip]
        return self.controller.load_torque(self.data, weight, at, np)

    def play(self, start: np.ndarray, actions: np.ndarray) -> np.ndarray:
        """Joint angles at the start and after every control step [rad] (steps + 1, n).

        Args:
            start: joint angles [rad] (n,).
            actions: (steps, n).
        """
        model, data = self.model, self.data
        mujoco.mj_resetData(model, data)
        data.M[:] = 0.0
        data.qpos[self.qpos] = start
        path = [np.array(start)]
        for action in actions:
            goal = np.asarray(self.controller.robot_goal(jnp.asarray(path[-1]), action))
            load = self.load()
            for _ in range(self.control.frame_skip):
                self.controller.motors.prepare(model, data, self.controller.aim(goal), besides=load)
                mujoco.mj_step(model, data)
            path.append(data.qpos[self.qpos].copy())
        return np.array(path)


def ends(task_name: str, robot_name: str) -> float:
    """How far joints end from AG's after series of random actions, at most [rad]."""
    arm, kept, name = Arm(task_name, robot_name), traces("motors"), f"{task_name}{robot_name}"
    runs = zip(kept[f"{name}_start"], kept[f"{name}_actions"], kept[f"{name}_end"], strict=True)
    return max(float(abs(arm.play(q, actions)[-1] - end).max()) for q, actions, end in runs)


def held() -> tuple[float, float]:
    """How far joints that are not driven move while the others press, at most: AG's and ours [rad]."""
    name, kept = "ScratchItchJaco", traces("pressing")
    env, last = agym_jax.make(f"{name}-v0", impl="native"), traces("motors")["pressed_end"]
    aim, moved = jax.jit(env.controller.targets), ([0.0], [0.0])
    for case, end in enumerate(last):
        episode = pressing.episode_of(env, name, case)
        data, action = (
            env.physics.reset(env.physics.make_data(), episode),
            kept[f"{name}_action"][case],
        )
        start, spared = kept[f"{name}_q"][case], abs(action) < SPARED
        for _ in range(kept[f"{name}_force"].shape[1]):
            data, _, _ = env.physics.step(data, episode, aim(episode, data, action))
        ours = data.qpos[env.scene.index.robot_qpos]
        for found, q in zip(moved, (end, ours), strict=True):
            found += abs(q - start)[spared].tolist()
    return max(moved[0]), max(moved[1])


def rows() -> list[Row]:
    """The comparison."""
    kept, out = traces("motors"), []
    names = [(t, r) for t in TASKS for r in ROBOTS if f"{t}{r}_start" in kept]
    for task, robot in names:
        far = ends(task, robot)
        what = f"{task}, {robot}: joints apart after 25 random actions, largest of 10 series"
        out.append(Row(what, "rad", 0.0, far, ENDS, "motor"))
    for robot in ROBOTS:
        arm = Arm("ScratchItch", robot)
        for joint, path in enumerate(kept[f"steps_{robot}"]):
            action = np.tile(np.eye(7)[joint], (len(path) - 1, 1))
            ours = arm.play(path[0], action)
            for step in (1, 4):
                theirs, mine = (float(q[step, joint] - q[0, joint]) for q in (path, ours))
                what = f"ScratchItch, {robot}, joint {joint + 1}, full action: angle after {step} control steps"
                out.append(Row(what, "rad", theirs, mine, 0.005, "motor"))
    what = "ScratchItch, Jaco: movement of joints that are not driven while others press for 2.5 s, largest"
    theirs, mine = held()
    out.append(Row(what, "rad", theirs, mine, 0.06, "motor"))
    return out
