"""Physics on C MuJoCo: one environment on the CPU, whose first step comes within seconds.

MJX takes half a minute to trace and compile; C MuJoCo takes nothing, and one environment runs faster on it.
It gets the same model, the same people written into it and the same draws, and what is around
the physics is the same code, compiled in small pieces. Trajectories agree with those of MJX as far
as float64 agrees with float32; MJX keeps the 8 deepest contacts of an environment, C MuJoCo keeps all.
"""

from __future__ import annotations

import copy
import dataclasses
import threading
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from jax import Array

from agym_jax.human.muscles import Muscles
from agym_jax.sense import Motion
from agym_jax.sim.control import Controller, ControlTargets
from agym_jax.sim.episode import model_fields
from agym_jax.sim.motors import Aim
from agym_jax.sim.scene import Scene
from agym_jax.sim.sensing import (
    ContactSums,
    motion_at_rest,
    motion_of,
    no_contacts,
    read_contacts,
    sample_poses,
    total_contacts,
)
from agym_jax.state import Episode

Layout = tuple[tuple[str, int, int, tuple[int, ...]], ...]
"""Name, start, stop and shape of each field in ``NativeData.numbers``."""
MOTION = ("qpos", "qvel", "qacc_warmstart", "qfrc_bias", "M")
"""Fields that decide what happens next."""
POSES = ("xpos", "xmat", "xquat", "xanchor", "xaxis", "site_xpos", "geom_xpos", "geom_xmat")
"""Fields that ``sense`` reads besides."""


def _field(name: str) -> Any:
    """A property: the part of ``numbers`` that has this name."""

    def view(data: NativeData) -> Any:
        start, stop, shape = next(x[1:] for x in data.layout if x[0] == name)
        return data.numbers[start:stop].reshape(shape)

    return property(view, doc=f"``{name}`` of ``MjData``.")


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class NativeData:
    """One environment of C MuJoCo: what matters of ``MjData``, under the same names.

    It lies in one array, because each array that enters a compiled function costs some microseconds.
    """

    numbers: Any  # float64 (n,)
    layout: Layout = dataclasses.field(metadata={"static": True})

    qpos = _field("qpos")  # [rad]                                            (nq,)
    qvel = _field("qvel")  # [rad/s]                                          (nv,)
    qacc_warmstart = _field("qacc_warmstart")  # where the solver begins      (nv,)
    qfrc_bias = _field("qfrc_bias")  # gravity and inertial torque [N m]      (nv,)
    M = _field("M")  # inertia matrix, sparse, of the last physics step       (nC,)
    xpos = _field("xpos")  # of bodies, world [m]                             (nbody, 3)
    xmat = _field("xmat")  #                                                  (nbody, 9)
    xquat = _field("xquat")  # wxyz                                           (nbody, 4)
    xanchor = _field("xanchor")  # of joints, world [m]                       (njnt, 3)
    xaxis = _field("xaxis")  #                                                (njnt, 3)
    site_xpos = _field("site_xpos")  # world [m]                              (nsite, 3)
    geom_xpos = _field("geom_xpos")  # world [m]                              (ngeom, 3)
    geom_xmat = _field("geom_xmat")  #                                        (ngeom, 9)

    @classmethod
    def of(cls, d: mujoco.MjData, layout: Layout) -> NativeData:
        """A copy of what C MuJoCo has now."""
        return cls(np.concatenate([getattr(d, name).ravel() for name, *_ in layout]), layout)

    def replace(self, **changes: Any) -> NativeData:
        """A copy with some fields changed."""
        copy = NativeData(np.array(self.numbers), self.layout)
        for name, value in changes.items():
            getattr(copy, name)[:] = value
        return copy


def layout_of(d: mujoco.MjData) -> Layout:
    """Where the fields of one environment lie in ``NativeData.numbers``."""
    layout, start = [], 0
    for name in (*MOTION, *POSES):
        field = getattr(d, name)
        layout.append((name, start, start + field.size, field.shape))
        start += field.size
    return tuple(layout)


