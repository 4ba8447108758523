"""Who drives: a policy, chance, nobody, or the user, by joint angles or by the pose of the tool."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import jax
import mujoco
import numpy as np

from agym_jax.human.body import joint_limits
from agym_jax.policy.agents import AnyPolicy, parts

POLICY, RANDOM, ZERO, JOINTS, TOOL = "policy", "random", "zero", "by joints", "by tool"
DAMPING = 0.05  # of inverse kinematics: how far it stays from what the arm can hardly do
ITERATIONS = 20
TURN_WEIGHT = 0.3  # of a radian beside a metre


@dataclass(frozen=True)
class Joints:
    """The joints that one agent moves.

    Attributes:
        names: in action order.
        qpos: their addresses in ``qpos`` (n,).
        limits: [rad] (n, 2).
        acted: their part of the action.
    """

    names: tuple[str, ...]
    qpos: np.ndarray
    limits: np.ndarray
    acted: slice


def joints_of(env: Any) -> dict[str, Joints]:
    """The joints of each agent."""
    scene, agents = env.scene, parts(env)
    index, model = scene.index, scene.model
    names = tuple(model.joint(j).name.removeprefix("robot/") for j in index.robot_joint)
    robot = Joints(names, index.robot_qpos, env.controller.robot_range, agents["robot"].acted)
    if "human" not in agents:
        return {"robot": robot}
    limits = np.asarray(joint_limits(scene.moving, 1.0, np))
    human = Joints(scene.moving, index.human_qpos, limits, agents["human"].acted)
    return {"robot": robot, "human": human}


@dataclass
class ToolGoal:
    """Where the user wants a tool.

    Attributes:
        pos: of its tip, world [m] (3,).
        quat: of its site, wxyz (4,).
    """

    pos: np.ndarray
    quat: np.ndarray


@dataclass
class Driver:
    """Makes actions.

    Attributes:
        env: that is driven.
        policy: of all who act; None if there is none.
        modes: agent -> who drives it.
        targets: agent -> angles that the user asks for, where the mode is ``JOINTS`` [rad].
        goal: the tool's, where the mode is ``TOOL``.
        deterministic: the policy's mode instead of a sample.
    """

    env: Any
    policy: AnyPolicy | None
    modes: dict[str, str] = field(default_factory=dict)
    targets: dict[str, np.ndarray] = field(default_factory=dict)
    goal: ToolGoal | None = None
    deterministic: bool = True

    def __post_init__(self) -> None:
        self.joints = joints_of(self.env)
        self._scale = self.env.controller.control.action_scale
        self._random = np.random.default_rng(0)
        self._keys: Iterator[np.ndarray] = iter(())
        act = lambda policy, obs, key: policy(obs, key, self.deterministic)  # noqa: E731
        self._act = jax.jit(jax.vmap(act, in_axes=(None, 0, 0)))
        for agent in self.joints:
            self.modes.setdefault(agent, self.choices(agent)[0])

    def choices(self, agent: str) -> list[str]:
        """Who may drive an agent, the usual one first."""
        by_hand = [JOINTS, TOOL] if agent == "robot" else [JOINTS]
        return [*([POLICY] if self.policy else []), ZERO, RANDOM, *by_hand]

    def begin(self, seed: int, keys: np.ndarray) -> None:
        """An episode begins: nobody asks for anything.

        Args:
            seed: of what the mode ``RANDOM`` does.
            keys: of what the policy samples, one for each environment (n, 2).
        """
        self._random = np.random.default_rng(seed)
        split = jax.vmap(lambda key: jax.random.split(key, self.env.episode_length), out_axes=1)
        self._keys = iter(np.asarray(split(keys)))
        self.targets.clear()
        self.goal = None

    def action(self, states: Any, arm: ToolReach) -> np.ndarray:
        """What all do in the next control step (n, n_action).

        Args:
            states: of all environments (n, ...).
            arm: the robot's in the first of them.
        """
        obs, keys = np.asarray(states.obs), next(self._keys)
        actions = np.zeros((len(obs), self.env.action_size), np.float32)
        chosen = actions
        if POLICY in self.modes.values():
            chosen = np.asarray(self._act(self.policy, obs, keys))
        for agent, joints in self.joints.items():
            mode, part = self.modes[agent], actions[:, joints.acted]
            q = np.asarray(states.data.qpos)[:, joints.qpos]
            if mode == POLICY:
                part[:] = chosen[:, joints.acted]
            elif mode == RANDOM:
                part[:] = self._random.uniform(-1.0, 1.0, part.shape)
            elif mode == JOINTS and agent in self.targets:
                part[:] = (self.targets[agent] - q) / self._scale
            elif mode == TOOL and self.goal is not None:
                part[:] = (arm.solve(q[0], self.goal) - q) / self._scale
        return np.clip(actions, -1.0, 1.0)


class ToolReach:
    """Inverse kinematics of the arm that holds the first tool, by damped least squares.

    Args:
        env: whose robot it is.
        model: of the robot's environment, with its base in place.
    """

    def __init__(self, env: Any, model: mujoco.MjModel):
        index = env.scene.index
        ours = env.scene.model
        tool = index.tools[0]
        self._model, self._data = model, mujoco.MjData(model)
        self._site = model.site(ours.site(tool.tip).name).id
        mine = np.isin(index.robot_joint, tool.joints)
        names = [ours.joint(j).name for j in index.robot_joint]
        self._all = np.array([model.joint(name).qposadr[0] for name in names])
        self._mine = np.flatnonzero(mine)
        self._dofs = np.array([model.joint(names[i]).dofadr[0] for i in self._mine])
        self._low, self._high = env.controller.robot_range[self._mine].T

    def pose(self, q: np.ndarray) -> ToolGoal:
        """Where the tool is with these joint angles of the robot [rad] (n_arm,)."""
        data = self._data
        data.qpos[self._all] = q
        mujoco.mj_kinematics(self._model, data)
        mujoco.mj_comPos(self._model, data)
        quat = np.zeros(4)
        mujoco.mju_mat2Quat(quat, data.site_xmat[self._site])
        return ToolGoal(data.site_xpos[self._site].copy(), quat)

    def solve(self, q: np.ndarray, goal: ToolGoal) -> np.ndarray:
        """Joint angles that bring the tool as near to a pose as it gets from where it is [rad] (n_arm,)."""
        q = np.array(q, float)
        jac, turn, back = np.zeros((6, self._model.nv)), np.zeros(3), np.zeros(4)
        weights = np.array([1.0, 1.0, 1.0, *3 * [TURN_WEIGHT]])
        for _ in range(ITERATIONS):
            here = self.pose(q)
            mujoco.mju_negQuat(back, here.quat)
            between = np.zeros(4)
            mujoco.mju_mulQuat(between, goal.quat, back)
            mujoco.mju_quat2Vel(turn, between, 1.0)
            error = weights * np.concatenate([goal.pos - here.pos, turn])
            mujoco.mj_jacSite(self._model, self._data, jac[:3], jac[3:], self._site)
            j = weights[:, None] * jac[:, self._dofs]
            step = j.T @ np.linalg.solve(j @ j.T + DAMPING**2 * np.eye(6), error)
            moved = q[self._mine] + np.clip(step, -0.2, 0.2)
            q[self._mine] = np.clip(moved, self._low, self._high)
        return q
