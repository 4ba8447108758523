# ruff: noqa: D103
"""A limp joint, whose motor has no bound, moves freely on MJX, too."""

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from mujoco import mjx

import agym_jax
from agym_jax.sim.mjx import LEAST_BOUND
from agym_jax.wrappers import vectorize

pytestmark = pytest.mark.parity
PENDULUM = """<mujoco><worldbody><body><joint type="hinge" axis="0 1 0" frictionloss="2"/>
<geom type="capsule" size=".03" fromto="0 0 0 .3 0 0" mass="1"/></body></worldbody></mujoco>"""


def accelerations(*bounds: float) -> list[float]:
    """Of a horizontal pendulum that is let go, by MJX, if its dry friction became each of these [rad/s2]."""
    model = mjx.put_model(mujoco.MjModel.from_xml_string(PENDULUM), impl="jax")
    data = mjx.make_data(model)
    forward = jax.jit(
        lambda bound: mjx.forward(model.tree_replace({"dof_frictionloss": bound}), data)
    )
    return [float(forward(jnp.full(1, bound, jnp.float32)).qacc[0]) for bound in bounds]


def test_mjx_holds_a_joint_without_friction_by_itself_and_not_with_the_least_bound():
    model = mujoco.MjModel.from_xml_string(PENDULUM)
    model.dof_frictionloss[:] = 0.0
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    free = data.qacc[0]
    assert abs(free) > 20.0
    held, limp = accelerations(0.0, LEAST_BOUND)
    assert abs(held) < 0.2 * abs(free)  # if not, MJX no longer needs LEAST_BOUND
    assert limp == pytest.approx(free, rel=1e-4)


def test_no_joint_of_a_limp_arm_is_held():
    native = agym_jax.make("ArmManipulationJaco-v0", impl="native")
    episode = native.reset(jax.random.PRNGKey(0)).episode
    env = agym_jax.make("ArmManipulationJaco-v0", impl="jax")
    bounds = np.asarray(env.physics.model_of(episode).dof_frictionloss)
    index = env.scene.index
    np.testing.assert_array_equal(bounds[index.human_dof], np.float32(LEAST_BOUND))
    assert (bounds[index.robot_dof] == 10.0).all()


@pytest.mark.slow
@pytest.mark.jit
def test_a_limp_arm_moves_as_in_c_mujoco():
    """Two control steps, 0.2 s: a held arm is 0.06 rad off after the first."""
    seen = []
    for impl in ("native", "jax"):
        batch = vectorize(agym_jax.make("ArmManipulationBaxter-v0", impl=impl), 2)
        step = batch.step if impl == "native" else jax.jit(batch.step)
        first = state = batch.reset(jax.random.PRNGKey(0))
        for _ in range(2):
            state = step(state, jnp.zeros((2, batch.action_size)))
        seen.append([np.array(x) for s in (first, state) for x in (s.obs, s.data.qpos)])
    index = agym_jax.make("ArmManipulationBaxter-v0", impl="native").scene.index
    assert np.abs(seen[0][3] - seen[0][1])[:, index.human_qpos].max() > 0.1
    for mine, theirs, tolerance in zip(*seen, (1e-5, 1e-5, 1e-3, 1e-4), strict=True):
        np.testing.assert_allclose(mine, theirs, atol=tolerance)
