"""The motors and muscles of C MuJoCo's environments: one compiled program that runs before every physics step.

It is called ten times in a control step, so what it takes and gives lies in one array each.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from jax import Array

from agym_jax.human.muscles import Muscles
from agym_jax.sim.columns import Columns, Program
from agym_jax.sim.control import Controller, ControlTargets
from agym_jax.sim.motors import Aim, Drive

FORCES = ("qfrc_smooth", "qfrc_constraint", "qacc")
"""Fields that tell what the motors worked against."""
State = dict[str, np.ndarray]
"""Name of a field of ``MjData`` -> its rows (rows, ...)."""


@dataclass(frozen=True)
class Driven:
    """What the joints do in one physics step, one environment a row."""

    program: DriveProgram
    result: Columns  # of the program
    rows: np.ndarray  # the same (rows, 5 nv + 1)

    @property
    def sound(self) -> np.ndarray:
        """Where C MuJoCo can take the step: all numbers are finite, and fit into float32 (rows,)."""
        return self.rows[:, -1] > 0.0

    def write(self, state: State, applied: np.ndarray, solref: np.ndarray) -> None:
        """Into what MuJoCo is about to read."""
        nv = self.program.nv
        velocity, torque, guess = (self.rows[:, i * nv : (i + 1) * nv] for i in range(3))
        state["qvel"][:], applied[:] = velocity, torque
        state["qacc_warmstart"][:] = guess
        solref[:] = self.rows[:, 3 * nv : -1].reshape(solref.shape)


class DriveProgram:
    """Of all joints of one scene.

    Args:
        controller: of the joints.
        model: of the scene, with the solver's constants of joints that nothing drives.
    """

    def __init__(self, controller: Controller, model: mujoco.MjModel):
        self._controller, self.nv = controller, model.nv
        self._robot = controller.index.robot_dof
        sizes = [model.nq, model.nv, model.nC, model.nv, *3 * [model.nv], 1]
        self._ends = np.cumsum(sizes)
        self.inputs = int(self._ends[-1])
        self._solref = model.dof_solref.astype(np.float32)
        self._run = Program(self._rows, rows=True)
        self._nothing: dict[int, Driven] = {}

    def first(self, inputs: np.ndarray, given: list[np.ndarray]) -> Driven:
        """Prepare the first physics step of a control step.

        Args:
            inputs: of the program, which are written (rows, inputs).
            given: angles, velocities, inertia and load, as the last control step left them (n, ...).

        Returns:
            What stands for the physics step before.
        """
        n, end = len(given[0]), self._ends[3]
        inputs[:] = 0.0
        inputs[:n, :end] = np.concatenate(given, axis=1)
        inputs[:, -1] = 1.0
        return self.nothing(len(inputs))

    def nothing(self, count: int) -> Driven:
        """What stands for the physics step before the first one, of so many rows."""
        if count not in self._nothing:
            rows = np.zeros((count, 5 * self.nv + 1), np.float32)
            self._nothing[count] = Driven(self, Columns.of(rows, count).on_device(), rows)
        return self._nothing[count]

    def gather(self, inputs: np.ndarray, state: State, out: State) -> None:
        """Prepare the next physics step, after one has been taken."""
        names = ("M", "qfrc_bias", *FORCES)
        parts = [state["qpos"], state["qvel"], *(out[name] for name in names)]
        np.concatenate(parts, axis=1, out=inputs[:, :-1], casting="same_kind")
        inputs[:, -1] = 0.0

    def __call__(
        self, inputs: np.ndarray, last: Driven, targets: Columns, written: Columns
    ) -> Driven:
        """What the joints do next.

        Args:
            inputs: from ``first`` or ``gather`` (rows, inputs).
            last: what they did before.
            targets: ``ControlTargets``.
            written: from ``NativePhysics.written``.
        """
        result = self._run(inputs, last.result, targets, written)
        return Driven(self, result, np.asarray(result.array).view(np.float32))

    def bias(self, last: Driven, targets: ControlTargets, out: State) -> np.ndarray:
        """``qfrc_bias`` with, for the robot's joints, what their motors worked against [N m] (rows, nv)."""
        bias = out["qfrc_bias"].copy()
        forces = (out[name][:, self._robot] for name in FORCES)
        bias[:, self._robot] = self._load(last.rows, targets.load, targets.bound, forces, np)
        return bias

    def _load(self, rows: Any, besides: Any, bound: Any, forces: Iterable[Any], xp: Any) -> Any:
        """Torque against which the robot's motors worked in the last physics step [N m] (..., n_arm)."""
        nv, robot = self.nv, self._robot
        velocity, torque = rows[..., :nv][..., robot], rows[..., nv : 2 * nv][..., robot]
        solref = rows[..., 3 * nv : -1].reshape(*rows.shape[:-1], nv, 2)[..., robot, :]
        bound = self._controller.control.max_torque if bound is None else bound[..., None]
        drive = Drive(velocity, torque - besides, solref, None, bound)
        smooth, constraint, acceleration = forces
        return self._controller.motors.bias(drive, smooth, constraint, acceleration, xp)

    def _rows(self, inputs: Array, last: Array, targets: ControlTargets, written: Any) -> Array:
        """The program; all arguments have the leading axis of rows."""
        _, muscles = written
        controller, index = self._controller, self._controller.index
        parts = jnp.split(inputs, self._ends[:-1], axis=1)
        qpos, qvel, inertia, bias, smooth, constraint, acceleration, fresh = parts
        robot = self._robot
        forces = (x[:, robot] for x in (smooth, constraint, acceleration))
        load = jnp.where(
            fresh > 0, bias[:, robot], self._load(last, targets.load, targets.bound, forces, jnp)
        )
        sound = jnp.all(abs(jnp.concatenate([qpos, qvel], 1)) < mujoco.mjMAXVAL, 1)

        @jax.vmap
        def drive_robot(
            matrix: Array, load: Array, q: Array, v: Array, goal: Array, bound: Array | None
        ) -> Drive:
            motors = controller.motors
            aim = controller.aim(goal, bound)
            return motors.drive(motors.inertia(matrix), load, q, v, aim, rolled=True)

        @jax.vmap
        def drive_human(
            matrix: Array, load: Array, q: Array, v: Array, target: Array, muscles: Muscles
        ) -> Drive:
            motors = controller.human_motors
            aim = Aim(target, muscles.rate, muscles.bound, muscles.damping)
            return motors.drive(motors.inertia(matrix), load, q, v, aim, rolled=True)

        whole = [qvel, jnp.zeros_like(qvel), jnp.zeros_like(qvel)]
        solref = jnp.broadcast_to(self._solref, (len(qvel), *self._solref.shape))
        q, v = qpos[:, index.robot_qpos], qvel[:, robot]
        pull = drive_robot(inertia, load, q, v, targets.goal, targets.bound)
        drives = [(robot, pull, targets.load)]
        if len(index.human_dof):
            q, v = qpos[:, index.human_qpos], qvel[:, index.human_dof]
            load = bias[:, index.human_dof]
            besides = muscles.limited[:, None] * controller.limit_torques(q, v)
            load = (1.0 - muscles.passive) * load - besides  # the slot adds what bears it
            pull = drive_human(inertia, load, q, v, targets.target, muscles)
            drives.append((index.human_dof, pull, besides))
        for dofs, drive, besides in drives:
            values = (drive.velocity, besides + drive.torque, drive.guess)
            whole = [x.at[:, dofs].set(y) for x, y in zip(whole, values, strict=True)]
            solref = solref.at[:, dofs].set(drive.solref)
        flat = solref.reshape(len(solref), -1)
        return jnp.concatenate([*whole, flat, sound[:, None].astype(jnp.float32)], 1)


def afterwards(controller: Controller) -> Callable[[State, State, Array], tuple[Array, Array]]:
    """``Controller.after_step`` as a function of fields of model and data, of one environment."""

    def after(model: State, fields: State, at_joints: Array) -> tuple[Array, Array]:
        shapes = {"xaxis": (-1, 3), "xanchor": (-1, 3), "geom_xpos": (-1, 3), "geom_xmat": (-1, 9)}
        data = {name: x.reshape(shapes.get(name, x.shape)) for name, x in fields.items()}
        return controller.after_step(
            SimpleNamespace(**model), SimpleNamespace(**data), data["M"], at_joints
        )

    return after
