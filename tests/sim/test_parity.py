# ruff: noqa: D103
"""MJX against C MuJoCo: the person's model, kinematics, and a robot that presses on an arm.

C MuJoCo gets a scene compiled for each person from scratch, so these tests also judge the fields
that the environment writes into one shared model.
"""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from compiled import BATCH, CompiledBatch, Rollout, compiled_human

from agym_jax.human.body import RIGHT_ARM_LINKS
from agym_jax.human.population import Population, sample_human
from agym_jax.human.pose import sample_pose
from agym_jax.math3d import rotation_matrix
from agym_jax.offline import kinematics
from agym_jax.sim.episode import human_rows
from agym_jax.sim.motors import Aim
from agym_jax.sim.sensing import add_contacts, motion_at_rest, no_contacts, sense
from agym_jax.state import Episode, Placement

pytestmark = pytest.mark.parity
APPROACH, PRESS = 12, 16  # control steps
WATCHED = (0, 2, 4, 7)  # environments that C MuJoCo follows

# Float32 against float64 over one control step from the same state, in contact. Measured maxima of
# 64 such steps: 1e-6 rad, 3e-5 rad/s and 5e-5 N at up to 2 N; ten times that is allowed.
QPOS, QVEL, FORCE = 1e-5, 3e-4, 5e-4  # [rad], [rad/s], [N] or share of the force


def one(tree: Any, i: int) -> Any:
    """One environment of a batch."""
    return jax.tree.map(lambda x: x[i], tree)


# -- the model of one person --------------------------------------------------------------------

FIELDS = (
    "body_pos", "body_quat", "body_mass", "body_ipos", "body_iquat", "body_inertia", "geom_size",
    "geom_pos", "geom_quat", "geom_rbound", "jnt_pos", "jnt_axis", "jnt_range", "site_pos", "site_quat",
    "dof_armature",
)  # fmt: skip


@pytest.fixture(scope="module")
def crowd(static_env) -> Episode:
    """Five people of all sizes and impairments, each with a robot base of its own."""
    env, n = static_env, 5
    rng = np.random.default_rng(0)
    spec = env.task.human
    human = jax.vmap(
        lambda k: sample_human(
            k, Population(sizes="continuous"), len(spec.joints), 0.2, spec.impairments
        )
    )(jax.random.split(jax.random.PRNGKey(4), n))
    quat = rng.normal(size=(n, 4))
    placement = Placement(
        jnp.asarray(rng.normal(size=(n, 3)), jnp.float32),
        jnp.asarray(quat / np.linalg.norm(quat, axis=-1, keepdims=True), jnp.float32),
        jnp.zeros((n, len(env.scene.index.robot_joint))),
    )
    zero = jnp.zeros((n, len(spec.joints)))
    pose = jax.vmap(sample_pose, (0, None, 0))(
        jax.random.split(jax.random.PRNGKey(5), n), spec, human
    )
    rows = jax.vmap(lambda p, how: human_rows(env.scene, spec, p, how))(human, pose)
    return Episode(human, pose, rows, placement, zero, zero, jnp.zeros(n, jnp.int32))


def test_fields_written_per_person_are_those_of_a_fresh_compilation(static_env, crowd: Episode):
    for i in range(5):
        episode = one(crowd, i)
        mine = static_env.physics.model_of(episode)
        theirs = compiled_human(static_env, episode)
        for name in FIELDS:
            a, b = np.asarray(getattr(mine, name)), getattr(theirs, name)
            if name.endswith("quat"):
                a = a * np.where(np.sum(a * b, -1, keepdims=True) < 0, -1, 1)
            if name == "dof_armature":  # that of the muscles' damping belongs to the episode
                a, b = a[static_env.scene.index.robot_dof], b[static_env.scene.index.robot_dof]
            np.testing.assert_allclose(a, b, atol=1e-5, err_msg=f"{name}, person {i}")
        # interpolated between man and woman: right to a share for those between and beyond
        inertia = np.asarray(mine.dof_invweight0) / theirs.dof_invweight0
        assert inertia.min() > 0.5 and inertia.max() < 2.0


