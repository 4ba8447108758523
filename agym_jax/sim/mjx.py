"""Physics on MJX, in JAX (anywhere) or Warp (NVIDIA GPUs): pure, for any number of environments at once."""

from __future__ import annotations

import copy
import warnings
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from jax import Array

from agym_jax.compat import lapack_batches, mjx_quat, mjx_trace
from agym_jax.compat.mjx_print import mjx
from agym_jax.compat.warp_kernels import compile_kernels, wait_for_kernels
from agym_jax.compat.warp_newton import rebuild_hessians
from agym_jax.compat.warp_streams import hold_streams
from agym_jax.math3d import rotation_matrix
from agym_jax.sense import Motion
from agym_jax.sim.control import Controller, ControlTargets
from agym_jax.sim.episode import model_fields, start_qpos
from agym_jax.sim.motors import Aim, Drive
from agym_jax.sim.scene import Scene
from agym_jax.sim.sensing import (
    ContactSums,
    PoseSample,
    add_contacts,
    motion_of,
    no_contacts,
    sample_poses,
)
from agym_jax.state import Episode, strong

lapack_batches.apply()
mjx_quat.apply()
mjx_trace.apply()

JAX_ITERATIONS, JAX_LS_ITERATIONS = 20, 12
"""Most Newton iterations and line-search steps in JAX, which stops when it has converged. With 8 iterations a wiper that
meets the arm can press with 24 N where C MuJoCo has 2.6 N; with 20 they agree within 0.001 N, as fast.
``tests/sim/test_parity.py`` compares a pressing rollout with C MuJoCo; ``python -m benchmarks.nan`` looks for NaN."""
LEAST_BOUND = 1e-6
"""Smallest bound of a motor in JAX [N m]. With 0, a limp joint would be held: if dry friction was not 0 when the model was made and
is now, MJX 3.17 takes it for an equality. C MuJoCo and Warp leave such rows out."""
WARP_CONTACTS_PER_ENV = 40
WARP_ROWS_PER_ENV = 128
"""Rows of constraints of an environment, see ``warp_rows``."""
WARP_ITERATIONS, WARP_LS_ITERATIONS = 20, 20
"""Warp stops when it has converged, so generous limits cost nothing."""
WARP_LOST = 0b1001111
"""Bits of Warp's overflow flags that mean lost contacts or rows: NEFC, NJMAX_NNZ, BROADPHASE,
NARROWPHASE, CONTACT_MATCH (not: iteration limits). MuJoCo Warp 3.17, types.OverflowType."""
AT_REST = ("qvel", "qacc_warmstart", "qfrc_applied", "qfrc_bias")
"""Fields of ``mjx.Data`` that are 0 as an episode begins."""
CONTINUES = ("qpos", *AT_REST)
"""Fields from which, with the joint-space inertia, an episode goes on."""


