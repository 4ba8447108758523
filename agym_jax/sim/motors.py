"""The robot's motors: a velocity that they reach within one physics step, unless their torque is too small.

Assistive Gym's motor is Bullet's ``btMultiBodyJointMotor``: in every physics step a constraint on the joint
asks for the velocity ``rate * (target - angle)``, with an impulse of at most ``max_torque`` times the step, and
is solved together with the contacts. A joint that is not driven stands still until the bound is exceeded; a
heavy one accelerates under the whole bound until it is fast enough.

In MuJoCo that is the constraint of dry friction, ``frictionloss``: a force within a bound that opposes the
velocity. Its reference acceleration is ``-damper * velocity`` with a damper that may not be negative, so it
can brake a joint, turn it round or hold it, all to any velocity, but not speed it up. A joint that must
become faster therefore begins the physics step with another velocity, either the wanted one or almost none,
whichever is nearer, and a torque that gives back the momentum ``inertia @ (velocity - start)``. Then

    inertia @ (next - velocity) = step * (motor + contacts + limits + gravity and inertial torque),

with the motor's torque within its bound, as it should be: only the inertial torque and what contacts make of
the velocity at which they begin belong to the other velocity, and the inertia is that of the physics step before.

DEVIATION(motor): the law is AG's, solved to MuJoCo's accuracy. The constraint is soft, as if a rotor of 3 kg m2
per N m of bound turned at the wanted velocity: a joint under the whole bound creeps at 0.007 rad/s. While a joint speeds
up it has the inertial torque of the velocity at which its physics step begins here, and gets back the momentum by the inertia
of the step before: at most 0.3 N m in a control step (BedBathing: 0.8) and 15 % of a contact's force (BedBathing: 21 %; in a single physics step 37 %, of ScratchItch 26 %) are off. After 25 random
actions joints end within 0.03 rad of AG's; BedBathing's Sawyer within 0.046 (0.021 with both torques of the right velocity and
pose, which would cost two more passes over the bodies in every physics step).
MuJoCo steps 0.01 s where AG steps 0.002 to 0.004 s; Bullet's drag (4 % of a velocity in a second) is left out, and PR2 has the
URDF's inertias in ArmManipulation too, where AG has Bullet's.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import mujoco
import numpy as np


def _momenta(count: int) -> Iterator[float]:
    """Of Nesterov's accelerated gradient method: by how much more a sweep goes where the last one went."""
    step = 1.0
    for _ in range(count):
        following = (1.0 + math.sqrt(1.0 + 4.0 * step * step)) / 2.0
        yield (step - 1.0) / following
        step = following


ROTOR = 3.0
"""Stiffness of the constraint: the inertia of the rotor whose velocity it asks for, per N m of bound [kg m2]."""
NEARLY_STILL = 1e-4
"""A velocity that is none [rad/s]: what the damper turns round must have one."""
VANISHING = 1e-12
"""A velocity by which nothing can be divided [rad/s]: less than 1e-37 times the step is 0 in float32."""
MOMENTA = tuple(_momenta(16))
"""Of the sweeps that guess accelerations. More spare the solver little."""


class Aim(NamedTuple):
    """What motors are to do."""

    angles: Any  # to reach [rad]                                            (n,)
    rate: Any  # velocity asked for, per angle that is missing [1/s]         ()
    bound: Any  # of the torque [N m]; without any, a joint moves freely     ()
    damping: Any = None  # of the joints, if not that of the model [N m s/rad]  ()


class Drive(NamedTuple):
    """What the motors do in one physics step."""

    velocity: Any  # with which the joints begin [rad/s]                     (n,)
    torque: Any  # besides the constraint [N m]                              (n,)
    solref: Any  # of the constraint                                         (n, 2)
    guess: Any  # at the acceleration, for the solver to begin with [rad/s2]  (n,)
    bound: Any  # of the torque [N m]                                        (n,)


@dataclass(frozen=True, eq=False)  # has arrays in it: equal if identical
class InertiaBlock:
    """Where some joints' part of the inertia matrix is: MuJoCo keeps it sparse, MJX dense or sparse."""

    dofs: np.ndarray  # of the joints                                         (n,)
    entries: np.ndarray  # where it is in the sparse matrix                   (n, n)

    @classmethod
    def of(cls, model: mujoco.MjModel, dofs: np.ndarray) -> InertiaBlock:
        """Of the joints with these dofs."""
        entries = np.full((model.nv, model.nv), model.nC)  # one past the end is 0
        for row in range(model.nv):
            begin = model.M_rowadr[row]
            for at in range(begin, begin + model.M_rownnz[row]):  # lower triangle
                column = model.M_colind[at]
                entries[row, column] = entries[column, row] = at
        return cls(dofs, entries[np.ix_(dofs, dofs)])

    def read(self, matrix: Any, xp: Any = jnp) -> Any:
        """That part of a matrix of either form [kg m2] (n, n)."""
        if matrix.ndim == 2:
            return matrix[np.ix_(self.dofs, self.dofs)]
        return xp.concatenate([matrix, xp.zeros(1, matrix.dtype)])[self.entries]


