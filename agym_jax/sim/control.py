"""Actions as joint targets and muscle torques: the first part of a control step, whatever the physics.

DEVIATION(arm-limits-always): the pose-dependent limits of the arm hold for the still person too, whom
the robot may push; AG judges them for the active person only, as here where people have AG's masses. In
twelve episodes of ArmManipulationBaxter recorded in AG (with AG's masses and motors; 27 states in which
the robot touches the person alone), 0.5 s of recorded actions end 0.17 rad from there with these limits
(median of the joint that is farthest off) and 0.11 without.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from jax import Array

from agym_jax.errors import ActionError
from agym_jax.human import body, limits, muscles
from agym_jax.human.population import Human
from agym_jax.sim.girdle import Girdle
from agym_jax.sim.index import Index
from agym_jax.sim.landing import RESTING, Landing, hold_early
from agym_jax.sim.motors import Aim, Motors
from agym_jax.sim.scene import Scene
from agym_jax.spec import Control, HumanSpec, Task
from agym_jax.state import Episode
from agym_jax.variation import delayed

ARM = ("shoulder_y", "shoulder_x", "shoulder_z", "elbow_x")
"""Joints whose limits depend on each other, in the order of ``human.limits``."""
INCREMENT = 0.05  # AG v0.1 env.py take_step: action_multiplier [rad]
LIKE_RIGHT = {
    sign: limits.mirror_left(np.ones(len(ARM), np.float32), sign, np) for sign in (1.0, -1.0)
}
"""Factors that turn the angles of an arm of that side into those of a right one."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class ControlTargets:
    """What one control step asks of the joints."""

    action: Array  # as asked for, not clipped, which is what AG penalises    (n_action,)
    goal: Array  # of the robot's joints, within their limits [rad]           (n_arm,)
    load: Array  # on them: torque of what the tool weighs [N m]              (n_arm,)
    target: Array  # of the muscles, tremor included [rad]                    (n_person,)
    hold: Array  # the same without tremor, to be remembered [rad]            (n_person,)
    sent: Array | None = None  # the robot's actions under way, see ``Episode``  (longest, n_arm)
    bound: Array | None = None  # of the motors' torque, if not the task's [N m]  ()


def checked_action(action: Any, sizes: dict[str, int], name: str) -> Any:
    """An action as float32.

    Args:
        action: of one environment; under jit nothing can be said about its entries.
        sizes: how many entries belong to which agent, in order.
        name: of the environment.

    Raises:
        ActionError: the shape is wrong, or (outside of jit) entries are not finite.
    """
    size, shape = sum(sizes.values()), np.shape(action)
    if shape != (size,):
        parts = " + ".join(f"{v} {k}" for k, v in sizes.items())
        raise ActionError(
            f"{name} takes actions of shape ({size},) ({parts}), got {shape}. Batches go through "
            f"jax.vmap or agym_jax.wrappers.vectorize."
        )
    if isinstance(action, jax.core.Tracer):
        return jnp.asarray(action, np.float32)
    if not np.all(np.isfinite(action)):
        raise ActionError(f"{name} was given an action with NaN or infinity: {action}.")
    return np.asarray(action, np.float32)