class MjxPhysics:
    """See ``physics.Physics``.

    Args:
        impl: ``"jax"`` or ``"warp"``.
        scene: what is in the world.
        controller: of its joints.
        frame_skip: physics steps of a control step.
        num_envs: how many are stepped together; sizes Warp's buffers.
    """

    traceable = True

    def __init__(
        self, impl: str, scene: Scene, controller: Controller, frame_skip: int, num_envs: int
    ):
        self.impl, self.scene, self.controller = impl, scene, controller
        self.frame_skip, self.num_envs = frame_skip, num_envs
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # MJX's notes on its own experimental features
            self.model = put_model(controller.model_of(scene.model), impl)
        self._static = np.flatnonzero(scene.model.body_weldid[scene.model.geom_bodyid] == 0)

    def sized_for(self, num_envs: int) -> MjxPhysics:
        """The same physics with Warp's buffers for so many environments at once."""
        sized = copy.copy(self)
        sized.num_envs = num_envs
        return sized

    def make_data(self) -> mjx.Data:
        """Data of an environment in which nothing has begun."""
        return mjx.make_data(
            self.scene.model,
            impl=self.impl,
            naconmax=WARP_CONTACTS_PER_ENV * self.num_envs,
            njmax=warp_rows(self.scene.model),
        )

    def reset(self, data: mjx.Data, episode: Episode, where: Array | None = None) -> mjx.Data:
        """Everything at rest at the start of an episode. Warp's data must not be selected whole."""
        wait_for_kernels()
        fresh = {name: jnp.zeros_like(getattr(data, name)) for name in AT_REST}
        fresh["qpos"] = start_qpos(self.scene, episode)
        fresh["M"] = jnp.zeros_like(data._impl.M)  # nothing moves that has any
        return self.load(data, fresh, episode, where)

    def save(self, data: mjx.Data) -> dict[str, Array]:
        """What ``load`` needs to continue from here, of one environment."""
        return {name: getattr(data, name) for name in CONTINUES} | {"M": data._impl.M}

    def load(
        self, data: mjx.Data, saved: dict[str, Array], episode: Episode, where: Array | None = None
    ) -> mjx.Data:
        """Continue from what ``save`` returned. Warp's data must not be selected whole.

        Args:
            data: of the environment.
            saved: from ``save``.
            episode: that of ``saved`` where ``where`` holds, otherwise the environment's own.
            where: as for ``reset``.
        """
        if where is not None:
            old = self.save(data)
            saved = {name: jnp.where(where, new, old[name]) for name, new in saved.items()}
        fields = {name: saved[name] for name in CONTINUES}
        data = data.replace(**fields, _impl=data._impl.replace(M=saved["M"]))
        model = self.model_of(episode)
        data = mjx.kinematics(model, data)
        return strong(
            place_static_geoms(self._static, model, data) if self.impl == "warp" else data
        )

    def step(
        self, data: mjx.Data, episode: Episode, targets: ControlTargets
    ) -> tuple[mjx.Data, ContactSums, Motion]:
        """One control step."""
        wait_for_kernels()
        index, model = self.scene.index, self.model_of(episode)
        muscles = self.controller.muscles(episode.human)
        motors, human = self.controller.motors, self.controller.human_motors
        aim = self.controller.aim(targets.goal, targets.bound)
        pulls = Aim(targets.target, muscles.rate, muscles.bound, muscles.damping)

        def substep(carry: tuple[mjx.Data, ContactSums], _: None) -> tuple[tuple, PoseSample]:
            data, contacts = carry
            inertia, solref = data._impl.M, model.dof_solref
            q, v = data.qpos[index.robot_qpos], data.qvel[index.robot_dof]
            load = data.qfrc_bias[index.robot_dof]
            drive = motors.drive(motors.inertia(inertia), load, q, v, aim)
            data, solref = _write(data, solref, index.robot_dof, drive, targets.load)
            if len(index.human_dof):
                q, v = data.qpos[index.human_qpos], data.qvel[index.human_dof]
                load = data.qfrc_bias[index.human_dof]
                besides = self.controller.support(muscles.passive, model, data)
                besides += muscles.limited * self.controller.limit_torque(q, v)
                pull = human.drive(human.inertia(inertia), load - besides, q, v, pulls)
                data, solref = _write(data, solref, index.human_dof, pull, besides)
            data = mjx.step(model.replace(dof_solref=solref), data)
            forces = (data.qfrc_smooth, data.qfrc_constraint, data.qacc)
            bias = motors.bias(drive, *(x[index.robot_dof] for x in forces))
            data = data.replace(qfrc_bias=data.qfrc_bias.at[index.robot_dof].set(bias))
            if self.controller.at_joints:
                human_q, human_v = index.human_qpos, index.human_dof
                at_joints = episode.human.at_joints
                q, v = self.controller.after_step(model, data, data._impl.M, at_joints)
                data = data.replace(
                    qpos=data.qpos.at[human_q].set(q), qvel=data.qvel.at[human_v].set(v)
                )
            # what a step leaves behind is where things were as it began
            contacts = add_contacts(index, contacts, data.sensordata)
            return (data, contacts), sample_poses(index, data)

        start = (data, no_contacts(index))
        (data, contacts), poses = jax.lax.scan(substep, start, length=self.frame_skip)
        data = mjx.kinematics(model, data)
        append = lambda a, b: jnp.concatenate([a, b[None]])  # noqa: E731
        poses = jax.tree.map(append, poses, sample_poses(index, data))
        return strong(data), contacts, motion_of(index, poses)

    def overflow(self, data: mjx.Data) -> Array:
        """1.0 where Warp's buffers lost a contact or a constraint row ()."""
        if self.impl != "warp":
            return jnp.float32(0.0)
        return ((data._impl.overflow & WARP_LOST) != 0).any().astype(jnp.float32)

    def model_of(self, episode: Episode) -> mjx.Model:
        """The model with this episode's person and robot base in it."""
        muscles = self.controller.muscles(episode.human)
        fields = model_fields(self.scene, self.model, episode, muscles)
        fields |= self.controller.contact_fields(self.model, episode.human)
        if self.impl == "jax":
            bounds = fields["dof_frictionloss"]
            fields["dof_frictionloss"] = jnp.maximum(bounds, LEAST_BOUND)
        return self.model.tree_replace(fields)