@pytest.mark.jit
def test_kinematics_of_different_people_are_c_mujocos(batch: CompiledBatch, rollout: Rollout):
    state = rollout.last
    assert 0 < np.sum(np.asarray(state.episode.human.sex)) < BATCH
    for i in range(BATCH):
        model = compiled_human(batch.env, one(state.episode, i))
        c = mujoco.MjData(model)
        c.qpos[:] = np.asarray(state.data.qpos[i])
        mujoco.mj_kinematics(model, c)
        for name in (
            "xpos",
            "xmat",
            "xipos",
            "geom_xpos",
            "geom_xmat",
            "site_xpos",
            "xanchor",
            "xaxis",
        ):
            a, b = np.asarray(getattr(state.data, name)[i]), getattr(c, name)
            np.testing.assert_allclose(
                a.reshape(b.shape), b, atol=1e-5, err_msg=f"{name}, person {i}"
            )


# -- pressing on an arm -------------------------------------------------------------------------


def press_goals(batch: CompiledBatch, state: Any) -> np.ndarray:
    """Joint angles that put the tip of the tool 4 cm behind the limb's axis (B, n_arm)."""
    env, index = batch.env, batch.env.scene.index
    model = env.scene.model
    tip_site = index.tools[0].tip
    chain = kinematics.chain_of(model, index.robot_joint, tip_site, index.robot_base)
    bodies = dict(zip(index.links, index.human_body, strict=True))
    shoulder, elbow, hand = (np.asarray(state.data.xpos[:, bodies[x]]) for x in RIGHT_ARM_LINKS)
    tip = np.asarray(state.data.site_xpos[:, tip_site])
    on_forearm = (np.arange(BATCH) % 2 == 0)[:, None]
    point = np.where(on_forearm, 0.5 * elbow + 0.5 * hand, 0.6 * elbow + 0.4 * shoulder)
    away = point - tip
    point = point + 0.04 * away / np.linalg.norm(away, axis=-1, keepdims=True)
    goals = (point - model.body_pos[index.robot_base]) @ rotation_matrix(
        model.body_quat[index.robot_base], np
    )

    def solve(q: jax.Array, goal: jax.Array) -> tuple:
        _, rot, _ = kinematics.forward(chain, q)
        return kinematics.inverse(chain, q, goal, rot)

    angles, distance, _ = jax.jit(jax.vmap(solve))(
        state.episode.placement.arm_angles, jnp.asarray(goals, jnp.float32)
    )
    assert np.max(distance) < 1e-3
    return np.asarray(angles)


class _Shadow:
    """One environment in C MuJoCo, set to MJX's state before every control step."""

    def __init__(self, env: Any, episode: Episode):
        self.env, self.index = env, env.scene.index
        self.model = compiled_human(env, episode)
        mine = env.physics.model_of(episode)
        # the muscles' damping belongs to the episode; invweights are interpolated on purpose
        for name in (
            "dof_damping", "dof_armature", "dof_frictionloss", "dof_solimp",
            "body_invweight0", "dof_invweight0",
        ):  # fmt: skip
            getattr(self.model, name)[:] = np.asarray(getattr(mine, name))
        self.data = mujoco.MjData(self.model)
        self.muscles = jax.device_get(env.controller.muscles(episode.human))
        self.limit_torque = jax.jit(env.controller.limit_torque)

    def step(self, before: Any, action: np.ndarray) -> Any:
        """Five physics steps from MJX's state; returns the touch sums."""
        controller = self.env.controller
        d, index, motors = self.data, self.index, controller.motors
        for name in ("qpos", "qvel", "qacc_warmstart", "qfrc_bias"):
            getattr(d, name)[:] = np.asarray(getattr(before.data, name))
        goal = np.asarray(controller.targets(before.episode, before.data, action).goal)
        for each in (motors, controller.human_motors):
            d.M[each.block.entries] = np.asarray(each.inertia(before.data._impl.M))
        held = jnp.asarray(before.data.qpos)[index.human_qpos]
        target, _ = self.env.controller.human_target(before.episode, held, jnp.zeros(0))
        touch, contacts = no_contacts(index), 0
        mujoco.mj_kinematics(self.model, d)
        for _ in range(self.env.task.control.frame_skip):
            q, v = d.qpos[index.human_qpos], d.qvel[index.human_dof]
            load, m = d.qfrc_bias[index.human_dof].copy(), self.muscles
            besides = controller.support(m.passive, self.model, d, np) + np.asarray(
                self.limit_torque(*(jnp.asarray(x, jnp.float32) for x in (q, v)))
            )
            aim = Aim(np.asarray(target), m.rate, m.bound, m.damping)
            controller.human_motors.prepare(self.model, d, aim, load - besides, besides)
            motors.prepare(self.model, d, controller.aim(goal))
            mujoco.mj_step(self.model, d)
            touch = add_contacts(index, touch, jnp.asarray(d.sensordata, jnp.float32))
            contacts = max(contacts, d.ncon)
        mujoco.mj_kinematics(self.model, d)
        return touch, contacts


