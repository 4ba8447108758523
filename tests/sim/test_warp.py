"""MuJoCo Warp means the same as MJX in JAX and as C MuJoCo. It runs on the CPU too, slowly."""

# ruff: noqa: D103
import operator
import threading

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from compiled import compiled_human

import agym_jax
from agym_jax.compat import warp_kernels
from agym_jax.sim import mjx as mjx_physics
from agym_jax.wrappers import vectorize

pytest.importorskip("warp", reason='needs pip install "agym_jax[warp]"')
pytestmark = [pytest.mark.warp, pytest.mark.slow]
N = 4


def rollout(impl: str, steps: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Observations, rewards and overflow flags of a few environments under the same actions."""
    batch = vectorize(agym_jax.make("ScratchItchJaco-v0", impl=impl), N)
    reset, step = batch.reset, batch.step
    if impl != "native":
        reset, step = jax.jit(reset), jax.jit(step)
    state = reset(jax.random.PRNGKey(0))
    rows = []
    for i in range(steps):
        action = jax.random.uniform(jax.random.PRNGKey(i), (N, 7), minval=-1.0, maxval=1.0)
        state = step(state, jnp.asarray(action))
        rows.append((state.obs, state.reward, state.metrics["overflow"]))
    return tuple(np.array(x) for x in zip(*rows, strict=True))  # type: ignore[return-value]


def test_warp_and_c_mujoco_give_the_same_trajectory():
    """MJX in JAX is compared with C MuJoCo in test_parity.py and test_c_mujoco.py."""
    obs, reward, overflow = rollout("warp", 10)
    obs_c, reward_c, _ = rollout("native", 10)
    np.testing.assert_allclose(obs, obs_c, atol=1e-4)  # Warp computes in float32
    np.testing.assert_allclose(reward, reward_c, atol=1e-4)
    assert not overflow.any()


def test_each_environment_of_warp_touches_its_own_person():
    """Limbs that no joint moves: MuJoCo Warp places them once for all environments if it is let."""
    batch = vectorize(agym_jax.make("BedBathingJaco-v0", impl="warp"), N)
    env, index = batch.env, batch.env.scene.index
    state = jax.jit(batch.reset)(jax.random.PRNGKey(0))
    step, reset_where = jax.jit(batch.step), jax.jit(jax.vmap(env.reset_where))
    state = reset_where(state, jnp.arange(N) % 2 == 0)  # half of them are somebody new
    assert 0 < np.sum(np.asarray(state.episode.human.sex)) < N
    humans = [jax.tree.map(operator.itemgetter(i), state.episode) for i in range(N)]
    models = [compiled_human(env, episode) for episode in humans]
    reach = np.array([[0.3, -0.3, 0.3, 0.0, 0.3, 0.3, 0.0]] * N, np.float32)
    state = step(state, reach)
    for i, model in enumerate(models):
        c = mujoco.MjData(model)
        c.qpos[:] = np.asarray(state.data.qpos[i])
        mujoco.mj_kinematics(model, c)
        for name in ("geom_xpos", "geom_xmat"):
            mine = np.asarray(getattr(state.data, name)[i]).reshape(-1)
            np.testing.assert_allclose(mine, getattr(c, name).reshape(-1), atol=1e-5, err_msg=name)
    # a hand inside the chest is pushed by this person's chest, as in C MuJoCo
    press = _deepest_press(env, models)
    data = state.data.replace(qpos=jnp.asarray(press), qvel=jnp.zeros_like(state.data.qvel))
    after = step(state.replace(data=data), np.zeros((N, 7), np.float32))
    for i, model in enumerate(models):
        c = mujoco.MjData(model)
        c.qpos[:] = press[i]
        force, aim = 0.0, env.controller.aim(press[i][index.robot_qpos])
        for _ in range(env.task.control.frame_skip):
            env.controller.motors.prepare(model, c, aim)
            mujoco.mj_step(model, c)
            force += np.abs(c.sensordata[index.robot_human]).sum()
            force += sum(np.abs(c.sensordata[t.on_human]).sum() for t in index.tools)
        assert force > 1.0
        mine = float(after.metrics["force/on_human"][i])
        np.testing.assert_allclose(mine, force / env.task.control.frame_skip, rtol=2e-3)
        np.testing.assert_allclose(after.data.qpos[i], c.qpos, atol=1e-4)


def _deepest_press(env, models) -> np.ndarray:
    """For each person a pose of the robot (n_q,) that presses 1 to 8 mm into a limb."""
    index, rng = env.scene.index, np.random.default_rng(0)
    low, high = env.scene.model.jnt_range[index.robot_joint].T
    poses = []
    for model in models:
        c = mujoco.MjData(model)
        limbs = set(index.human_geom.tolist())
        while True:
            c.qpos[:] = rng.uniform(np.maximum(low, -3.1), np.minimum(high, 3.1))
            mujoco.mj_forward(model, c)
            pairs = zip(c.contact.geom, c.contact.dist, strict=True)
            depths = [-d for g, d in pairs if limbs & set(g.tolist())]
            if depths and len(depths) == c.ncon and 1e-3 < max(depths) < 8e-3:
                poses.append(c.qpos.copy())
                break
    return np.stack(poses).astype(np.float32)


def carry_water(impl: str) -> tuple[np.ndarray, ...]:
    """Two cups of water on their way: where the drops are, which are left, and the joints."""
    batch = vectorize(agym_jax.make("DrinkingJaco-v0", impl=impl), 2)
    state = jax.jit(batch.reset)(jax.random.PRNGKey(3))
    step = jax.jit(batch.step)
    action = jnp.zeros((2, 7)).at[0, 6].set(1.0).at[1, 5].set(1.0)
    rows = []
    for _ in range(40):
        state = step(state, action)
        rows.append((state.task.water.pos_w, state.task.water.alive, state.data.qpos))
    return tuple(np.array(x) for x in zip(*rows, strict=True))  # type: ignore[return-value]


def test_water_is_the_same_on_both():
    pos, alive, qpos = carry_water("warp")
    pos_jax, alive_jax, qpos_jax = carry_water("jax")
    np.testing.assert_allclose(qpos, qpos_jax, atol=1e-5)
    np.testing.assert_array_equal(alive, alive_jax)
    # drops push each other, so rounding grows, for single drops most; a drop is 1 cm wide
    np.testing.assert_allclose(pos[:10], pos_jax[:10], atol=2e-4)
    assert np.median(np.abs(pos - pos_jax), axis=(1, 2, 3)).max() < 2e-4
    np.testing.assert_allclose(pos, pos_jax, atol=5e-3)
    assert np.linalg.norm(pos[-1] - pos[0], axis=-1).mean() > 0.05  # and they did travel


LIMITS = (mjx_physics.WARP_ROWS_PER_ENV, mjx_physics.WARP_CONTACTS_PER_ENV)


@pytest.fixture(scope="module")
def warp_model():
    """A scene's model with the limits that our physics sets, and MuJoCo Warp's of it."""
    from mujoco.mjx.third_party import mujoco_warp

    from agym_jax.compat import warp_sensors

    model = agym_jax.make("ReachingSawyer-v0", impl="jax").scene.model
    put = mujoco_warp.put_model(model)
    options = {"warn_overflow": put.opt.warn_overflow} | warp_sensors.options(model)
    put.opt.contact_sensor_maxmatch = options["contact_sensor_maxmatch"]
    return model, put, options


def test_a_step_compiles_nothing_that_was_not_foreseen(warp_model):
    import warp
    from mujoco.mjx.third_party import mujoco_warp

    model, put, options = warp_model
    foreseen = warp_kernels.launched(model, *LIMITS, options)
    assert len(foreseen) > 20
    warp_kernels.compile_kernels(model, *LIMITS, options)
    warp_kernels.wait_for_kernels()
    assert all(module.execs for module, _ in foreseen)
    data = mujoco_warp.make_data(model, 2, naconmax=2 * LIMITS[1], njmax=LIMITS[0])
    loaded = []
    load = warp._src.context.Module.load

    def spy(module, *args, **kwargs):
        if not module.execs:
            loaded.append(module.name)
        return load(module, *args, **kwargs)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(warp._src.context.Module, "load", spy)
        mujoco_warp.step(put, data)
    assert loaded == []
    assert data.time.numpy() == pytest.approx([model.opt.timestep] * 2)  # it did step


def test_to_foresee_a_step_launches_nothing_but_lets_other_threads_go_on(warp_model):
    import warp
    from mujoco.mjx.third_party import mujoco_warp

    model, put, _ = warp_model
    data = mujoco_warp.make_data(model, 1, naconmax=LIMITS[1], njmax=LIMITS[0])
    noted: dict = {}
    with warp_kernels._noting(noted):
        mujoco_warp.step(put, data)
        assert data.time.numpy() == 0.0
        other = threading.Thread(target=mujoco_warp.step, args=(put, data))
        other.start()
        other.join()
    assert data.time.numpy() == pytest.approx(model.opt.timestep)
    assert warp.launch.__module__.startswith("warp")  # and it is Warp's own again
