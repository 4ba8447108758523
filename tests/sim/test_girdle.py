# ruff: noqa: D103
"""What bears a seated person's arm: gravity's torque and no more, so that an arm that moves fast slows down."""

from __future__ import annotations

import jax
import mujoco
import numpy as np
import pytest

import agym_jax

# Of a training of robot and person together, half a second before the simulation exploded: shoulder and girdle turn against each other.
FLUNG_AT = [0.15, 0.57, -0.25, 0.03, -0.28, -0.34, -0.62, 1.51, 0.21, -0.02]
FLUNG = [-1.2, -0.82, -4.41, 1.19, -4.97, 0.82, 2.21, -0.53, 0.01, -0.51]


@pytest.fixture(scope="module")
def env() -> agym_jax.Env:
    return agym_jax.make(
        "ScratchItchJacoHuman-v0", impl="native", humans=agym_jax.Population(impairments=("none",))
    )


@pytest.mark.parametrize("speed", [0.0, 5.0])
def test_the_girdle_bears_the_weight_alone(env: agym_jax.Env, speed: float):
    model, girdle = env.scene.model, env.controller.girdle
    data, dofs = mujoco.MjData(model), env.scene.index.human_dof[girdle.rows]
    random = np.random.default_rng(0)
    for _ in range(5):
        data.qpos[:] = random.uniform(-1.0, 1.0, model.nq)
        data.qvel[:] = 0.0
        mujoco.mj_forward(model, data)
        weight = data.qfrc_bias[dofs].copy()
        data.qvel[:] = random.uniform(-speed, speed, model.nv)
        mujoco.mj_forward(model, data)
        borne = girdle.weight(model, data, np)
        assert np.abs(weight).max() > 0.1
        np.testing.assert_allclose(borne[girdle.rows], weight, atol=1e-6)
        assert np.count_nonzero(borne) == len(girdle.rows)


def test_a_flung_arm_slows_down(env: agym_jax.Env):
    index, state = env.scene.index, env.reset(jax.random.key(0))
    qpos, qvel = np.array(state.data.qpos), np.array(state.data.qvel)
    qpos[index.human_qpos], qvel[index.human_dof] = FLUNG_AT, FLUNG
    state = state.replace(data=state.data.replace(qpos=qpos, qvel=qvel))
    speeds = [max(map(abs, FLUNG))]
    for _ in range(10):
        state = env.step(state, np.zeros(env.action_size, np.float32))
        speeds.append(float(np.abs(state.data.qvel[index.human_dof]).max()))
    assert max(speeds) == speeds[0]  # it was 17 rad/s when the girdle bore inertial torques too
    assert speeds[-1] < 0.5


def test_who_lies_in_bed_has_no_such_support():
    assert agym_jax.make("BedBathingJaco-v0", impl="native").controller.girdle is None
