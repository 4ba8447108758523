"""THE environment: control -> physics -> sense -> task -> observe, in that order, once.

One class for every task, robot and person. ``reset`` and ``step`` are pure and written for one world;
``jax.vmap`` them, or let ``agym_jax.wrappers.vectorize`` do it with auto-reset.

DEVIATION(action-penalty): actions are clipped to [-1, 1] before they are penalised (AG penalises the
raw action).
DEVIATION(quaternion-order): observed quaternions are wxyz; AG's are xyzw.
DEVIATION(limit-clip): a robot's target is clipped to the joint limits; AG drops the rest of a
joint's motion in that control step once it would cross a limit.
DEVIATION(one-key): everything random follows from the key (AG's sex and impairment ignore the seed).
DEVIATION(arm-limits-always): the pose-dependent limits of the arm hold for the still person too, whom
the robot may push; AG judges them for the active person only.
"""

from __future__ import annotations

import dataclasses
import warnings
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from brax import envs as brax_envs
from jax import Array
from mujoco import mjx

from agym_jax import observe
from agym_jax.errors import ActionError
from agym_jax.person import body, draw, limits, muscles
from agym_jax.person import pose as person_pose
from agym_jax.physics import (
    WARP_CONTACTS_PER_WORLD,
    WARP_LOST,
    WARP_ROWS_PER_WORLD,
    choose_impl,
    place_static_geoms,
    put_model,
)
from agym_jax.placement import load_bank
from agym_jax.scene import build_scene, compose
from agym_jax.sense import Sensed, add_touch, no_touch, sense
from agym_jax.spec import Pose, RobotSpec, Task
from agym_jax.state import Episode, Placement, State