@dataclass(frozen=True, eq=False)  # has arrays in it: equal if identical
class Motors:
    """The motors of one scene, in action order: pure functions of one environment."""

    time_step: float  # physics step [s]
    damping: np.ndarray  # of the joints themselves [N m s/rad]               (n,)
    impedance: np.ndarray  # of the constraints                               (n,)
    softness: np.ndarray  # of the constraints [1 / (kg m2)]                  (n,)
    mass: np.ndarray  # of the joints, one by one, in the rest pose [kg m2]   (n,)
    dofs: np.ndarray  # of the joints                                         (n,)
    qpos: np.ndarray  # addresses of their angles                             (n,)
    block: InertiaBlock  # the joints' part of the inertia

    @classmethod
    def of(cls, model: mujoco.MjModel, dofs: np.ndarray, time_step: float) -> Motors:
        """Of the joints with these dofs, in a model that ``add_motors`` and ``stiffen_motors`` have seen."""
        impedance = model.dof_solimp[dofs, 1]
        softness = (1.0 - impedance) / impedance * model.dof_invweight0[dofs]
        return cls(
            time_step=time_step,
            damping=model.dof_damping[dofs].astype(np.float32),
            impedance=impedance.astype(np.float32),
            softness=softness.astype(np.float32),
            mass=model.dof_M0[dofs].astype(np.float32),
            dofs=dofs,
            qpos=model.jnt_qposadr[model.dof_jntid[dofs]],
            block=InertiaBlock.of(model, dofs),
        )

    def inertia(self, matrix: Any, xp: Any = jnp) -> Any:
        """The joints' part of the inertia matrix, however the physics keeps it [kg m2] (n, n)."""
        return self.block.read(matrix, xp)

    def drive(
        self, inertia: Any, bias: Any, q: Any, v: Any, aim: Aim, xp: Any = jnp, rolled: bool = False
    ) -> Drive:
        """What to do in the next physics step.

        Args:
            inertia: of the joints [kg m2] (n, n).
            bias: what ``bias`` returned after the last physics step [N m] (n,).
            q: their angles [rad] (n,).
            v: their velocities [rad/s] (n,).
            aim: what the motors are to do.
            xp: numpy or jax.numpy.
            rolled: see ``guess``.
        """
        wanted = xp.where(aim.bound > 0.0, aim.rate * (aim.angles - q), v)
        way = xp.sign(wanted)
        too_slow = (v * way > -NEARLY_STILL) & (abs(v) < abs(wanted))
        near = xp.where(2 * abs(v) < abs(wanted), -NEARLY_STILL * way, wanted)
        start = xp.where(too_slow, near, v)
        still = abs(start) < VANISHING
        damper = (start - wanted) / (self.time_step * xp.where(still, 1.0, start))
        damper = xp.where(still, 0.0, damper)
        damping = self.damping if aim.damping is None else aim.damping
        torque = inertia @ (v - start) / self.time_step - damping * (v - start)
        alone = torque - damping * start - bias
        guess = self.guess(inertia, alone, -damper * start, aim.bound, xp, rolled)
        solref = xp.stack([0.0 * damper, -damper * self.impedance], -1)
        return Drive(start, torque, solref, guess, aim.bound)

    def guess(
        self,
        inertia: Any,
        torque: Any,
        wanted: Any,
        bounds: Any,
        xp: Any = jnp,
        rolled: bool = False,
    ) -> Any:
        """Accelerations of the joints if nothing but the motors changes [rad/s2] (n,).

        The acceleration of the last physics step tells nothing of this one's, which begins at another velocity: from
        there Newton's method takes 3.3 iterations (BedBathingSawyer, random actions), from here 2.1; three sweeps of
        Gauss-Seidel leave 2.4, but joint after joint they take XLA ten times as long to compile. Here
        ``inertia @ acceleration = torque + motors`` is solved by accelerated gradient steps for all joints at
        once, scaled by sums of rows, each joint with its motor: exact for one joint that moves alone.

        Args:
            inertia: of the joints [kg m2] (n, n); zeros before the first physics step.
            torque: without that of the motors [N m] (n,).
            wanted: acceleration that the motors ask for [rad/s2] (n,).
            bounds: of the motors' torques [N m] () or (n,).
            xp: numpy or jax.numpy.
            rolled: whether the sweeps are compiled as a loop, which takes XLA a fraction of the time; GPUs run a loop slowly.
        """
        inertia = xp.where(xp.any(inertia != 0.0), inertia, np.diag(self.mass))
        mobility = 1.0 / xp.sum(abs(inertia), axis=-1)
        stiffness = 1.0 / (self.softness + mobility)

        def sweep(last: tuple[Any, Any], onward: Any) -> tuple[tuple[Any, Any], None]:
            before, guess = last
            ahead = guess + onward * (guess - before)
            free = ahead - mobility * (inertia @ ahead - torque)
            motor = xp.clip(stiffness * (wanted - free), -bounds, bounds)
            return (guess, free + mobility * motor), None

        last = wanted, wanted
        if rolled:
            last, _ = jax.lax.scan(sweep, last, np.array(MOMENTA, np.float32))
        else:
            for onward in MOMENTA:
                last, _ = sweep(last, onward)
        return last[1]

    def bias(
        self, drive: Drive, smooth: Any, constraint: Any, acceleration: Any, xp: Any = jnp
    ) -> Any:
        """Torque against which the motors worked: gravity, inertia, contacts and limits [N m] (n,).

        Args:
            drive: of the physics step that has been taken.
            smooth: all torques but those of constraints, ``qfrc_smooth`` [N m] (n,).
            constraint: those of constraints, ``qfrc_constraint`` [N m] (n,).
            acceleration: of the joints, ``qacc`` [rad/s2] (n,).
            xp: numpy or jax.numpy.
        """
        wanted = drive.solref[..., 1] / self.impedance * drive.velocity
        motor = xp.clip((wanted - acceleration) / self.softness, -drive.bound, drive.bound)
        return motor - constraint - (smooth - drive.torque + self.damping * drive.velocity)

    def prepare(
        self,
        model: mujoco.MjModel,
        data: mujoco.MjData,
        aim: Aim,
        load: Any = None,
        besides: Any = 0.0,
    ) -> Drive:
        """Drive the joints in the next ``mj_step`` of C MuJoCo: writes into both model and data.

        Args:
            model: of the scene.
            data: of the scene; its inertia matrix is that of the last physics step.
            aim: what the motors are to do.
            load: what they work against, if not what ``remember`` kept [N m] (n,).
            besides: torque on the joints that is no motor's [N m] (n,).
        """
        at, dofs = self.qpos, self.dofs
        load = data.qfrc_bias[dofs] if load is None else load
        drive = self.drive(self.inertia(data.M, np), load, data.qpos[at], data.qvel[dofs], aim, np)
        data.qvel[dofs], data.qfrc_applied[dofs] = drive.velocity, besides + drive.torque
        data.qacc_warmstart[dofs] = drive.guess
        model.dof_solref[dofs] = drive.solref
        return drive

    def remember(self, data: mujoco.MjData, drive: Drive) -> None:
        """Keep what ``prepare`` of the next physics step guesses from, when C MuJoCo has taken this one."""
        dofs = self.dofs
        smooth, constraint = data.qfrc_smooth[dofs], data.qfrc_constraint[dofs]
        data.qfrc_bias[dofs] = self.bias(drive, smooth, constraint, data.qacc[dofs], np)


