"""An environment's functions around C MuJoCo, for the rows of a slot: compiled for all rows at once, called from Python."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from threading import Thread
from typing import Any, NamedTuple

import jax
import numpy as np
from jax import Array

from agym_jax.human.regions import no_forces
from agym_jax.jax_settings import full_precision
from agym_jax.sim.c_mujoco import QUICKLY, NativeData, NativePhysics, Slot, people_of
from agym_jax.sim.episode import EpisodeSample, make_episode
from agym_jax.state import MOVING, Episode, State, moved, raw_key


class Stages(NamedTuple):
    """The functions of one environment; see ``AssistiveEnv``."""

    sample: Callable[[Array], tuple[Any, Array, Array]]
    make_episode: Callable[[Any], Episode]  # in NumPy
    init_task: Callable[[Array, Any, Episode], tuple[dict[str, Any], Array]]
    targets: Callable[[Episode, Any, Any, Array], Any]
    evaluate: Callable[..., tuple[dict[str, Any], Array]]


class NativeRows:
    """Resets and steps environments of C MuJoCo.

    Args:
        physics: of the environments.
        stages: around it.
        metric_names: of ``State.metrics``.
        action_size: entries of an action.
    """

    def __init__(
        self,
        physics: NativePhysics,
        stages: Stages,
        metric_names: tuple[str, ...],
        action_size: int,
    ):
        self.physics, self._stages, self._metric_names = physics, stages, metric_names
        self._action_size = action_size
        self.revise: Callable[[EpisodeSample], EpisodeSample] | None = None
        """What becomes of what was drawn before its episode begins, in NumPy; for people whom a user chooses."""
        whole = lambda f, **how: jax.jit(jax.vmap(full_precision(f)), **how)  # noqa: E731
        self._sample = whole(stages.sample, compiler_options=QUICKLY)
        self._preparing: dict[int, Thread] = {}
        self._init_task = whole(self._begin)
        self._targets = whole(self._aim)
        self._evaluate = whole(self._finish)
        self._split = jax.jit(jax.vmap(jax.random.split))

    @classmethod
    def of(cls, env: Any) -> NativeRows:
        """Of an ``AssistiveEnv``."""

        def begin(sample: Any) -> Episode:
            return make_episode(env.scene, env.task.human, sample, np)

        around = (env._begin_task, env._control_targets, env._evaluate_step)
        stages = Stages(env._sample_episode, begin, *around)
        return cls(env.physics, stages, env.metric_names, env.action_size)

    # -- what is compiled, for one environment ---------------------------------------------------

    def _begin(self, key: Array, numbers: Array, episode: Episode) -> Any:
        data = NativeData(numbers, self.physics.layout)
        return self._stages.init_task(key, data, episode)

    def _aim(self, people: Any, moving: Any, numbers: Array, task: Any, action: Array) -> Any:
        data = NativeData(numbers, self.physics.layout)
        return self._stages.targets(_episode(people, moving), data, task, action)

    def _finish(
        self, people: Any, moving: Any, numbers: Array, sensors: Array, samples: Array,
        task: Any, quats: Array, targets: Any,
    ) -> Any:  # fmt: skip
        data = NativeData(numbers, self.physics.layout)
        sums, motion = self.physics.sums(sensors, samples)
        episode = _episode(people, moving)
        return self._stages.evaluate(data, sums, motion, task, quats, episode, targets)

    def _prepare(self, rows: int, key: np.ndarray, episode: Episode) -> None:
        """Compile what a step needs while the first reset goes on, in a thread.

        Args:
            rows: of the slot.
            key: of a task (rows, 2).
            episode: any (rows, ...).
        """
        if rows not in self._preparing:
            thread = Thread(target=self._compile_step, args=(rows, key, episode))
            self._preparing.setdefault(rows, thread)
            thread.start()

    def _compile_step(self, rows: int, key: np.ndarray, episode: Episode) -> None:
        physics = self.physics
        numbers = np.zeros((rows, physics.layout[-1][2]))
        seen, _ = jax.eval_shape(self._init_task, key, numbers, episode)
        people, moving = people_of(episode), _moving(episode)
        _, muscles = jax.eval_shape(physics.written, people)
        muscles, seen = jax.tree.map(lambda x: np.zeros(x.shape, x.dtype), (muscles, seen))
        action = np.zeros((rows, self._action_size), np.float32)
        targets = self._targets(people, moving, numbers, seen["task"], action)
        inputs = np.zeros((rows, physics.drive.inputs), np.float32)
        physics.drive(inputs, physics.drive.nothing(rows), targets, muscles)
        sensors = np.zeros((rows, physics.frame_skip, physics.model.nsensordata), np.float32)
        samples = np.zeros((rows, physics.frame_skip + 1, physics.sampled[-1][2]), np.float32)
        told = numbers, sensors, samples, seen["task"], seen["quats"], targets
        self._evaluate(people, moving, *told)

    # -- rows of a slot --------------------------------------------------------------------------

    def split(self, slot: Slot, keys: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Of each key the next episode's, and what the environment keeps (n, 2)."""
        split = np.asarray(self._split(slot.fill(keys)))[: len(keys)]
        return split[:, 0], split[:, 1]

    def reset(
        self, slot: Slot, keys: np.ndarray, rows: np.ndarray | None = None, beside: Any = None
    ) -> dict[str, Any]:
        """Begin episodes.

        Args:
            slot: that takes them.
            keys: raw PRNG keys (n, 2), n at most the slot's.
            rows: of the slot, in which they begin (n,); by default the first ones.
            beside: with ``rows``, the episodes that all rows have been in: the others stay written in the slot.

        Returns:
            Fields of ``State`` (n, ...), without what a finished step leaves.
        """
        n = len(keys)
        drawn, key_task, key = jax.device_get(self._sample(slot.fill(keys)))
        each = [self._make_episode(jax.tree.map(lambda x, i=i: x[i], drawn)) for i in range(n)]
        episode = jax.tree.map(lambda *x: np.stack(x), *each)
        if rows is None:
            rows, whole = np.arange(n), jax.tree.map(slot.fill, episode)
        else:

            def placed(old: Any, new: Any) -> np.ndarray:
                whole = np.array(slot.fill(np.asarray(old)))
                whole[rows] = new[:n]
                return whole

            key_task = placed(key_task, key_task)
            whole = jax.tree.map(placed, beside, episode)
        self._prepare(slot.rows, key_task, whole)
        slot.load(whole, slice(0, slot.rows))
        begins = np.zeros(slot.rows, bool)
        begins[rows] = True
        numbers = slot.reset(begins)
        seen, success = jax.device_get(self._init_task(key_task, numbers, whole))
        zero = np.zeros(n, np.float32)
        metrics = dict.fromkeys(self._metric_names, zero) | {"success": success[rows]}
        fields = {"reward": zero, "done": zero, "metrics": metrics, "episode": episode}
        fields |= {"regions": jax.tree.map(lambda x: np.zeros((n, *x.shape), x.dtype), no_forces())}
        fields |= jax.tree.map(lambda x: x[rows], seen) | {"key": key[:n]}
        return fields | {"data": NativeData(numbers[rows], self.physics.layout)}

    def _make_episode(self, drawn: EpisodeSample) -> Episode:
        return self._stages.make_episode(self.revise(drawn) if self.revise else drawn)

    def step(self, slot: Slot, state: State, part: slice, action: np.ndarray) -> dict[str, Any]:
        """One control step.

        Args:
            slot: of these environments.
            state: of all environments (num_envs, ...).
            part: the slot's.
            action: theirs, float32 (n, n_action).

        Returns:
            Fields of ``State`` that change, the episode's by their names in ``MOVING`` (n, ...).
        """
        if slot.rows in self._preparing:
            self._preparing[slot.rows].join()
        n, episode = len(action), state.episode
        rows = lambda tree: jax.tree.map(lambda x: slot.fill(np.asarray(x)[part]), tree)  # noqa: E731
        slot.load(episode, part)
        numbers = np.asarray(state.data.numbers)[part]
        moving = rows(_moving(episode))
        task, quats = rows((state.task, state.quats))
        before = slot.fill(numbers)
        targets = self._targets(slot.people, moving, before, task, slot.fill(action))
        numbers, sensors, samples = slot.step(numbers, targets)
        after, clock = self._evaluate(
            slot.people, moving, slot.fill(numbers), sensors, samples, task, quats, targets
        )
        moving = dict(zip(MOVING, (targets.hold, clock, targets.sent), strict=True))
        found = jax.tree.map(lambda x: np.asarray(x)[:n], after | moving)
        return found | {"data": NativeData(numbers, self.physics.layout)}

    # -- one environment -------------------------------------------------------------------------

    def reset_one(self, key: np.ndarray) -> State:
        """A new episode from a raw key (2,)."""
        slot = self.physics.alone
        with slot.lock:
            fields = self.reset(slot, np.asarray(key)[None])
        return State(info={}, **jax.tree.map(lambda x: x[0], fields))

    def reset_one_where(self, state: State, where: Any) -> State:
        """A new episode if ``where``, from the state's key."""
        if not np.asarray(where):
            return state
        key, key_next = self.split(self.physics.alone, np.asarray(raw_key(state.key))[None])
        fresh = self.reset_one(key[0])
        kept = {
            name: getattr(state, name) for name in ("reward", "done", "metrics", "info", "regions")
        }
        return fresh.replace(key=key_next[0], **kept)

    def step_one(self, state: State, action: np.ndarray) -> State:
        """One control step of one environment."""
        slot = self.physics.alone
        batch = jax.tree.map(lambda x: np.asarray(x)[None], state.replace(info={}))
        with slot.lock:
            fields = self.step(slot, batch, slice(0, 1), action[None])
        return moved(state, jax.tree.map(lambda x: x[0], fields))


def _moving(episode: Episode) -> tuple[Any, ...]:
    """What of an episode a step changes."""
    return tuple(getattr(episode, name) for name in MOVING)


def _episode(people: Any, moving: Any) -> Episode:
    """An episode from what stays and what moves."""
    fields: Any = dict(zip(MOVING, moving, strict=True))
    return dataclasses.replace(people, **fields)