class AssistiveEnv(brax_envs.Env):
    """A robot helps a person; see the module's docstring.

    Args:
        task: what to do.
        robot: who helps.
        active: whether the person acts too (AG's ``...Human-v0``).
        impl: ``"jax"``, ``"warp"``, or ``"auto"``: Warp on an NVIDIA GPU with warp-lang, else JAX.
        people: population that episodes draw from.
        num_worlds: how many worlds will be stepped together: sizes Warp's buffers.
    """

    def __init__(
        self,
        task: Task,
        robot: RobotSpec,
        active: bool = False,
        impl: str = "auto",
        people: draw.People | None = None,
        num_worlds: int = 1,
    ):
        self.task, self.robot, self.active = task, robot, active
        self.people = people or draw.People()
        self.impl = choose_impl(impl)
        self.num_worlds = num_worlds
        self.scene = build_scene(task, robot, active)
        self.name = f"{task.name}{robot.name}{'Human' if active else ''}-v0"
        self.episode_length = task.episode_length
        self._bank = load_bank(task, robot)
        self._arm_limits = limits.load_arm_limits()
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # MJX's notes on its own experimental features
            self._model = put_model(self.scene.model, self.impl)
        self._limits = np.array(
            self.scene.model.jnt_range[self.scene.index.robot_joint], np.float32
        )
        welded = self.scene.model.body_weldid[self.scene.model.geom_bodyid] == 0
        self._static_geoms = np.flatnonzero(welded)
        self._driven = dataclasses.replace(task.person, joints=self.scene.moving)

    # -- sizes ---------------------------------------------------------------------------------

    @property
    def action_sizes(self) -> dict[str, int]:
        """Entries of the action that belong to each agent, in order."""
        sizes = {"robot": len(self.scene.index.robot_joint)}
        return {**sizes, "person": len(self.scene.moving)} if self.active else sizes

    @property
    def observation_sizes(self) -> dict[str, int]:
        """Columns of the observation that belong to each agent, in order."""
        sizes = {"robot": observe.size(self.task.robot_obs)}
        return {**sizes, "person": observe.size(self.task.person_obs)} if self.active else sizes

    @property
    def action_size(self) -> int:
        """Length of an action."""
        return sum(self.action_sizes.values())

    @property
    def observation_size(self) -> int:
        """Length of an observation."""
        return sum(self.observation_sizes.values())

    @property
    def layout_version(self) -> str:
        """Hash of the observation's names and sizes."""
        records = [self.task.robot_obs, *([self.task.person_obs] if self.active else [])]
        return observe.layout_version(*records)

    @property
    def backend(self) -> str:
        """Brax's name for the physics implementation."""
        return self.impl

    @property
    def dt(self) -> float:
        """Length of a control step [s]."""
        return self.task.control.period

    def sized_for(self, num_worlds: int) -> AssistiveEnv:
        """The same environment with Warp's buffers for so many worlds at once."""
        return AssistiveEnv(self.task, self.robot, self.active, self.impl, self.people, num_worlds)

    # -- the two pure functions ----------------------------------------------------------------

    # A State serves Brax in use, not by its type.
    def reset(self, rng: Array) -> State:  # pyrefly: ignore[bad-override]
        """A new person, a new goal, the robot at a new start.

        Args:
            rng: PRNG key, typed or raw.
        """
        data = mjx.make_data(
            self.scene.model,
            impl=self.impl,
            naconmax=WARP_CONTACTS_PER_WORLD * self.num_worlds,
            njmax=WARP_ROWS_PER_WORLD,
        )
        return self._begin(data, rng)

    def restart(self, state: State, where: Array) -> State:
        """Begin a new episode if ``where``; cheap, and safe for both implementations.

        Args:
            state: of a finished (or any) episode; its key is used up.
            where: boolean ().
        """
        key, key_next = jax.random.split(state.key)
        fresh = self._begin(state.data, key, where=where, old=state)
        return fresh.replace(key=jnp.where(where, key_next, state.key))

    def step(self, state: State, action: Array) -> State:  # pyrefly: ignore[bad-override]
        """One control step of 0.1 s.

        Args:
            state: of one world.
            action: in [-1, 1], clipped: robot's joints, then the active person's (n_action,).

        Raises:
            ActionError: the shape is wrong, or (outside of jit) entries are not finite.
        """
        action = self._checked(action)
        index, control, episode = self.scene.index, self.task.control, state.episode
        n_arm = len(index.robot_ctrl)
        model = self._model_of(episode)
        moving = muscles.is_moving(episode.person.tremor, self.active)
        # control
        q_arm = state.data.qpos[index.robot_qpos]
        goal = q_arm + control.action_scale * action[:n_arm]
        goal = jnp.clip(goal, self._limits[:, 0], self._limits[:, 1])
        person_target, hold = self._person_target(episode, state.data, action[n_arm:])
        data = state.data.replace(ctrl=state.data.ctrl.at[index.robot_ctrl].set(goal))

        # physics
        def substep(carry, _):
            data, touch = carry
            q, v = data.qpos[index.person_qpos], data.qvel[index.person_dof]
            torque = muscles.torque(
                self._driven, person_target, q, data.qfrc_bias[index.person_dof],
                episode.person.strength, moving,
            ) + self._limit_torque(q, v)  # fmt: skip
            data = data.replace(qfrc_applied=data.qfrc_applied.at[index.person_dof].set(torque))
            data = mjx.step(model, data)
            return (data, add_touch(index, touch, data.sensordata)), None

        (data, touch), _ = jax.lax.scan(substep, (data, no_touch(index)), length=control.frame_skip)
        # sense
        data = mjx.kinematics(model, data)
        sensed = self._sense(model, data, touch, control.frame_skip, episode)
        # task
        task, events = self.task.advance(state.task, sensed)
        rewards = self.task.rewards(task, events, sensed, action)
        # observe
        obs = self._observe(task, sensed)
        step = episode.step + 1
        bad = ~(
            jnp.all(jnp.isfinite(data.qpos)) & jnp.all(jnp.isfinite(data.qvel))
            & jnp.all(jnp.isfinite(obs)) & jnp.isfinite(sum(rewards.values()))
        )  # fmt: skip
        rewards = {k: jnp.where(bad, 0.0, v) for k, v in rewards.items()}
        over = (step >= self.episode_length) | bad
        stepped = state.replace(
            data=data,
            obs=jnp.where(bad, 0.0, obs),
            reward=sum(rewards.values()),
            done=over.astype(jnp.float32),
            metrics={**state.metrics, **self._metrics(task, rewards, sensed, data, bad)},
            task=task,
            episode=dataclasses.replace(episode, person_target=hold, step=step),
        )
        return _strong(stepped)

    # -- pieces ---------------------------------------------------------------------------------

    def _begin(
        self, data: Any, rng: Array, where: Array | None = None, old: State | None = None
    ) -> State:
        """Write a new episode into ``data``; with ``where`` and ``old``, only where it holds."""
        index, spec, moving = self.scene.index, self.task.person, self.scene.moving
        key_person, key_pose, key_place, key_task, key = jax.random.split(rng, 5)
        person = draw.draw_person(
            key_person, self.people, len(moving), spec.tremor_amplitude, spec.impairments
        )
        pose = person_pose.draw_pose(key_pose, spec, person)
        rows = self._rows_of(person, pose)
        row = jax.random.randint(key_place, (), 0, self._bank.arm_angles.shape[0])
        placement = jax.tree.map(lambda x: jnp.asarray(x)[row], self._bank)
        angles = person_pose.start_angles(pose, moving, person.limit_scale, jnp)
        episode = Episode(person, pose, rows, placement, angles, angles, jnp.int32(0))
        qpos = jnp.asarray(self.scene.model.qpos0, jnp.float32)
        qpos = qpos.at[index.robot_qpos].set(placement.arm_angles).at[index.person_qpos].set(angles)
        fresh = {
            "qpos": qpos, "qvel": jnp.zeros_like(data.qvel), "ctrl": jnp.zeros_like(data.ctrl),
            "qacc_warmstart": jnp.zeros_like(data.qacc_warmstart),
            "qfrc_applied": jnp.zeros_like(data.qfrc_applied),
            "qfrc_bias": jnp.zeros_like(data.qfrc_bias),
        }  # fmt: skip
        if where is not None and old is not None:
            fresh = {k: jnp.where(where, v, getattr(data, k)) for k, v in fresh.items()}
            episode = _select(where, episode, old.episode)
        model = self._model_of(episode)
        data = mjx.kinematics(model, data.replace(**fresh))
        if self.impl == "warp":
            data = place_static_geoms(self._static_geoms, model, data)
        sensed = self._sense(model, data, no_touch(index), 1, episode)
        task = self.task.init(key_task, sensed)
        obs = self._observe(task, sensed)
        zero = jnp.float32(0.0)
        if where is not None and old is not None:
            task, obs = _select(where, task, old.task), jnp.where(where, obs, old.obs)
            return _strong(old.replace(data=data, obs=obs, task=task, episode=episode))
        _, events = self.task.advance(task, sensed)
        terms = self.task.rewards(task, events, sensed, jnp.zeros(self.action_size))
        rewards = dict.fromkeys(terms, zero)  # only the names: nothing of this is computed
        metrics = self._metrics(task, rewards, sensed, data, jnp.bool_(False))
        return _strong(State(data, obs, zero, zero, metrics, {}, task, episode, key))

    def _rows_of(self, person: draw.Person, pose: person_pose.Pose) -> body.BodyFields:
        """The person's part of the model: rows of the scene's links."""
        moving, index = self.scene.moving, self.scene.index
        rows = person_pose.rows(
            self.task.person, pose, person.dims, moving, person.limit_scale, jnp
        )
        per_link = [k for k in rows._fields if not k.startswith("jnt")]
        return rows._replace(**{k: getattr(rows, k)[index.person_row] for k in per_link})

    def _model_of(self, episode: Episode) -> mjx.Model:
        """The model with this episode's person and robot base in it."""
        m, index, p, rows = self._model, self.scene.index, episode.person, episode.rows
        moving = muscles.is_moving(p.tremor, self.active)
        invweight = {
            name: jnp.asarray(
                _blend(getattr(self.scene.model, name), getattr(self.scene.female, name), p.sex)
            )
            for name in ("body_invweight0", "dof_invweight0")
        }
        bodies, geoms, joints = index.person_body, index.person_geom, index.person_joint
        return m.tree_replace({
            "body_pos": m.body_pos.at[bodies].set(rows.body_pos)
            .at[index.robot_base].set(episode.placement.base_pos),
            "body_quat": m.body_quat.at[bodies].set(rows.body_quat)
            .at[index.robot_base].set(episode.placement.base_quat),
            "body_mass": m.body_mass.at[bodies].set(rows.body_mass),
            "body_ipos": m.body_ipos.at[bodies].set(rows.body_ipos),
            "body_inertia": m.body_inertia.at[bodies].set(rows.body_inertia),
            "geom_size": m.geom_size.at[geoms].set(rows.geom_size),
            "geom_pos": m.geom_pos.at[geoms].set(rows.geom_pos),
            "geom_rbound": m.geom_rbound.at[geoms].set(rows.geom_rbound),
            "jnt_pos": m.jnt_pos.at[joints].set(rows.jnt_pos),
            "jnt_range": m.jnt_range.at[joints].set(rows.jnt_range),
            "dof_damping": m.dof_damping.at[index.person_dof].set(
                muscles.damping(self._driven, p.strength, moving)
            ),
            **invweight,
        })  # fmt: skip

    def _person_target(self, episode: Episode, data: Any, action: Array) -> tuple[Array, Array]:
        """What the muscles aim at in this control step, and what to remember of it.

        AG env.py take_step: the target is the angle measured now (or, with tremor, the pose held so
        far) plus the action; tremor adds its amplitude with alternating sign, minus first.
        """
        q = data.qpos[self.scene.index.person_qpos]
        trembles = jnp.any(episode.person.tremor != 0.0)
        target = episode.person_target
        if self.active:
            low, high = body.joint_limits(self.scene.moving, episode.person.limit_scale).T
            start = jnp.where(trembles, target, q)
            target = jnp.clip(start + self.task.control.action_scale * action, low, high)
        sign = jnp.where(episode.step % 2 == 0, -1.0, 1.0)
        return target + sign * episode.person.tremor, target

    def _limit_torque(self, q: Array, v: Array) -> Array:
        """Pose-dependent limits of the arm [N m] (n_person,)."""
        names = self.scene.moving
        torque = jnp.zeros_like(q)
        for side in ("right", "left"):
            arm = [f"{side[0]}_{j}" for j in ("shoulder_y", "shoulder_x", "shoulder_z", "elbow_x")]
            if arm[0] in names:
                i = np.array([names.index(j) for j in arm])
                torque = torque.at[i].set(
                    limits.limit_torque(
                        self._arm_limits, q[i], v[i], 1.0 if side == "right" else -1.0
                    )
                )
        return torque

    def _sense(self, model: Any, data: Any, touch: Any, n_steps: int, episode: Episode) -> Sensed:
        dims, index = episode.person.dims, self.scene.index
        return sense(index, data, touch, n_steps, dims, model.geom_size)

    def _observe(self, task: Any, sensed: Sensed) -> Array:
        robot, person = self.task.observe(task, sensed)
        records = [robot, person] if self.active else [robot]
        return jnp.concatenate([observe.flatten(r) for r in records])

    def _metrics(self, task: Any, rewards: dict, sensed: Sensed, data: Any, bad: Array) -> dict:
        clean = lambda x: jnp.where(bad, 0.0, x).astype(jnp.float32)  # noqa: E731
        return {
            **{f"reward/{k}": v for k, v in rewards.items()},
            "force/on_person": clean(sensed.force_on_person),
            "force/tool_on_person": clean(sensed.tool_on_person),
            "force/robot_on_person": clean(sensed.robot_on_person),
            "force/tool": clean(sum(t.force for t in sensed.tools)),
            "success": clean(self.task.success(task)),
            "nan": bad.astype(jnp.float32),
            "overflow": self._overflow(data),
        }

    def _overflow(self, data: Any) -> Array:
        """1.0 where Warp's buffers lost a contact or a constraint row ()."""
        if self.impl != "warp":
            return jnp.float32(0.0)
        return ((data._impl.overflow & WARP_LOST) != 0).any().astype(jnp.float32)

    def _checked(self, action: Array) -> Array:
        action = jnp.asarray(action, jnp.float32)
        if action.shape != (self.action_size,):
            parts = " + ".join(f"{v} {k}" for k, v in self.action_sizes.items())
            raise ActionError(
                f"{self.name} takes actions of shape ({self.action_size},) ({parts}), got "
                f"{action.shape}. Batches go through jax.vmap or agym_jax.wrappers.vectorize."
            )
        if not isinstance(action, jax.core.Tracer) and not np.all(np.isfinite(action)):
            raise ActionError(f"{self.name} was given an action with NaN or infinity: {action}.")
        # under jit nothing can be raised: such entries act as 0
        return jnp.clip(jnp.where(jnp.isfinite(action), action, 0.0), -1.0, 1.0)

    # -- pictures --------------------------------------------------------------------------------

    def to_mujoco(self, state: State) -> tuple[mujoco.MjModel, mujoco.MjData]:
        """One world as C MuJoCo's model and data, with everything that people look at.

        Args:
            state: of one world (index a batch first, with ``jax.tree.map(lambda x: x[i], state)``).
        """
        p, place = state.episode.person, state.episode.placement
        (x, y, z), (qw, qx, qy, qz) = place.base_pos.tolist(), place.base_quat.tolist()
        base = Pose((x, y, z), (qw, qx, qy, qz))
        pose = jax.tree.map(np.asarray, state.episode.pose)
        model = compose(
            self.task, self.robot, self.active, float(p.sex), float(p.stature), float(p.girth),
            float(p.limit_scale), pose, base, visual=True,
        )  # fmt: skip
        data = mujoco.MjData(model)
        self.write_mujoco(state, data, model)
        return model, data

    def write_mujoco(self, state: State, data: mujoco.MjData, model: mujoco.MjModel) -> None:
        """Write the pose of one world into C MuJoCo's data of ``to_mujoco``'s model."""
        data.qpos[:], data.qvel[:] = np.asarray(state.data.qpos), np.asarray(state.data.qvel)
        data.ctrl[:] = np.asarray(state.data.ctrl)
        mujoco.mj_forward(model, data)

    def markers(self, state: State) -> list[Any]:
        """What the task draws into pictures: positions (3,), radii, colours; one world's."""
        return [
            (pos, radius, colour)
            for places, radius, colour in self.task.markers(state.task)
            for pos in np.atleast_2d(np.asarray(places))
            if np.all(np.isfinite(pos))
        ]


def _strong(tree: Any) -> Any:
    """No weak types: what ``reset`` and ``step`` return must compile once."""
    return jax.tree.map(
        lambda x: jax.lax.convert_element_type(x, x.dtype) if getattr(x, "weak_type", False) else x,
        tree,
    )


def _select(where: Array, new: Any, old: Any) -> Any:
    return jax.tree.map(lambda a, b: jnp.where(where, a, b), new, old)


def _blend(male: np.ndarray, female: np.ndarray, sex: Array) -> Array:
    return jnp.asarray(male, jnp.float32) + sex * (female - male).astype(np.float32)


__all__ = ["AssistiveEnv", "Placement", "State"]
