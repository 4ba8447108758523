"""The environment: each step runs control -> physics -> sense -> task -> observe, in that order, once.

One class serves every task, robot and person. ``reset`` and ``step`` are pure functions of a single environment:
``jax.vmap`` them, or use ``agym_jax.wrappers.vectorize``, which also resets automatically. The physics is one of
the implementations in ``sim.physics``; where JAX cannot trace it, ``sim.native_rows`` runs the stages around it.

DEVIATION(quaternion-order): observed quaternions are wxyz; AG's are xyzw. Their sign at the start is AG's (of 688
recorded there none has the other), and then continuous; AG's jumps during an episode where w passes 1/2.
DEVIATION(one-turn): joints that turn freely begin in [-pi, pi) and are observed without a jump from there. AG's inverse
kinematics begins them elsewhere on the circle in 98 of 272 recorded resets of robots with such joints, all with Jaco and one turn
away, up to 5.0 rad: all 40 of Feeding, 30 of 40 of Drinking, 23 of 37 of ArmManipulation, 4 of 19 of Dressing, 1 of 40 of
BedBathing, none of ScratchItch. A policy from here that is run in AG has to be shown those columns in [-pi, pi) at the start.
DEVIATION(one-key): everything random follows from the key (AG's sex and impairment ignore the seed).
"""

from __future__ import annotations

import copy
import dataclasses
from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
from jax import Array

from agym_jax import observe
from agym_jax.changes import changes_of
from agym_jax.errors import WrapperError, checked_count
from agym_jax.human.population import Population, checked_population
from agym_jax.human.regions import comfort_limits, no_forces
from agym_jax.jax_settings import full_precision
from agym_jax.math3d import first_sign, nearest_sign
from agym_jax.memory import Averages, Past, checked_memory, observation_records, remember
from agym_jax.metrics import check_terms, metric_names, metrics_of, progress_of
from agym_jax.rendering.raycast import Marker
from agym_jax.sense import Motion, Sensed, quats_of, with_quats
from agym_jax.sim.arguments import check_key, check_single
from agym_jax.sim.control import Controller, ControlTargets, checked_action
from agym_jax.sim.episode import EpisodeSample, geom_sizes, make_episode, sample_episode
from agym_jax.sim.physics import build_physics, check_traceable, choose_impl, native_rows_of
from agym_jax.sim.pictures import markers_of, picture_model, write_pose
from agym_jax.sim.scene import build_scene
from agym_jax.sim.sensing import ContactSums, motion_at_rest, no_contacts, sense
from agym_jax.sim.starts import load_starts
from agym_jax.spec import Loaded, Privileged, RobotSpec, Task
from agym_jax.state import Episode, State, as_brax_env, last_seen, limited_by_brax, select, strong
from agym_jax.variation import RobotVariation, checked_variation, sample_robot, sensed_by

MAX_SPEED = 1e3
"""Largest joint speed [rad/s]: a simulation with a faster joint has diverged and is treated as NaN. Bullet's limit is 100."""


