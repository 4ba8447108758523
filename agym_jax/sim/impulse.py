"""Are contact forces such as motors, momentum and joint limits can give? An impulse balance of any rollout.

What a robot presses with must come from somewhere: over a control step (or one physics step) the generalised impulses on its joints add up
to the change of momentum, ``sum of inertia @ (next - velocity) = step * sum of (motors + contacts + limits + inertial)``.
``watch`` keeps this account while C MuJoCo steps, from velocities and the inertia matrix alone on the left, and
what the solver reports on the right. Torque that nobody has, such as that of a servo that knows no bound, is
missing in it, and with it there are forces beyond what motors at their bound give.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

import mujoco
import numpy as np

from agym_jax.errors import ImplementationError
from agym_jax.sim.c_mujoco import NativePhysics
from agym_jax.sim.motors import Motors
from agym_jax.sim.physics import Physics

ARM = 0.02  # shortest lever from which a force is computed [m]
KINDS = {
    "motors": (mujoco.mjtConstraint.mjCNSTR_FRICTION_DOF,),
    "limits": (mujoco.mjtConstraint.mjCNSTR_LIMIT_JOINT,),
    "contacts": (
        mujoco.mjtConstraint.mjCNSTR_CONTACT_FRICTIONLESS,
        mujoco.mjtConstraint.mjCNSTR_CONTACT_PYRAMIDAL,
    ),
}


@dataclass(frozen=True)
class Balance:
    """Impulses on the robot's joints in one step, divided by its length."""

    momentum: np.ndarray  # change of it [N m]                               (n,)
    motors: np.ndarray  # [N m]                                              (n,)
    limits: np.ndarray  # [N m]                                              (n,)
    contacts: np.ndarray  # [N m]                                            (n,)
    inertial: np.ndarray  # and gravity, its compensation, joint damping, a tool's load [N m]  (n,)
    force: float  # sum of normal forces on robot and tool, mean [N]
    bound: float  # of a motor [N m]

    @property
    def error(self) -> float:
        """What is missing in the balance, at most [N m]."""
        given = self.motors + self.limits + self.contacts + self.inertial
        return float(np.abs(self.momentum - given).max())

    @property
    def possible(self) -> float:
        """Largest mean force of contacts like these that motors, momentum and limits give [N].

        A joint on which contacts turn with a lever of ``ARM`` or more has to be held by its motor's bound and
        what else acts on it; infinite if there is none (contacts that press on one link from two sides, say).
        """
        if self.force == 0.0:
            return np.inf
        rest = np.abs(self.momentum - self.limits - self.inertial) + self.bound
        lever = np.abs(self.contacts) / self.force
        return float(np.min(rest[lever >= ARM] / lever[lever >= ARM], initial=np.inf))


@dataclass
class Account:
    """What ``watch`` keeps."""

    motors: Motors
    bound: float  # of a motor [N m]
    each_physics_step: bool = False
    steps: list[Balance] = field(default_factory=list)

    def __post_init__(self) -> None:
        self._clear()

    def _clear(self) -> None:
        self._sums: dict[str, Any] = dict.fromkeys(("momentum", "inertial", *KINDS), 0.0)
        self._force, self._time = 0.0, 0.0

    def before(self, data: mujoco.MjData, load: np.ndarray) -> None:
        """A physics step is about to begin; nothing has been prepared for it yet."""
        self._velocity, self._load = data.qvel[self.motors.dofs].copy(), load

    def after(self, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        """It has been taken."""
        dofs, step, sums = self.motors.dofs, model.opt.timestep, self._sums
        velocity = data.qvel[dofs]
        # the armature stands for damping by the velocity after the step
        inertia = self.motors.inertia(data.M, np) - np.diag(model.dof_armature[dofs])
        sums["momentum"] += inertia @ (velocity - self._velocity)
        outer = data.qfrc_gravcomp[dofs] - data.qfrc_bias[dofs]
        sums["inertial"] += step * (outer + self._load - self.motors.damping * velocity)
        torque = np.zeros(model.nv)
        for kind, types in KINDS.items():
            rows = np.where(np.isin(data.efc_type, types), data.efc_force, 0.0)
            if data.nefc:
                mujoco.mj_mulJacTVec(model, data, torque, rows)
            sums[kind] += step * torque[dofs]
        self._force += step * self._normal_force(model, data)
        self._time += step
        if self.each_physics_step:
            self._close()

    def finish(self) -> None:
        """A control step is over."""
        if not self.each_physics_step:
            self._close()

    def _close(self) -> None:
        mean = {k: np.asarray(x) / self._time for k, x in self._sums.items()}
        self.steps.append(Balance(**mean, force=self._force / self._time, bound=self.bound))
        self._clear()

    def _normal_force(self, model: mujoco.MjModel, data: mujoco.MjData) -> float:
        """Sum over the contacts of robot and tool with anything else [N]."""
        mine = np.isin(model.body_treeid[model.geom_bodyid], model.dof_treeid[self.motors.dofs])
        force, total = np.zeros(6), 0.0
        for i in range(data.ncon):
            if mine[data.contact.geom[i]].any():
                mujoco.mj_contactForce(model, data, i, force)
                total += force[0]
        return total


@contextmanager
def watch(physics: Physics, each_physics_step: bool = False) -> Iterator[Account]:
    """Keep account of every step that this physics takes meanwhile.

    Args:
        physics: of an environment with ``impl="native"``.
        each_physics_step: a balance of each physics step instead of each control step, as peaks of forces last one.

    Yields:
        the account; its ``steps`` grow.

    Raises:
        ImplementationError: the physics is MJX.
    """
    if not isinstance(physics, NativePhysics):
        raise ImplementationError(
            "Impulses are recorded with C MuJoCo only: build the environment with impl='native'."
        )
    motors = physics.controller.motors
    account = Account(
        motors, float(physics.model.dof_frictionloss[motors.dofs].max()), each_physics_step
    )
    physics.watcher = account
    try:
        yield account
    finally:
        physics.watcher = None