def add_motors(spec: mujoco.MjSpec, joints: list[str], max_torque: float, time_step: float) -> None:
    """Put motors into joints, and make the joints' own damping implicit, see ``implicit_armature``."""
    for name in joints:
        joint = spec.joint(name)
        joint.frictionloss = max_torque
        joint.armature += implicit_armature(joint.damping[0], time_step)


def implicit_armature(damping: Any, time_step: float) -> Any:
    """What an armature must be for Euler's integration to be implicit in a joint's damping [kg m2].

    ``(inertia + step * damping) * acceleration = torque - damping * velocity`` is MuJoCo's implicit
    integration, but the solver of that integrator computes contacts as if joints were not damped; they would
    act with a fraction of their effect, and become as many times larger. With an armature it knows.

    Args:
        damping: of the joint [N m s/rad].
        time_step: physics step [s].
    """
    return damping * time_step


def stiffen_motors(model: mujoco.MjModel) -> None:
    """Give every motor's constraint the stiffness of ``ROTOR``, as far as MuJoCo allows."""
    bounds = model.dof_frictionloss[:, None]
    relative = ROTOR * bounds * model.dof_invweight0[:, None]
    model.dof_solimp[:, :2] = np.where(
        bounds > 0.0,
        np.minimum(relative / (1.0 + relative), mujoco.mjMAXIMP),
        model.dof_solimp[:, :2],
    )