class Watcher(Protocol):
    """What is told of every physics step, see ``sim.impulse``."""

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
    """

    traceable = False

    def __init__(self, scene: Scene, controller: Controller, frame_skip: int):
        self.scene, self.controller, self.frame_skip = scene, controller, frame_skip
        self.model = controller.model_of(_own_model(scene))
        self._data = mujoco.MjData(self.model)
        self._layout = layout_of(self._data)
        self._data.warning.number[:] = 1  # MuJoCo logs a first warning into the current folder
        self.watcher: Watcher | None = None
        self._lock = threading.Lock()  # of model and data, which every call overwrites
        self._written: list[Any] = []  # leaves of what the model holds of an episode

        def human_of(episode: Episode) -> tuple[dict[str, Array], Muscles]:
            pull = controller.muscles(episode.human)
            return model_fields(scene, scene.model, episode, pull), pull

        self._human_of = jax.jit(human_of)
        self._limit_torque = jax.jit(controller.limit_torque)

    def sized_for(self, num_envs: int) -> NativePhysics:
        """The same: its buffers grow."""
        return self

    def stage(self, function: Callable[..., Any]) -> Callable[..., Any]:
        """The function, compiled by itself."""
        return jax.jit(function)

    def make_data(self) -> NativeData:
        """Data of an environment in which nothing has begun."""
        return NativeData.of(mujoco.MjData(self.model), self._layout)

    def reset(self, data: NativeData, episode: Episode, where: Array | None = None) -> NativeData:
        """Everything at rest at the start of an episode."""
        if where is not None and not where:
            return data
        rest, index = dict.fromkeys(MOTION, 0.0), self.scene.index
        with self._lock:
            d = self._load(data.replace(**rest | {"qpos": self.model.qpos0}), episode)
            d.qpos[index.robot_qpos] = episode.placement.arm_angles
            d.qpos[index.human_qpos] = episode.human_angles
            mujoco.mj_kinematics(self.model, d)
            return NativeData.of(d, self._layout)

    def step(
        self, data: NativeData, episode: Episode, targets: ControlTargets
    ) -> tuple[NativeData, ContactSums, Motion]:
        """One control step. The ``qpos`` of an environment that goes non-finite are NaN."""
        index, sensors, samples = self.scene.index, [], []
        target, goal = np.asarray(targets.target), np.asarray(targets.goal)
        load = np.asarray(targets.load)
        with self._lock:
            d = self._load(data, episode)
            for _ in range(self.frame_skip):
                if not _is_sound(d):
                    break
                if self.watcher:
                    self.watcher.before(d, load)
                self._pull(d, target)
                aim = self.controller.aim(goal)
                drive = self.controller.motors.prepare(self.model, d, aim, besides=load)
                mujoco.mj_step(self.model, d)
                if self.watcher:
                    self.watcher.after(self.model, d)
                self.controller.motors.remember(d, drive)
                if self.controller.at_joints:
                    after = self.controller.after_step(self.model, d, d.M, np)
                    d.qpos[index.human_qpos], d.qvel[index.human_dof] = after
                sensors.append(d.sensordata.copy())
                samples.append(sample_poses(index, d, np))
            if not _is_sound(d):
                motion = motion_at_rest(index, data, self.frame_skip)
                # the guard against NaN sees it
                return data.replace(qpos=np.nan), no_contacts(index), motion
            if self.watcher:
                self.watcher.finish()
            mujoco.mj_kinematics(self.model, d)
            samples.append(sample_poses(index, d, np))
            motion = motion_of(index, jax.tree.map(lambda *x: np.stack(x), *samples), np)
            motion = jax.tree.map(lambda x: x.astype(np.float32), motion)
            sums = total_contacts(read_contacts(index, np.stack(sensors), np))
            return NativeData.of(d, self._layout), sums, motion

    def _pull(self, d: mujoco.MjData, target: np.ndarray) -> None:
        """Prepare the person's joints: muscles, ligaments and pose-dependent limits."""
        index, muscles = self.scene.index, self._muscles
        if not len(index.human_dof):
            return
        q, v = d.qpos[index.human_qpos].astype(np.float32), d.qvel[index.human_dof]
        load = d.qfrc_bias[index.human_dof].copy()
        besides = muscles.passive * load
        if not self.controller.within_limits(q):
            besides = besides + self._limit_torque(q, v)
        aim = Aim(target, muscles.rate, muscles.bound, muscles.damping)
        self.controller.human_motors.prepare(self.model, d, aim, load - besides, besides)

    def overflow(self, data: NativeData) -> Array:
        """Never: C MuJoCo's buffers grow ()."""
        return jnp.float32(0.0)

    def _load(self, data: NativeData, episode: Episode) -> mujoco.MjData:
        """Model and data hold this environment and nothing of the one before."""
        leaves = jax.tree.leaves((episode.human, episode.rows, episode.placement))
        same = len(leaves) == len(self._written)
        if not (same and all(a is b for a, b in zip(leaves, self._written, strict=True))):
            fields, muscles = jax.device_get(self._human_of(episode))
            rate, bound, damping = (float(x) for x in muscles[:3])
            self._muscles = Muscles(rate, bound, damping, muscles.passive)
            for name, value in fields.items():
                getattr(self.model, name)[:] = value
            self._written = leaves
        for name in MOTION:
            getattr(self._data, name)[:] = getattr(data, name)
        self._data.qfrc_applied[:] = 0.0
        return self._data


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


def _is_sound(d: mujoco.MjData) -> bool:
    """Whether C MuJoCo can go on from here: all numbers are finite, and fit into float32."""
    return all(np.abs(x).max() < mujoco.mjMAXVAL for x in (d.qpos, d.qvel))