@pytest.mark.slow
@pytest.mark.jit
def test_pressing_on_an_arm_is_c_mujocos(batch: CompiledBatch):
    env, index = batch.env, batch.env.scene.index
    state = batch.reset(jax.random.PRNGKey(0))
    goals = press_goals(batch, state)
    scale = env.task.control.action_scale
    shadows = {i: _Shadow(env.env, one(state.episode, i)) for i in WATCHED}
    worst = {"qpos": 0.0, "qvel": 0.0, "force": 0.0, "peak": 0.0}
    compared, hardest = 0, 0.0
    for t in range(APPROACH + PRESS):
        before = state
        at = np.asarray(state.data.qpos)[:, index.robot_qpos]
        action = np.clip((goals - at) / scale, -1, 1).astype(np.float32)
        state = batch.step(state, action)
        if t < APPROACH:
            continue
        for i, shadow in shadows.items():
            touch, contacts = shadow.step(one(before, i), action[i])
            assert contacts <= 8  # scene.MAX_CONTACTS: MJX would leave some out
            c, mine, seen = shadow.data, one(state.data, i), one(state.regions, i)
            assert np.abs(c.qvel).max() > 0
            force = float(jnp.sum(touch.tools[0].force) + touch.robot_human) / 5
            theirs = float(state.metrics["force/on_human"][i])
            worst["qpos"] = max(worst["qpos"], np.abs(c.qpos - mine.qpos).max())
            worst["qvel"] = max(worst["qvel"], np.abs(c.qvel - mine.qvel).max())
            worst["force"] = max(worst["force"], abs(force - theirs) / max(1.0, force))
            # of each region of the body
            sums = touch.regions
            for a, b in ((sums.peak, seen.peak), (sums.mean / 5, seen.mean)):
                apart = np.abs(np.asarray(a) - b) / np.maximum(1.0, a)
                worst["peak"] = max(worst["peak"], apart.max())
            np.testing.assert_allclose(seen.mean.sum(), theirs, rtol=1e-4, atol=1e-5)
            assert state.metrics["force/peak_on_human"][i] == seen.peak.max()
            hardest = max(hardest, force)
            compared += theirs > 0.05
    assert compared > 0.5 * PRESS * len(WATCHED) and hardest > 0.5  # it was about contact
    assert worst["qpos"] < QPOS, worst
    assert worst["qvel"] < QVEL, worst
    assert worst["force"] < FORCE and worst["peak"] < FORCE, worst


@pytest.mark.jit
def test_sense_reads_c_mujocos_data_as_it_reads_mjxs(batch: CompiledBatch):
    env, index = batch.env, batch.env.scene.index
    state = batch.reset(jax.random.PRNGKey(0))
    first = one(state, 0)
    shadow = _Shadow(env.env, first.episode)
    shadow.data.qpos[:], shadow.data.qvel[:] = np.asarray(first.data.qpos), 0.1
    mujoco.mj_kinematics(shadow.model, shadow.data)
    dims = first.episode.human.dims
    data = first.data.replace(qvel=jnp.full_like(first.data.qvel, 0.1))
    sizes = shadow.model.geom_size
    mine, theirs = (
        sense(index, d, no_contacts(index), motion_at_rest(index, d, 1), dims, sizes)
        for d in (data, shadow.data)
    )
    jax.tree.map(lambda a, b: np.testing.assert_allclose(a, b, atol=1e-5), mine, theirs)
    # the tip's velocity is the Jacobian's
    linear = np.zeros((3, shadow.model.nv))
    mujoco.mj_comPos(shadow.model, shadow.data)
    mujoco.mj_jacSite(shadow.model, shadow.data, linear, None, index.tools[0].tip)
    np.testing.assert_allclose(mine.tool.vel_w, linear @ shadow.data.qvel, atol=1e-5)
