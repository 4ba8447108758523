"""An environment's functions around C MuJoCo, for the rows of a slot: compiled for all rows at once, called from Python."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from threading import Thread
from typing import Any, NamedTuple

import jax
import numpy as np
from jax import Array

from agym_jax.human.regions import REGIONS, RegionForces
from agym_jax.sim.c_mujoco import QUICKLY, RATHER_QUICKLY, ROWS, NativePhysics, Slot, people_of
from agym_jax.sim.columns import Columns, Program
from agym_jax.sim.episode import EpisodeSample, make_episode
from agym_jax.sim.native_data import NativeData
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
        self._sample = Program(stages.sample, options=QUICKLY)
        self._preparing: dict[int, Thread] = {}
        self._init_task = Program(self._begin, options=RATHER_QUICKLY)
        self._targets = Program(self._aim)
        self._evaluate = Program(self._finish, small=physics.rows == ROWS)  # others have matter
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

    def _begin(self, people: Any, begins: tuple[Array, Any], numbers: Array) -> Any:
        data = NativeData(numbers, self.physics.layout)
        key, moving = begins
        return self._stages.init_task(key, data, _episode(people, moving))

    def _aim(self, people: Any, goes_on: tuple[Any, ...], numbers: Array) -> Any:
        data = NativeData(numbers, self.physics.layout)
        moving, task, _, action = goes_on
        return self._stages.targets(_episode(people, moving), data, task, action)

    def _finish(
        self, people: Any, goes_on: tuple[Any, ...], numbers: Array, sensors: Array, samples: Array, targets: Any
    ) -> Any:  # fmt: skip
        data = NativeData(numbers, self.physics.layout)
        sums, motion = self.physics.sums(sensors, samples)
        moving, task, past, _ = goes_on
        episode = _episode(people, moving)
        return self._stages.evaluate(data, sums, motion, task, past, episode, targets)

    def _prepare(self, rows: int, episode: Episode, begins: Columns) -> None:
        """Compile what a step needs while the first reset goes on, in a thread.

        Args:
            rows: of the slot.
            episode: any (rows, ...).
            begins: the second argument of ``_begin``.
        """
        if rows not in self._preparing:
            thread = Thread(target=self._compile_step, args=(rows, episode, begins))
            self._preparing.setdefault(rows, thread)
            thread.start()

    def _compile_step(self, rows: int, episode: Episode, begins: Columns) -> None:
        physics, people = self.physics, Columns.of(people_of(episode), rows)
        written = Columns.of(physics.written.shapes(people), rows)
        numbers = np.zeros((rows, physics.layout[-1][2]), np.float32)
        seen, _ = self._init_task.shapes(people, begins, numbers)
        _, moving = begins.tree()
        action = np.zeros((rows, self._action_size), np.float32)
        goes_on = Columns.of((moving, seen["task"], seen["past"], action), rows)
        targets = self._targets(people, goes_on, numbers)
        inputs = np.zeros((rows, physics.drive.inputs), np.float32)
        physics.drive(inputs, physics.drive.nothing(rows), targets, written)
        sensors = np.zeros((rows, physics.frame_skip, physics.model.nsensordata), np.float32)
        samples = np.zeros((rows, physics.frame_skip + 1, physics.sampled[-1][2]), np.float32)
        self._evaluate(people, goes_on, numbers, sensors, samples, targets)

    # -- rows of a slot --------------------------------------------------------------------------

    def split(self, slot: Slot, keys: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Of each key the next episode's, and what the environment keeps (n, 2)."""
        split = np.asarray(self._split(slot.fill(keys)))[: len(keys)]
        return split[:, 0], split[:, 1]

    def reset(self, slot: Slot, keys: np.ndarray, rows: np.ndarray | None = None) -> dict[str, Any]:
        """Begin episodes.

        Args:
            slot: that takes them.
            keys: raw PRNG keys (n, 2), n at most the slot's.
            rows: of the slot, in which they begin (n,), while the others stay as they are; by default the first ones.

        Returns:
            Fields of ``State`` (n, ...), without what a finished step leaves.
        """
        n = len(keys)
        drawn = [self._sample(keys[i : i + 1]).tree() for i in range(n)]  # few begin together
        drawn = [jax.tree.map(lambda x: x[0], x) for x in drawn]
        each = [(self._make_episode(sample), *drawn_keys) for sample, *drawn_keys in drawn]
        episode, key_task, key = jax.tree.map(lambda *x: np.stack(x), *each)
        begins = Columns.of((key_task, _moving(episode)), slot.rows, rows=rows)
        self._prepare(slot.rows, episode, begins)
        slot.write(people_of(episode), rows)
        rows = np.arange(n) if rows is None else rows
        numbers = slot.reset(np.isin(np.arange(slot.rows), rows))
        seen, progress = self._init_task(slot.people, begins, slot.narrow(numbers)).tree()
        zero = np.zeros(n, np.float32)
        known = jax.tree.map(lambda x: x[rows], progress)
        metrics = dict.fromkeys(self._metric_names, zero) | known
        fields = {"reward": zero, "done": zero, "metrics": metrics, "episode": episode}
        untouched: Any = np.zeros((n, 2, len(REGIONS)), np.float32)
        fields |= {"regions": RegionForces(untouched)}
        fields |= jax.tree.map(lambda x: x[rows], seen) | {"key": key}
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
        slot.load(episode, part)
        numbers = np.asarray(state.data.numbers)[part]
        tree = (_moving(episode), state.task, state.past)
        goes_on = Columns.of(
            (*jax.tree.map(lambda x: np.asarray(x)[part], tree), action), slot.rows
        )
        targets = self._targets(slot.people, goes_on, slot.narrow(numbers))
        numbers, sensors, samples = slot.step(numbers, targets)
        after, clock = self._evaluate(
            slot.people, goes_on, slot.narrow(numbers), sensors, samples, targets
        ).tree(n)
        sent = targets.tree(n)
        moving = dict(zip(MOVING, (sent.hold, clock, sent.sent), strict=True))
        return after | moving | {"data": NativeData(numbers, self.physics.layout)}

    # -- one environment -------------------------------------------------------------------------

    def reset_one(self, key: np.ndarray) -> State:
        """A new episode from a PRNG key, typed or raw."""
        slot = self.physics.alone
        with slot.lock:
            fields = self.reset(slot, np.asarray(raw_key(key))[None])  # pyrefly: ignore
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