@dataclass(frozen=True, eq=False)  # has arrays in it: equal if identical
class Controller:
    """How the joints of one scene are driven: pure functions of one environment."""

    index: Index
    spec: HumanSpec  # of the joints that are hinges in the scene
    active: bool  # whether the person acts
    motors: Motors  # of the robot
    human_motors: Motors  # the person's muscles
    control: Control  # of the task
    robot_range: np.ndarray  # joint limits [rad]                             (n_arm, 2)
    arm_limits: limits.ArmLimits
    arms: tuple[tuple[np.ndarray, float], ...]  # rows of an arm's four joints, 1 right or -1 left
    girdle: Girdle | None = None  # what bears a seated person's arm
    masses: str = "body"  # the population's
    landing: Landing | None = None  # of arms with AG's masses on the bed

    @classmethod
    def of(cls, scene: Scene, task: Task, active: bool, masses: str = "body") -> Controller:
        """The driver of a scene; ``masses`` is the population's."""
        names = scene.moving
        arms = [
            (np.array([names.index(f"{side}_{joint}") for joint in ARM]), sign)
            for side, sign in (("r", 1.0), ("l", -1.0))
            if f"{side}_{ARM[0]}" in names
        ]
        return cls(
            index=scene.index,
            spec=dataclasses.replace(task.human, joints=scene.moving),
            active=active,
            motors=Motors.of(scene.model, scene.index.robot_dof, task.control.time_step),
            human_motors=Motors.of(scene.model, scene.index.human_dof, task.control.time_step),
            control=task.control,
            robot_range=np.array(scene.model.jnt_range[scene.index.robot_joint], np.float32),
            arm_limits=limits.load_arm_limits(),
            arms=tuple(arms),
            girdle=Girdle.of(
                scene.model, scene.index.human_joint, () if task.human.postures else names
            ),
            masses=masses,
            landing=Landing.of(scene.model, scene.index) if masses != "body" and names else None,
        )

    @property
    def at_joints(self) -> bool:
        """Whether there are people with AG's masses who can move, see ``muscles.as_bullet``."""
        return self.masses != "body" and bool(self.spec.joints)

    @property
    def mixed(self) -> bool:
        """Whether there are others, too."""
        return self.masses == "both"

    def model_of(self, model: mujoco.MjModel) -> mujoco.MjModel:
        """The scene's model, or a copy with contacts as people with AG's masses need them; see ``contact_fields``."""
        if self.landing is None or self.mixed:
            return model
        return hold_early(model, self.landing.pairs)

    def contact_fields(self, model: Any, human: Human) -> dict[str, Array]:
        """Fields of a model that differ between people with AG's masses and others, where there are both.

        Args:
            model: ``mjx.Model`` or ``MjModel`` of the scene; it is not changed.
            human: of the environment.
        """
        if self.landing is None or not self.mixed:
            return {}
        margin = jnp.asarray(model.pair_margin, jnp.float32)
        early = jnp.where(human.at_joints > 0.0, RESTING, margin[self.landing.pairs])
        return {"pair_margin": margin.at[self.landing.pairs].set(early)}

    def targets(
        self, episode: Episode, data: Any, action: Array, load: tuple[Array, Array] | None = None
    ) -> ControlTargets:
        """What an action means, given where the joints are.

        Args:
            episode: of the environment.
            data: of the physics, kinematics up to date.
            action: robot's joints, then the active person's; joints move as if it were clipped to [-1, 1], NaN and infinity act as 0
                (n_action,).
            load: weight of the first tool [N] () and where it acts, world [m] (3,); None for nothing.
        """
        qpos, n_arm = data.qpos, len(self.index.robot_qpos)
        asked = jnp.where(jnp.isfinite(action), action, 0.0)
        action = jnp.clip(asked, -1.0, 1.0)
        arrived, sent = delayed(episode.robot, episode.sent, action[:n_arm])
        goal = self.robot_goal(qpos[self.index.robot_qpos], arrived)
        q = qpos[self.index.human_qpos]
        torque = jnp.zeros(n_arm) if load is None else self.load_torque(data, *load)
        target, hold = self.human_target(episode, q, action[n_arm:])
        strength = None if episode.robot is None else episode.robot.strength
        bound = None if strength is None else self.control.max_torque * strength
        return ControlTargets(asked, goal, torque, target, hold, sent, bound)

    def load_torque(self, data: Any, weight: Any, point: Any, xp: Any = jnp) -> Any:
        """Torque of a weight on the first tool about the robot's joints [N m] (n_arm,).

        Args:
            data: of the physics, kinematics up to date.
            weight: [N] ().
            point: where it acts, world [m] (3,).
            xp: numpy or jax.numpy.
        """
        joints = self.index.robot_joint
        bears = np.isin(joints, self.index.tools[0].joints).astype(np.float32)
        lever = xp.cross(data.xaxis[joints], point - data.xanchor[joints])
        return -bears * lever[:, 2] * weight

    def robot_goal(self, q: Array, action: Array) -> Array:
        """Angles that the robot's motors aim at in this control step [rad] (n_arm,).

        AG env.py take_step: the displacement of a joint is added up in steps of ``INCREMENT`` times its
        action, and the first that would lead beyond a limit is dropped with all that follow.

        Args:
            q: angles of the robot's joints [rad] (n_arm,).
            action: theirs, clipped (n_arm,).
        """
        step = INCREMENT * action
        low, high = self.robot_range.T
        room = jnp.where(step > 0.0, high - q, q - low)
        fit = jnp.floor(room / jnp.where(step == 0.0, 1.0, abs(step)))
        return q + step * jnp.clip(fit, 0.0, self.control.action_scale / INCREMENT)

    def human_target(self, episode: Episode, q: Array, action: Array) -> tuple[Array, Array]:
        """What the muscles aim at in this control step, and what to remember of it.

        AG env.py take_step: the target is the angle measured now (or, with tremor, the pose held so
        far) plus the action; tremor adds its amplitude with alternating sign, minus first.

        Args:
            episode: of the environment.
            q: angles of the person's joints [rad] (n_person,).
            action: of the active person, clipped (n_person,); (0,) of a still one.
        """
        trembles = jnp.any(episode.human.tremor != 0.0)
        target = episode.human_target
        if self.active:
            low, high = body.joint_limits(self.spec.joints, episode.human.limit_scale).T
            start = jnp.where(trembles, target, q)
            target = jnp.clip(start + self.control.action_scale * action, low, high)
        sign = jnp.where(episode.step % 2 == 0, -1.0, 1.0)
        return target + sign * episode.human.tremor, target

    def muscles(self, human: Human) -> muscles.Muscles:
        """How this person pulls."""
        moving = muscles.is_moving(human.tremor, self.active)
        return muscles.muscles_of(self.spec, human.strength, moving, human.at_joints, self.active)

    def aim(self, goal: Any, bound: Any = None) -> Aim:
        """What the robot's motors are to do.

        Args:
            goal: angles to reach [rad] (n_arm,).
            bound: of their torques, if not the task's [N m] ().
        """
        return Aim(goal, self.control.rate, self.control.max_torque if bound is None else bound)

    def support(self, passive: Any, model: Any, data: Any, xp: Any = jnp) -> Any:
        """Torque with which ligaments bear the arm of a seated person [N m] (..., n_person).

        Args:
            passive: of the person's ``Muscles`` (..., n_person).
            model: with this person in it.
            data: of one moment.
            xp: numpy or jax.numpy.
        """
        if self.girdle is None:
            return 0.0 * passive
        return passive * self.girdle.weight(model, data, xp)

    def limit_torque(self, q: Array, v: Array) -> Array:
        """Pose-dependent limits of the arms: a torque beside the muscles' [N m] (n_person,).

        Args:
            q: angles of the person's joints [rad] (n_person,).
            v: velocities [rad/s] (n_person,).
        """
        torque = jnp.zeros_like(q)
        for arm, sign in self.arms:
            push = limits.limit_torque(self.arm_limits, q[arm], v[arm], sign)
            torque = torque.at[arm].set(push)
        return torque

    def limit_torques(self, q: Array, v: Array) -> Array:
        """``limit_torque`` of many people at once; where nobody is beyond a limit, it costs little [N m] (n, n_person).

        Args:
            q: angles of the persons' joints [rad] (n, n_person).
            v: velocities [rad/s] (n, n_person).
        """
        if not self.arms:
            return jnp.zeros_like(q)
        reach = [
            limits.reachability(self.arm_limits, q[:, arm] * LIKE_RIGHT[sign])
            for arm, sign in self.arms
        ]
        beyond = ~jnp.all(jnp.stack(reach) > 0.0)
        return jax.lax.cond(beyond, jax.vmap(self.limit_torque), lambda q, v: 0.0 * q, q, v)

    def after_step(
        self, model: Any, data: Any, matrix: Any, at_joints: Any, xp: Any = jnp
    ) -> tuple[Any, Any]:
        """The person's angles and velocities after a physics step, as in Bullet for people with AG's masses.

        What falls onto the bed stops at its surface (``Landing``), and joints at their limits (``muscles.as_bullet``).

        Args:
            model: with this person in it.
            data: as the step leaves it: new angles and velocities, and where everything was as it began.
            matrix: of inertia, of the whole scene, as the physics keeps it.
            at_joints: 1 for a person with AG's masses; all others stay as they are ().
            xp: numpy or jax.numpy.
        """
        q, v = data.qpos[self.index.human_qpos], data.qvel[self.index.human_dof]
        left = (q, v)
        if self.landing is not None:
            mobility = xp.linalg.inv(self.human_motors.inertia(matrix, xp))
            after = self.landing.stop(v, mobility, model, data, self.motors.time_step, xp)
            q, v = q + self.motors.time_step * (after - v), after
        limits = model.jnt_range[self.index.human_joint]
        stopped = muscles.as_bullet(q, v, limits, self.motors.time_step, xp)
        if not self.mixed:
            return stopped
        q, v = (xp.where(at_joints > 0.0, *x) for x in zip(stopped, left, strict=True))
        return q, v
