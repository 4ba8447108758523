# ruff: noqa: D103 (a test's name says what it shows)
"""A step in which MuJoCo Warp's own Newton method diverges, on the CPU: a tool pressed into the bed's rolling friction."""

from __future__ import annotations

import jax
import mujoco
import numpy as np
import pytest
from compiled import compiled_human

import agym_jax
from agym_jax.compat.warp_newton import rebuild_hessians
from agym_jax.tasks import TASKS

wp = pytest.importorskip("warp", reason='needs pip install "agym_jax[warp]"')
pytestmark = pytest.mark.warp
N_ROBOT = 7
# the state, recorded under a policy that had learned to make the simulation diverge
QPOS = (
    -4.50663185,
    1.44428742,
    1.91337585,
    2.9797287,
    -0.359500587,
    4.83692408,
    1.75249374,
    -0.168564871,
    -0.116438597,
    -0.327525973,
    0.271095812,
    0.299415559,
    -0.504724979,
    -0.369344592,
    0.258078158,
    1.34175682,
    0.665708005,
)
QVEL = (
    -0.599634647,
    0.0841626823,
    0.652318478,
    0.566730678,
    0.56918174,
    -0.641858578,
    0.592840254,
    -1.5288264e-05,
    -0.00159546756,
    -0.0012299933,
    -0.308780223,
    1.39521253,
    1.00681281,
    -3.13620043,
    0.556764483,
    1.49524748,
    -1.67782056,
)
WARMSTART = (
    6.73495436,
    -8.00238705,
    -0.837265134,
    -1.23026919,
    -0.285506755,
    0.0523455441,
    -1.43289113,
    -26.4100132,
    16.3962231,
    -53.7537804,
    13.3938131,
    8.47166824,
    9.5832243,
    8.12663364,
    -0.142236859,
    -7.55535412,
    7.85534859,
)
APPLIED = (
    21.8932896,
    0.974234819,
    -0.382312089,
    7.589674,
    -0.422182947,
    0.777820468,
    -0.0237071551,
    0,
    0,
    0,
    0,
    0,
    0,
    0,
    0,
    0,
    0,
)
DRIVE_DAMPING = (0, 414.697815, 1.02669835, 2.37670326, 0.205874398, 0, 2.35311866)
WORLDS = 256
ROLLING = 0.15  # of the robot and its tool on the bed, when the state was recorded [m]


@pytest.fixture(scope="module")
def model() -> mujoco.MjModel:
    env = agym_jax.make("ArmManipulationJaco-v0", impl="native")
    key = jax.random.split(jax.random.PRNGKey(3), 16)[7]  # whose arm it was
    model = compiled_human(env, env.reset(key).episode)
    model.opt.iterations = model.opt.ls_iterations = 20  # as in the environments
    tools = np.isclose(model.pair_friction[:, 2], TASKS["ArmManipulation"].seat.tool_rolling)
    assert tools.any()
    model.pair_friction[tools, 2:] = ROLLING
    robot = np.arange(model.nv) < N_ROBOT
    model.dof_solref[:] = 0
    model.dof_solref[robot, 1] = -np.array(DRIVE_DAMPING)
    model.dof_frictionloss[:] = np.where(robot, 10.0, 0.0)
    model.dof_damping[:] = np.where(robot, 0.0, 0.05)
    model.dof_armature[:] = np.where(robot, 0.0, 0.011)
    return model


def of_c_mujoco(model: mujoco.MjModel, data: mujoco.MjData | None = None) -> np.ndarray:
    data = data or mujoco.MjData(model)
    data.qpos[:], data.qvel[:] = QPOS, QVEL
    data.qacc_warmstart[:], data.qfrc_applied[:] = WARMSTART, APPLIED
    mujoco.mj_forward(model, data)
    return data.qacc


def of_warp(model: mujoco.MjModel) -> np.ndarray:
    """Accelerations of many worlds, all but the first of which begin to search a little beside the recorded state."""
    from mujoco.mjx.third_party import mujoco_warp

    noise = np.random.default_rng(0).normal(0.0, 1e-3, (WORLDS, model.nv))
    noise[0] = 0.0
    state = {"qpos": QPOS, "qvel": QVEL, "qfrc_applied": APPLIED}
    state |= {"qacc_warmstart": WARMSTART + noise}
    with wp.ScopedDevice("cpu"):
        on_device = mujoco_warp.put_model(model)
        start = mujoco.MjData(model)
        data = mujoco_warp.put_data(model, start, nworld=WORLDS, nconmax=40, njmax=256)
        for name, value in state.items():
            all_of_them = np.broadcast_to(np.float32(value), (WORLDS, model.nv))
            setattr(data, name, wp.array(np.ascontiguousarray(all_of_them)))
        mujoco_warp.forward(on_device, data)
        return data.qacc.numpy()


def hessian(model: mujoco.MjModel, data: mujoco.MjData, acceleration: np.ndarray) -> np.ndarray:
    """What Newton's method factorises at an acceleration, in float64."""
    rows = np.zeros((data.nefc, model.nv))
    if mujoco.mj_isSparse(model):
        index = (data.efc_J_rownnz, data.efc_J_rowadr, data.efc_J_colind)
        mujoco.mju_sparse2dense(rows, data.efc_J, *index)
    else:
        rows[:] = data.efc_J.reshape(rows.shape)
    error = rows @ acceleration - data.efc_aref
    friction = data.efc_type == mujoco.mjtConstraint.mjCNSTR_FRICTION_DOF
    within = np.abs(error) < data.efc_frictionloss * data.efc_R
    active = rows[np.where(friction, within, error < 0)]
    weights = data.efc_D[np.where(friction, within, error < 0)]
    inertia = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, inertia)
    return inertia + active.T @ (weights[:, None] * active)


def test_what_rows_leave_behind_in_float32_is_larger_than_the_smallest_eigenvalue(model):
    data = mujoco.MjData(model)
    found = of_c_mujoco(model, data)
    first, last = (np.linalg.eigvalsh(hessian(model, data, x)) for x in (WARMSTART, found))
    assert first[-1] > 70_000 and 0.001 < last[0] < 0.0015
    assert first[-1] * np.finfo(np.float32).eps > 6 * last[0]


def test_newtons_method_finds_what_c_mujoco_finds(model):
    rebuild_hessians()
    found = of_warp(model)
    np.testing.assert_allclose(found, np.tile(of_c_mujoco(model), (WORLDS, 1)), atol=0.1)


def test_without_the_patch_it_diverges(model, monkeypatch):
    """Delete ``agym_jax/compat/warp_newton.py`` when this fails."""
    from mujoco.mjx.third_party.mujoco_warp._src import solver

    monkeypatch.setattr(solver, "_use_incremental", lambda _: True)
    assert np.isnan(of_warp(model)).any(axis=1).mean() > 0.5