class AssistiveEnv:
    """An environment in which a robot assists a person.

    ``reset`` and ``step`` are pure functions of a single environment; see the module's docstring.

    Args:
        task: the task.
        robot: the robot that assists.
        active: whether the person acts too (AG's ``...Human-v0``).
        impl: ``"jax"``, ``"warp"``, ``"auto"`` (Warp on an NVIDIA GPU with warp-lang installed, otherwise JAX), or
            ``"native"`` (C MuJoCo on the CPU).
        humans: population from which each episode draws its person.
        num_envs: number of environments that will be stepped together; determines the size of Warp's buffers.
        variation: how the robot varies from episode to episode; None if it does not.
        memory: time constants of the averages in the observation [s], see ``agym_jax.memory``; None without memory.

    Attributes:
        changes: settings that differ from the id's defaults, see ``agym_jax.changes``.
    """

    def __init__(
        self,
        task: Task,
        robot: RobotSpec,
        active: bool = False,
        impl: str = "auto",
        humans: Population | None = None,
        num_envs: int = 1,
        variation: RobotVariation | None = None,
        memory: Sequence[float] | None = None,
    ):
        self.task, self.robot, self.active = task, robot, active
        self.comfort = comfort_limits(task)
        self.humans = checked_population(humans, task.human.tremor_amplitude)
        self.variation = checked_variation(variation)
        self.memory = checked_memory(memory, task.control.period)
        self.changes = changes_of(task, self.humans, self.variation, self.memory)
        self.impl = choose_impl(impl)
        self.num_envs = checked_count("num_envs", num_envs)
        self.scene = build_scene(task, robot, active)
        self.name = f"{task.name}{robot.name}{'Human' if active else ''}-v0"
        self.episode_length = task.episode_length
        self.controller = Controller.of(self.scene, task, active, self.humans.masses)
        self.physics = build_physics(self.impl, self.scene, self.controller, task, num_envs)
        self._starts = load_starts(task, robot, (self.variation or RobotVariation()).rare_starts)
        self.native_rows = None if self.physics.traceable else native_rows_of(self)
        if not self.native_rows:
            as_brax_env(type(self))

    def __repr__(self) -> str:
        changed = f", {len(self.changes)} settings changed" if self.changes else ""
        return f"AssistiveEnv({self.name!r}, impl={self.impl!r}{changed})"

    # -- sizes ---------------------------------------------------------------------------------

    @property
    def action_sizes(self) -> dict[str, int]:
        """Number of action entries of each agent, in order."""
        sizes = {"robot": len(self.scene.index.robot_joint)}
        return {**sizes, "human": len(self.scene.moving)} if self.active else sizes

    @property
    def observation_sizes(self) -> dict[str, int]:
        """Number of observation columns of each agent, in order."""
        return {agent: observe.size(record) for agent, record in self.observation_records.items()}

    @property
    def observation_records(self) -> dict[str, type]:
        """Record of each agent's observation, in order, with its memory."""
        return observation_records(self.task, self.active, self.memory)

    @property
    def action_size(self) -> int:
        """Length of an action."""
        return sum(self.action_sizes.values())

    @property
    def observation_size(self) -> int:
        """Length of an observation."""
        return sum(self.observation_sizes.values())

    @property
    def privileged_obs_size(self) -> int:
        """Length of ``State.privileged_obs``; 0 if the task has none."""
        return self.task.privileged_obs_size if isinstance(self.task, Privileged) else 0

    @property
    def layout_version(self) -> str:
        """Hash of the names and sizes of the observation's columns."""
        return observe.layout_version(*self.observation_records.values())

    @property
    def backend(self) -> str:
        """Brax's name for the physics implementation."""
        return self.impl

    @property
    def unwrapped(self) -> AssistiveEnv:
        """Brax's name for the environment without its wrappers."""
        return self

    @property
    def sys(self) -> Any:
        """Brax's name for a model shared by all environments; raises WrapperError, so that ``hasattr(env, "sys")`` is false."""
        raise WrapperError(
            f"{self.name} has no sys: each person has their own model, in state.episode. Instead of Brax's "
            f"DomainRandomizationVmapWrapper, use agym_jax.make(name, humans=Population(...), robot=RobotVariation(...)); "
            f"instead of its GymWrapper and DmEnvWrapper, gymnasium.make(name)."
        )

    @property
    def dt(self) -> float:
        """Length of a control step [s]."""
        return self.task.control.period

    def sized_for(self, num_envs: int) -> AssistiveEnv:
        """Return the same environment with Warp buffers sized for ``num_envs`` environments."""
        sized = copy.copy(self)
        sized.num_envs, sized.physics = num_envs, self.physics.sized_for(num_envs)
        return sized

    # -- the two pure functions ----------------------------------------------------------------

    @full_precision
    def reset(self, rng: Array) -> State:
        """Begin an episode with a new person, goal and robot start pose.

        Args:
            rng: PRNG key, typed or raw.
        """
        check_key(rng, self.name)
        check_traceable(self.physics, rng)
        if self.native_rows:
            return self.native_rows.reset_one(rng)
        return self._begin(self.physics.make_data(), rng)

    @full_precision
    def reset_where(self, state: State, where: Array) -> State:
        """Begin a new episode if ``where`` is true; cheap, and safe with every physics implementation.

        Args:
            state: state of a finished (or any) episode; its key is consumed.
            where: boolean ().
        """
        if self.native_rows:
            return self.native_rows.reset_one_where(state, where)
        key, key_next = jax.random.split(state.key)
        fresh = self._begin(state.data, key, where=where, old=state)
        return fresh.replace(key=jnp.where(where, key_next, state.key))

    @full_precision
    def step(self, state: State, action: Array) -> State:
        """Advance the environment by one control step of 0.1 s.

        Args:
            state: state of one environment.
            action: the robot's joints, then those of the person if active (n_action,). Beyond [-1, 1] they move as at the bound, but
                the penalty of the action goes on growing, as in AG.

        Raises:
            ActionError: if the shape is wrong, or (outside jit) an entry is not finite.
            ArgumentError: if the state is that of a batch.
        """
        action = checked_action(action, self.action_sizes, self.name)
        check_single(state, self.name)
        check_traceable(self.physics, state.obs, action)
        if self.native_rows:
            return limited_by_brax(self.native_rows.step_one(state, action))
        # control
        targets = self._control_targets(state.episode, state.data, state.task, action)
        # physics
        data, contacts, motion = self.physics.step(state.data, state.episode, targets)
        # sense -> task -> observe
        after, clock = self._evaluate_step(
            data, contacts, motion, state.task, state.past, state.episode, targets
        )
        after["metrics"] = {**state.metrics, **after["metrics"]}
        episode = dataclasses.replace(
            state.episode, human_target=targets.hold, step=clock, sent=targets.sent
        )
        return limited_by_brax(last_seen(state, state.replace(data=data, episode=episode, **after)))

    def _control_targets(
        self, episode: Episode, data: Any, task: Any, action: Array
    ) -> ControlTargets:
        """Joint targets of one control step."""
        load = self.task.load(task) if isinstance(self.task, Loaded) else None
        return self.controller.targets(episode, data, action, load)

    def _evaluate_step(
        self,
        data: Any,
        contacts: ContactSums,
        motion: Motion,
        task: Any,
        past: Past,
        episode: Episode,
        targets: ControlTargets,
    ) -> tuple[dict[str, Any], Array]:
        """Sense -> task -> observe, with the NaN guard: the fields of ``State``, and the number of steps taken ()."""
        # sense
        sensed = self._sense(data, contacts, motion, episode)
        quats = nearest_sign(quats_of(sensed), past.quats)
        sensed = with_quats(sensed, quats)
        # task
        task, events = self.task.advance(task, sensed)
        rewards = self.task.rewards(task, events, sensed, targets.action)
        check_terms(self.task, rewards)
        # observe
        step = episode.step + 1
        obs, privileged_obs, averages = self._observe(task, sensed, episode, step, past.averages)
        bad = ~(
            jnp.all(jnp.isfinite(data.qpos)) & jnp.all(abs(data.qvel) < MAX_SPEED)
            & jnp.all(jnp.isfinite(obs)) & jnp.isfinite(sum(rewards.values()))
        )  # fmt: skip
        rewards = {k: jnp.where(bad, 0.0, v) for k, v in rewards.items()}
        after = {
            "task": task,
            "obs": obs,
            "privileged_obs": privileged_obs,
            "past": select(bad, past, Past(quats, averages)),
            "reward": jnp.asarray(sum(rewards.values())),
            "done": ((step >= self.episode_length) | bad).astype(jnp.float32),
            "metrics": metrics_of(
                rewards,
                sensed,
                self.comfort,
                progress_of(self.task, task),
                bad,
                self.physics.overflow(data),
            ),
            "regions": jax.tree.map(lambda x: jnp.where(bad, 0.0, x), sensed.regions),
        }
        return strong((after, step))

    def jit_functions(self) -> tuple[Callable[[Array], State], Callable[[State, Array], State]]:
        """Return ``reset`` and ``step`` of one environment, compiled as far as the physics allows."""
        if self.native_rows:
            return self.reset, self.step
        return jax.jit(self.reset), jax.jit(self.step)

    # -- the beginning of an episode -----------------------------------------------------------

    def _begin(
        self, data: Any, rng: Array, where: Array | None = None, old: State | None = None
    ) -> State:
        """Write a new episode into ``data``; with ``where`` and ``old``, only where ``where`` is true."""
        sample, key_task, key = self._sample_episode(rng)
        episode = strong(make_episode(self.scene, self.task.human, sample))
        if where is not None and old is not None:
            episode = select(where, episode, old.episode)
        data = self.physics.reset(data, episode, where)
        seen, progress = self._begin_task(key_task, data, episode)
        if where is not None and old is not None:
            seen = select(where, seen, {name: getattr(old, name) for name in seen})
            return old.replace(data=data, episode=episode, **seen)
        zero = jnp.float32(0.0)
        metrics = dict.fromkeys(self.metric_names, zero) | progress
        return State(
            data=data, reward=zero, done=zero, metrics=metrics, info={}, episode=episode, key=key,
            regions=no_forces(), **seen
        )  # fmt: skip

    def _sample_episode(self, rng: Array) -> tuple[EpisodeSample, Array, Array]:
        """Draw an episode; also return the keys of the task and of later episodes."""
        *keys, key_task, key = jax.random.split(rng, 5)
        robot = sample_robot(rng, self.variation)
        sample = sample_episode(keys, self.scene, self.task.human, self.humans, self._starts, robot)
        return strong((sample, key_task, key))

    def _begin_task(
        self, key: Array, data: Any, episode: Episode
    ) -> tuple[dict[str, Any], dict[str, Array]]:
        """Start the task: return fields of ``State``, and its measures at the start, see ``metrics.progress_of``."""
        index = self.scene.index
        motion = motion_at_rest(index, data, self.task.control.frame_skip)
        sensed = self._sense(data, no_contacts(index), motion, episode)
        quats = first_sign(quats_of(sensed))
        sensed = with_quats(sensed, quats)
        task = self.task.init(key, sensed)
        obs, privileged_obs, averages = self._observe(task, sensed, episode, episode.step)
        past = Past(quats, averages)
        seen = {"task": task, "obs": obs, "privileged_obs": privileged_obs, "past": past}
        return strong((seen, progress_of(self.task, task)))

    # -- what stages share ---------------------------------------------------------------------

    @property
    def metric_names(self) -> tuple[str, ...]:
        """Names of the entries of ``State.metrics``, in order."""
        return metric_names(self.task)

    def _sense(self, data: Any, contacts: ContactSums, motion: Motion, episode: Episode) -> Sensed:
        sizes = geom_sizes(self.scene, episode)
        return sense(self.scene.index, data, contacts, motion, episode.human.dims, sizes)

    def _observe(
        self,
        task: Any,
        sensed: Sensed,
        episode: Episode,
        step: Array,
        before: Averages | None = None,
    ) -> tuple[Array, Array | None, Averages | None]:
        """Return the observation (n_obs,), the privileged one if the task has one (n_privileged,), and the averages."""
        robot, human = self.task.observe(task, sensed)
        seen = [sensed_by(episode.robot, type(robot), observe.flatten(robot), step)]
        seen += [observe.flatten(human)] if self.active else []
        obs, averages = remember(seen, before, self.memory, self.dt)
        privileged = isinstance(self.task, Privileged)
        return obs, self.task.privileged_obs(task) if privileged else None, averages  # pyrefly: ignore

    # -- pictures --------------------------------------------------------------------------------

    def to_mujoco(
        self, state: State, visuals: str = "primitives"
    ) -> tuple[mujoco.MjModel, mujoco.MjData]:
        """Return one environment as a C MuJoCo model and data, with all visual geometry.

        Args:
            state: state of one environment (of a batch, ``drawn_of(drawable(state), i)`` of ``agym_jax.state``).
            visuals: appearance of the robot: ``"primitives"``, or ``"meshes"`` from other packages, see
                ``agym_jax.rendering.meshes``.

        Raises:
            UnknownNameError: if there are no such visuals.
            MissingExtraError: if the meshes' package is not installed: ``pip install "agym_jax[meshes]"``.
            MeshError: if this robot has no meshes, or they do not fit it.
        """
        model = picture_model(self.task, self.robot, self.active, state, visuals)
        data = mujoco.MjData(model)
        self.write_mujoco(state, data, model)
        return model, data

    def write_mujoco(self, state: State, data: mujoco.MjData, model: mujoco.MjModel) -> None:
        """Write the pose of one environment into C MuJoCo data for the model from ``to_mujoco``."""
        write_pose(self.task, state, data, model)

    def markers(self, state: State) -> list[Marker]:
        """Return the markers that the task draws in pictures of one environment."""
        return markers_of(self.task, state)