def _write(
    data: mjx.Data, solref: Array, dofs: np.ndarray, drive: Drive, besides: Array | float = 0.0
) -> tuple[mjx.Data, Array]:
    """Data and ``dof_solref`` in which motors drive these joints in the next physics step.

    Args:
        data: of the environment.
        solref: of all joints (nv, 2).
        dofs: of the joints that are driven.
        drive: what their motors do.
        besides: torque on them that is no motor's [N m] (n,).
    """
    data = data.replace(
        qfrc_applied=data.qfrc_applied.at[dofs].set(besides + drive.torque),
        qvel=data.qvel.at[dofs].set(drive.velocity),
        qacc_warmstart=data.qacc_warmstart.at[dofs].set(drive.guess),
    )
    return data, solref.at[dofs].set(drive.solref)


def warp_rows(model: mujoco.MjModel) -> int:
    """Rows of constraints that Warp keeps of each environment.

    A contact with rolling friction (the bed's) has 10 rows, others have 4. With 128 rows, trainings of ArmManipulationJaco and
    SawyerHuman stopped because contacts were lost in 14 and 4 environment steps.
    """
    return WARP_ROWS_PER_ENV * (2 if 6 in model.pair_dim else 1)


def put_model(model: mujoco.MjModel, impl: str) -> Any:
    """A MuJoCo model on the device, with the solver limits of the implementation."""
    model = copy.copy(model)
    if impl != "warp":
        model.opt.iterations, model.opt.ls_iterations = JAX_ITERATIONS, JAX_LS_ITERATIONS
        return mjx.put_model(model, impl=impl)
    model.opt.iterations, model.opt.ls_iterations = WARP_ITERATIONS, WARP_LS_ITERATIONS
    hold_streams()
    rebuild_hessians()
    from agym_jax.compat import warp_sensors  # imports Warp

    options = {"warn_overflow": WARP_LOST}  # no print for iteration limits
    options |= warp_sensors.options(model)
    compile_kernels(model, warp_rows(model), WARP_CONTACTS_PER_ENV, options)
    put = mjx.put_model(model, impl=impl)
    return put.replace(opt=put.opt.replace(_impl=put.opt._impl.replace(**options)))


def place_static_geoms(static: np.ndarray, model: mjx.Model, data: mjx.Data) -> mjx.Data:
    """Put geoms that no joint moves where this environment's bodies are.

    MuJoCo Warp computes them once, in ``make_data``, from the shared model (``_geom_local_to_global``
    in its ``smooth.py``), although ``body_pos``, ``body_quat`` and ``geom_pos`` differ from world to
    world here. Call it once an episode, after ``mjx.kinematics``.

    Args:
        static: geoms on bodies that are welded to the world (n,).
        model: with this environment's fields.
        data: of one environment, ``xpos`` and ``xmat`` up to date.
    """
    bodies = np.asarray(model.geom_bodyid)[static]
    turn = data.xmat[bodies].reshape(-1, 3, 3)
    pos = data.xpos[bodies] + jnp.einsum("nij,nj->ni", turn, model.geom_pos[static])
    mat = turn @ rotation_matrix(model.geom_quat[static])
    xmat = data.geom_xmat.at[static].set(mat.reshape(-1, *data.geom_xmat.shape[1:]))
    return data.replace(geom_xpos=data.geom_xpos.at[static].set(pos), geom_xmat=xmat)
