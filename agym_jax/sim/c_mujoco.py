"""Physics on C MuJoCo: environments on a CPU, in the rows of ``mujoco.batch.Batch``.

MJX takes half a minute to trace and compile; C MuJoCo takes nothing, and on a CPU it is several times faster.
It gets the same model, the same people written into it and the same draws, and what is around
the physics is the same code, compiled in small pieces. Trajectories agree with those of MJX as far
as float64 agrees with float32; MJX keeps the 8 deepest contacts of an environment, C MuJoCo keeps all.

A ``Slot`` steps a few environments on the thread that calls it. Compiled programs always get all its rows, so
what happens in an environment does not depend on how many there are beside it, nor on the number of threads.
"""

from __future__ import annotations

import copy
import dataclasses
import threading
from collections.abc import Mapping
from types import SimpleNamespace
from typing import Any, Protocol

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from jax import Array
from mujoco.batch import Batch, SimulationError

from agym_jax.human.muscles import Muscles
from agym_jax.sense import Motion
from agym_jax.sim.columns import Columns, Program, aligned
from agym_jax.sim.control import Controller, ControlTargets
from agym_jax.sim.episode import model_fields
from agym_jax.sim.girdle import Burden, consecutive
from agym_jax.sim.native_data import BEARING, MOTION, POSES, SAMPLED, NativeData, layout_of
from agym_jax.sim.native_drive import FORCES, DriveProgram, afterwards
from agym_jax.sim.scene import Scene
from agym_jax.sim.sensing import ContactSums, motion_of, read_contacts, sample_poses, total_contacts
from agym_jax.state import MOVING, Episode

ROWS = (32, 32)
"""Of the slot of a single environment, and of those of a batch, unless the task has its own ``cpu_rows``. More spare calls;
fewer spare the arithmetic of rows that are empty. Between slots of different size results differ by rounding."""
QUICKLY, RATHER_QUICKLY = ({"xla_backend_optimization_level": level} for level in (0, 1))
"""How to compile what runs once an episode; the latter what is much slower if it is not optimized at all."""
People = Any
"""Of an episode all that stays as it was drawn: ``Episode`` without what is ``MOVING``."""


class Watcher(Protocol):
    """What is told of every physics step of a single environment, see ``sim.impulse``."""

    def before(self, data: mujoco.MjData, load: np.ndarray) -> None:
        """One is about to begin, with a load on the robot's joints [N m] (n_arm,)."""
        ...

    def after(self, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        """It has been taken."""
        ...

    def finish(self) -> None:
        """A control step is over."""
        ...


class NativePhysics:
    """See ``physics.Physics``. Its methods are functions of their arguments, though not traceable ones.

    Args:
        scene: what is in the world.
        controller: of its joints.
        frame_skip: physics steps of a control step.
        rows: see ``ROWS``.
    """

    traceable = False

    def __init__(
        self, scene: Scene, controller: Controller, frame_skip: int, rows: tuple[int, int] = ROWS
    ):
        self.rows = rows
        self.scene, self.controller, self.frame_skip = scene, controller, frame_skip
        self.model = controller.model_of(_own_model(scene))
        empty = mujoco.MjData(self.model)
        self.layout, self.sampled = layout_of(empty), layout_of(empty, SAMPLED)
        self.watcher: Watcher | None = None
        self._alone: Slot | None = None

        def written(people: People) -> tuple[dict[str, Array], Muscles]:
            muscles = controller.muscles(people.human)
            own = controller.contact_fields(scene.model, people.human)
            return model_fields(scene, scene.model, people, muscles) | own, muscles

        self.written = Program(written, options=QUICKLY)
        self.drive = DriveProgram(controller, self.model)
        self.after_step = jax.jit(jax.vmap(afterwards(controller)))

    def sized_for(self, num_envs: int) -> NativePhysics:
        """The same: it takes any number of slots."""
        return self

    def slot(self, num_envs: int = 1) -> Slot:
        """A new slot, of so many environments."""
        rows = self.rows[0] if num_envs == 1 else self.rows[1]
        return Slot(self, rows, persistent=self.watcher is not None)

    @property
    def alone(self) -> Slot:
        """The slot of a single environment."""
        if self._alone is None or (self.watcher and not self._alone.batch.persistent):
            self._alone = self.slot()
        return self._alone

    def make_data(self) -> NativeData:
        """Data of an environment in which nothing has begun."""
        d = mujoco.MjData(self.model)
        parts = [getattr(d, name).ravel() for name, *_ in self.layout]
        return NativeData(np.concatenate(parts), self.layout)

    def reset(self, data: NativeData, episode: Episode, where: Any = None) -> NativeData:
        """One environment at rest at the start of an episode."""
        if where is not None and not where:
            return data
        with self.alone.lock:
            self.alone.load(jax.tree.map(lambda x: np.asarray(x)[None], episode), slice(0, 1))
            return NativeData(self.alone.reset(np.array([True]))[0], self.layout)

    def step(
        self, data: NativeData, episode: Episode, targets: ControlTargets
    ) -> tuple[NativeData, ContactSums, Motion]:
        """One control step of one environment. Its ``qpos`` are NaN if it goes non-finite."""
        with self.alone.lock:
            self.alone.load(jax.tree.map(lambda x: np.asarray(x)[None], episode), slice(0, 1))
            single = jax.tree.map(lambda x: np.asarray(x, np.float32)[None], targets)
            columns = Columns.of(single, self.alone.rows)
            numbers, sensors, samples = self.alone.step(data.numbers[None], columns)
            contacts, motion = self.sums(sensors[0], samples[0], np)
            return NativeData(numbers[0], self.layout), contacts, motion

    def sums(self, sensors: Any, samples: Any, xp: Any = jnp) -> tuple[ContactSums, Motion]:
        """What a slot's step leaves of one environment's physics steps, as ``sense`` reads it.

        Args:
            sensors: contact sensors after each (n, nsensordata).
            samples: the fields ``SAMPLED`` at each, and at the end (n + 1, all).
            xp: numpy or jax.numpy.
        """
        index, at = self.scene.index, NativeData(samples, self.sampled)
        contacts = total_contacts(read_contacts(index, sensors, xp), xp)
        return contacts, motion_of(index, sample_poses(index, at, xp), xp)

    def overflow(self, data: NativeData) -> Array:
        """Never: C MuJoCo's buffers grow ()."""
        return jnp.float32(0.0)


class Slot:
    """Some environments, stepped by the thread that calls; hold its ``lock`` meanwhile.

    Args:
        physics: of the environments.
        rows: most environments.
        persistent: whether MuJoCo keeps all data of every environment, for a watcher.
    """

    def __init__(self, physics: NativePhysics, rows: int, persistent: bool = False):
        self.physics, self.rows, self.lock = physics, rows, threading.Lock()
        self.batch = batch = Batch(physics.model, rows, 1, persistent)
        batch.warning[:] = 1  # MuJoCo logs a first warning into the current folder
        self._own: list[Any] = []  # leaves of the episodes that are loaded
        self._packed: np.ndarray | None = None  # the same, of this slot's rows
        self.people: Any = None  # Columns of this slot's ``People``, on the device
        self.written: Any = None  # Columns of what ``physics.written`` makes of them
        self.muscles: Any = None  # theirs, in NumPy
        self._burden: Any = None  # what their girdles bear
        self._solref = batch.expand("dof_solref")
        self._state = {name: batch.bind(name) for name in MOTION[:3]}
        self._applied = batch.bind("qfrc_applied")
        outputs = ("M", "qfrc_bias", "sensordata", *FORCES, *POSES)
        self._out = {name: batch.bind(name).reshape(rows, -1) for name in outputs}
        self._drive_input = aligned((rows, physics.drive.inputs))

    def load(self, episode: Episode, part: slice) -> None:
        """Write the people of these rows into the model, where they are not yet.

        Args:
            episode: of all environments, with a leading axis.
            part: which of them are this slot's rows, from the first on.
        """
        people = people_of(episode)
        leaves = jax.tree.leaves(people)
        if len(leaves) == len(self._own) and all(
            a is b for a, b in zip(leaves, self._own, strict=True)
        ):
            return
        self._own = leaves
        self._write(Columns.of(people, self.rows, part))

    def write(self, people: People, rows: np.ndarray | None = None) -> None:
        """Write other people into the model.

        Args:
            people: of environments (n, ...).
            rows: theirs (n,), while the others keep theirs; by default the first ones.
        """
        columns = Columns.of(people, self.rows, rows=rows)
        if rows is not None and self._packed is not None:
            others = np.isin(np.arange(self.rows), rows, invert=True)
            columns.array[others] = self._packed[others]
        self._own = []
        self._write(columns)

    def _write(self, columns: Columns) -> None:
        changed = np.full(self.rows, self._packed is None)
        if self._packed is not None:
            changed |= (self._packed != columns.array).any(axis=1)
        self._packed = columns.array
        if not changed.any():
            return
        self.people = columns.on_device()
        self.written = self.physics.written(self.people)
        fields, self.muscles = self.written.tree()
        for name, value in fields.items():
            self.batch.expand(name)[changed] = value[changed]
        if girdle := self.physics.controller.girdle:
            model = {name: self.batch.expand(name) for name in ("body_mass", "body_ipos")}
            borne = self.muscles.passive[:, girdle.rows, None]  # those who are borne: 1, or 0
            mass, total, centre = girdle.burden(SimpleNamespace(**model))
            self._burden = Burden(borne * mass, borne * total, centre)

    def fill(self, x: np.ndarray) -> np.ndarray:
        """All rows of an array: those that are missing as the first (rows, ...)."""
        if len(x) == self.rows:
            return x
        return np.concatenate([x, np.broadcast_to(x[:1], (self.rows - len(x), *x.shape[1:]))])

    def narrow(self, numbers: np.ndarray) -> np.ndarray:
        """``NativeData.numbers`` for compiled programs: all rows, float32 (rows, all)."""
        n, narrow = len(numbers), aligned((self.rows, numbers.shape[1]))
        with np.errstate(over="ignore"):
            narrow[:n] = numbers
        narrow[n:] = narrow[0]
        return narrow

    def reset(self, where: np.ndarray) -> np.ndarray:
        """Environments at rest as the loaded episodes begin.

        Args:
            where: which rows (n,), n at most ``rows``; what the others hold means nothing.

        Returns:
            ``NativeData.numbers`` of the rows (n, all).
        """
        index, n = self.physics.scene.index, len(where)
        qpos = self._state["qpos"]
        for field in self._state.values():
            field[:] = 0.0
        qpos[:] = self.physics.model.qpos0
        people = self.people.tree()
        qpos[:, index.robot_qpos] = people.placement.arm_angles
        qpos[:, index.human_qpos] = people.human_angles
        self.batch.forward(np.flatnonzero(where), mujoco.mjtStage.mjSTAGE_POS.value)
        zero = np.zeros_like(self._out["M"]), np.zeros_like(self._out["qfrc_bias"])
        return self._numbers(*zero)[:n]

    def step(
        self, numbers: np.ndarray, targets: Columns
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """One control step of the environments that are loaded.

        The ``qpos`` of an environment that goes non-finite are NaN; the others do not notice.

        Args:
            numbers: of ``NativeData`` (n, all), n at most ``rows``.
            targets: ``ControlTargets`` (rows, ...).

        Returns:
            Numbers after it (n, all), and of each physics step the contact sensors (n, steps, nsensordata) and
            poses (n, steps + 1, all), see ``NativePhysics.sums``.
        """
        physics, batch, n = self.physics, self.batch, len(numbers)
        data, steps = NativeData(numbers, physics.layout), physics.frame_skip
        for name, field in self._state.items():
            field[:n] = getattr(data, name)
        given = [data.qpos, data.qvel, data.M, data.qfrc_bias]
        poses = {name: self.fill(getattr(data, name)) for name in BEARING}
        alive, watcher, asked = np.ones(n, bool), physics.watcher, targets.tree()
        sensors = aligned((self.rows, steps, self._out["sensordata"].shape[1]))
        samples = aligned((self.rows, steps + 1, physics.sampled[-1][2]))
        sensors[:] = samples[:] = 0.0
        with np.errstate(over="ignore", invalid="ignore"):
            last = physics.drive.first(self._drive_input, given)
            for k in range(steps):
                drive = physics.drive(self._drive_input, last, targets, self.written)
                alive &= drive.sound[:n]
                if not alive.any():
                    break
                if watcher:
                    watcher.before(batch.get_data(0), asked.load[0])
                drive.write(self._state, self._applied, self._solref)
                self._bear(poses)
                self._step(alive)
                if watcher:
                    watcher.after(batch.get_model(0), batch.get_data(0))
                last = drive
                if physics.controller.at_joints:
                    self._stop_at_joints(alive)
                self._sample(sensors[:, k], samples[:, k])
                physics.drive.gather(self._drive_input, self._state, self._out)
                poses = self._out
            alive &= self._sound()[:n]
            inertia, bias = self._out["M"].copy(), physics.drive.bias(last, asked, self._out)
            if alive.any():
                self.batch.forward(np.flatnonzero(alive), mujoco.mjtStage.mjSTAGE_POS.value)
            self._sample(None, samples[:, steps])
        if watcher:
            watcher.finish()
        after = self._numbers(inertia, bias)[:n]
        for row in np.flatnonzero(~alive):  # the guard against NaN sees it
            after[row] = data.numbers[row]
            NativeData(after[row], physics.layout).qpos[:] = np.nan
            before = NativeData(numbers[row], physics.layout)
            samples[row] = np.concatenate([getattr(before, x).ravel() for x in SAMPLED])
            sensors[row] = 0.0
        return after, sensors, samples

    def _step(self, alive: np.ndarray) -> None:
        """One physics step; ``alive`` (n,) becomes false where MuJoCo could not take it."""
        ids = None if len(alive) == self.rows and alive.all() else np.flatnonzero(alive)
        try:
            self.batch.step(ids)
        except SimulationError as error:
            alive[error.ids] = False

    def _bear(self, poses: Mapping[str, np.ndarray]) -> None:
        """Add what bears the arms of seated people, given where everything is (rows, ...)."""
        girdle = self.physics.controller.girdle
        if girdle is None:
            return
        data = SimpleNamespace(**{name: poses[name].reshape(self.rows, -1, 3) for name in BEARING})
        dofs = consecutive(self.physics.scene.index.human_dof[girdle.rows])
        self._applied[:, dofs] += girdle.torque(self._burden, data, np)

    def _sound(self) -> np.ndarray:
        """Where C MuJoCo can go on: all numbers are finite, and fit into float32 (rows,)."""
        fields = (self._state["qpos"], self._state["qvel"])
        return np.all([np.abs(x).max(axis=1) < mujoco.mjMAXVAL for x in fields], axis=0)

    def _sample(self, sensors: np.ndarray | None, samples: np.ndarray) -> None:
        """Keep what a physics step has left behind."""
        if sensors is not None:
            sensors[:] = self._out["sensordata"]
        for name, start, stop, _ in self.physics.sampled:
            samples[:, start:stop] = self._out[name]

    def _stop_at_joints(self, alive: np.ndarray) -> None:
        """What ``Controller.after_step`` makes of the joints of people with AG's masses."""
        index, at_joints = self.physics.scene.index, self.people.tree().human.at_joints
        rows = np.flatnonzero(alive & (at_joints[: len(alive)] > 0.0))
        names = ("geom_size", "jnt_range")
        model = {name: self.batch.expand(name).astype(np.float32) for name in names}
        fields = {name: x.astype(np.float32) for name, x in (self._state | self._out).items()}
        q, v = map(np.asarray, self.physics.after_step(model, fields, at_joints))
        self._state["qpos"][np.ix_(rows, index.human_qpos)] = q[rows]
        self._state["qvel"][np.ix_(rows, index.human_dof)] = v[rows]

    def _numbers(self, inertia: np.ndarray, bias: np.ndarray) -> np.ndarray:
        """``NativeData.numbers`` of all rows (rows, all)."""
        poses = [self._out[name] for name in POSES]
        return np.concatenate([*self._state.values(), bias, inertia, *poses], axis=1)


def people_of(episode: Episode) -> People:
    """What of an episode stays as it was drawn."""
    nothing: Any = dict.fromkeys(MOVING)
    return dataclasses.replace(episode, **nothing)


def _own_model(scene: Scene) -> mujoco.MjModel:
    """A copy of the scene's model to write people into, which does not reset what goes non-finite.

    Where a geom or an inertia lies at the origin of its body, the compiler marks it as such; not
    every person's does.
    """
    model, index = copy.copy(scene.model), scene.index
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET
    model.geom_sameframe[index.human_geom] = mujoco.mjtSameFrame.mjSAMEFRAME_NONE
    model.body_sameframe[index.human_body] = mujoco.mjtSameFrame.mjSAMEFRAME_NONE
    return model
