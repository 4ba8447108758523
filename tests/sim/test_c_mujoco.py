# ruff: noqa: D103
"""C MuJoCo's physics against MJX's, and what comes with it: no MJX, no NaN, nothing left behind."""

from __future__ import annotations

import itertools
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from compiled import ACTIVE, BATCH, STATIC, CompiledBatch
from paths import PROCESS_SECONDS
from test_parity import APPROACH, PRESS, WATCHED, one, press_goals

import agym_jax
from agym_jax.errors import ImplementationError
from agym_jax.human import limits
from agym_jax.policy import baseline_policy
from agym_jax.sim.native_data import BEARING, MOTION
from agym_jax.sim.physics import choose_impl
from agym_jax.sim.sensing import add_contacts, no_contacts, read_contacts, total_contacts
from agym_jax.wrappers import vectorize
from train import enjoy

# One control step from the same state, float64 against MJX's float32, in contact (see test_parity).
QPOS, OBS, REWARD, FORCE = (
    1e-5,
    5e-4,
    2e-3,
    5e-4,
)  # [rad], mixed (forces in N), -, [N] or share of the force


@pytest.fixture(scope="module")
def native() -> agym_jax.Env:
    """One environment of a person who does not act."""
    return agym_jax.make(STATIC, impl="native")


def _close(mine: Any, theirs: Any, atol: float) -> None:
    jax.tree.map(lambda a, b: np.testing.assert_allclose(a, b, atol=atol), mine, theirs)


# -- the same as MJX -----------------------------------------------------------------------------


@pytest.mark.jit
@pytest.mark.slow
def test_the_same_key_begins_the_same_episode_as_in_mjx(native: agym_jax.Env, batch: CompiledBatch):
    states = batch.reset(jax.random.PRNGKey(0))
    for i, key in enumerate(jax.random.split(jax.random.PRNGKey(0), BATCH)):
        mine, theirs = native.reset(key), one(states, i)
        _close(mine.obs, theirs.obs, 1e-5)
        for name in ("reward", "done", "metrics", "task", "episode"):
            _close(getattr(mine, name), getattr(theirs, name), 1e-5)
        np.testing.assert_array_equal(mine.key, theirs.key)
        for name, theirs_now in _motion(native, theirs).items():
            np.testing.assert_allclose(getattr(mine.data, name), theirs_now)


def _motion(native: agym_jax.Env, state: Any) -> dict[str, np.ndarray]:
    """The fields of a state of MJX that decide what happens next, as C MuJoCo keeps them: a sparse inertia."""
    numbers = {name: np.asarray(getattr(state.data, name)) for name in MOTION}
    model = native.scene.model
    rows = np.repeat(np.arange(model.nv), model.M_rownnz)
    return numbers | {"M": numbers["M"][rows, model.M_colind]}


def _as_native(native: agym_jax.Env, state: Any, make_data: Any) -> Any:
    """A state of MJX with the same numbers in C MuJoCo's data."""
    poses = {x: np.asarray(getattr(state.data, x)) for x in BEARING}
    poses["xmat"] = poses["xmat"].reshape(-1, 9)
    return state.replace(data=make_data.replace(**_motion(native, state), **poses), info={})


@pytest.mark.slow
@pytest.mark.jit
@pytest.mark.parity
def test_every_step_of_a_pressing_robot_is_mjxs(native: agym_jax.Env, batch: CompiledBatch):
    state = batch.reset(jax.random.PRNGKey(0))
    goals, make_data = press_goals(batch, state), native.physics.make_data()
    robot, scale = native.scene.index.robot_qpos, native.task.control.action_scale
    worst = {"qpos": 0.0, "obs": 0.0, "reward": 0.0, "force": 0.0}
    pressing = 0
    for t in range(APPROACH + PRESS):
        before = state
        at = np.asarray(state.data.qpos)[:, robot]
        action = np.clip((goals - at) / scale, -1, 1).astype(np.float32)
        state = batch.step(state, action)
        for i in WATCHED if t >= APPROACH else ():
            mine, theirs = (
                native.step(_as_native(native, one(before, i), make_data), action[i]),
                one(state, i),
            )
            force, their_force = (
                {k: float(v) for k, v in x.metrics.items() if k.startswith("force/")}
                for x in (mine, theirs)
            )
            gaps = {
                "qpos": np.abs(mine.data.qpos - theirs.data.qpos).max(),
                "obs": np.abs(mine.obs - theirs.info["final_observation"]).max(),
                "reward": abs(float(mine.reward - theirs.reward)),
                "force": max(abs(v - their_force[k]) / max(1.0, v) for k, v in force.items()),
            }
            worst = {k: max(v, float(gaps[k])) for k, v in worst.items()}
            pressing += force["force/on_human"] > 0.05
            _close(mine.task, theirs.task, FORCE)
            assert set(mine.metrics) == set(theirs.metrics)
    assert pressing > 0.5 * PRESS * len(WATCHED)  # it was about contact
    limits = {"qpos": QPOS, "obs": OBS, "reward": REWARD, "force": FORCE}
    assert all(worst[k] < limits[k] for k in worst), worst


# a bed, an active person, and one with a welded body (two arms, and whole steps: test_limp.py)
@pytest.mark.jit
@pytest.mark.slow
@pytest.mark.parametrize("name", ["BedBathingSawyer-v0", ACTIVE, "ReachingPR2-v0"])
def test_every_kind_of_environment_begins_as_in_mjx_and_steps(name: str):
    env, mjx = agym_jax.make(name, impl="native"), agym_jax.make(name, impl="jax")
    key = jax.random.PRNGKey(3)
    state = env.reset(key)
    their_obs, their_metrics = jax.jit(lambda k: (lambda s: (s.obs, s.metrics))(mjx.reset(k)))(key)
    np.testing.assert_allclose(state.obs, their_obs, atol=1e-5)
    assert set(state.metrics) == set(their_metrics)
    first, rng = state, np.random.default_rng(0)
    for _ in range(5):
        state = env.step(state, rng.uniform(-1, 1, env.action_size))
        assert np.isfinite(state.obs).all() and np.isfinite(state.reward)
        assert state.metrics["nan"] == 0 and state.done == 0
    assert state.episode.step == 5
    moved = np.abs(state.data.qpos - first.data.qpos)
    assert moved[env.scene.index.robot_qpos].max() > 0.005
    assert state.obs.shape == (env.observation_size,) and state.obs.dtype == np.float32


def test_touch_in_numpy_is_the_touch_in_jax(native: agym_jax.Env):
    index, n = native.scene.index, native.scene.model.nsensordata
    rows = np.random.default_rng(0).normal(size=(5, n)).astype(np.float32)
    total = no_contacts(index)
    for row in rows:
        total = add_contacts(index, total, jnp.asarray(row))
    mine = total_contacts(read_contacts(index, rows, np), np)
    jax.tree.map(lambda a, b: np.testing.assert_allclose(a, b, rtol=1e-5), mine, total)
    assert float(total.robot_human) > 0 and total.tools[0].moment.shape[1] == 3


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_limits_are_left_out_only_where_they_push_nothing(side: float, native: agym_jax.Env):
    rng, controller = np.random.default_rng(1), native.controller
    names = native.scene.moving
    arm, sign = controller.arms[0]
    assert sign == 1.0 and [names[i] for i in arm] == [
        "r_shoulder_y", "r_shoulder_x", "r_shoulder_z", "r_elbow_x",
    ]  # fmt: skip
    weights = controller.arm_limits
    q = weights.center + weights.half_range * rng.uniform(-1.2, 1.2, (300, 4))
    q = q.astype(np.float32)
    torque = jax.vmap(lambda x: limits.limit_torque(weights, x, jnp.ones(4), side))(
        jax.vmap(lambda x: limits.mirror_left(x, side))(jnp.asarray(q))
    )
    within = [limits.reachability(weights, pose, np) > 0.0 for pose in q]
    assert 50 < sum(within) < 250
    np.testing.assert_array_equal(np.asarray(torque != 0).any(1), ~np.array(within))


# -- what comes with it --------------------------------------------------------------------------


def _child(code: str, folder: Path) -> str:
    root = os.path.dirname(os.path.dirname(agym_jax.__file__))
    path = os.pathsep.join(filter(None, (root, os.environ.get("PYTHONPATH"))))
    done = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", code], cwd=folder, timeout=PROCESS_SECONDS,
        capture_output=True, text=True, env={**os.environ, "PYTHONPATH": path, "JAX_PLATFORMS": "cpu"},
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return done.stdout.strip()


@pytest.mark.jit
def test_one_environment_on_a_cpu_steps_without_importing_mjx(tmp_path: Path):
    code = f"""
import sys, gymnasium, agym_jax
env = gymnasium.make("{STATIC}")
env.reset(seed=0)
obs, *_ = env.step(env.action_space.sample())
print(obs.shape, sorted(m for m in sys.modules if m.split(".")[0] in ("brax", "warp") or "mjx" in m))
"""
    assert _child(code, tmp_path) == "(30,) []"


@pytest.mark.jit
def test_an_environment_that_breaks_ends_quietly_and_leaves_nothing_behind(
    native: agym_jax.Env, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: Any
):
    monkeypatch.chdir(tmp_path)  # where MuJoCo would write its log
    state, still = native.reset(jax.random.PRNGKey(0)), np.zeros(7)
    after = native.step(state, still)
    for field, value in (("qpos", np.nan), ("qvel", np.inf), ("qvel", 1e9), ("qvel", 1e30)):
        broken = native.step(state.replace(data=state.data.replace(**{field: value})), still)
        assert (broken.done, broken.metrics["nan"], broken.reward) == (1, 1, 0), (field, value)
        np.testing.assert_array_equal(broken.obs, state.obs)  # what was seen last
        assert all(np.isfinite(v) for v in broken.metrics.values())
    again = native.step(state, still)
    np.testing.assert_array_equal(again.data.numbers, after.data.numbers)
    assert after.done == 0 and not list(tmp_path.iterdir())
    assert capfd.readouterr() == ("", "")


@pytest.mark.jit
def test_a_step_depends_on_its_arguments_alone(native: agym_jax.Env):
    action = np.linspace(-1, 1, 7)
    mine, other = (native.reset(jax.random.PRNGKey(seed)) for seed in (0, 1))
    before = np.array(mine.data.numbers)
    first = native.step(mine, action)
    elsewhere = native.step(native.step(other, -action), action)  # another person, other contacts
    assert not np.array_equal(elsewhere.episode.rows.body_pos, mine.episode.rows.body_pos)
    again = native.step(mine, action)
    np.testing.assert_array_equal(first.data.numbers, again.data.numbers)
    np.testing.assert_array_equal(first.obs, again.obs)
    np.testing.assert_array_equal(mine.data.numbers, before)  # what went in is as it was
    # nor does it matter whether the episode is the very object that reset returned
    copied = native.step(jax.device_get(mine), action)
    np.testing.assert_array_equal(copied.data.numbers, first.data.numbers)


@pytest.mark.jit
def test_restart_begins_the_next_episode_or_does_nothing(native: agym_jax.Env):
    state = native.step(native.reset(jax.random.PRNGKey(0)), np.ones(7))
    same = native.reset_where(state, jnp.bool_(False))
    _close((same.obs, same.task, same.episode), (state.obs, state.task, state.episode), 0.0)
    np.testing.assert_array_equal(same.data.numbers, state.data.numbers)
    fresh = native.reset_where(state, jnp.bool_(True))
    key, key_next = jax.random.split(state.key)
    np.testing.assert_allclose(fresh.obs, native.reset(key).obs, atol=1e-6)
    np.testing.assert_array_equal(fresh.key, key_next)
    assert fresh.episode.step == 0 and not np.any(fresh.data.qvel)


@pytest.mark.jit
def test_enjoy_plays_one_environment_on_it(native: agym_jax.Env):
    assert enjoy.EnjoyConfig().impl == "native"
    player = enjoy.Player(native, baseline_policy("random", native.action_size))
    frames = list(itertools.islice(player.episode(7), 4))
    assert [frame.step for frame in frames] == [0, 1, 2, 3] and not frames[-1].over
    again = list(itertools.islice(player.episode(7), 4))
    np.testing.assert_array_equal(frames[-1].state.obs, again[-1].state.obs)
    assert frames[-1].total == again[-1].total < 0.0
    model, data = native.to_mujoco(frames[-1].state)
    np.testing.assert_array_equal(data.qpos, frames[-1].state.data.qpos)
    assert model.ngeom > native.scene.model.ngeom  # with all that people look at


@pytest.mark.jit
def test_tracing_it_is_refused_with_what_to_do(native: agym_jax.Env):
    refused = r"cannot be traced by jax.jit or jax.vmap.*vectorize\(env, num_envs\).*impl='jax'"
    with pytest.raises(ImplementationError, match=refused):
        jax.jit(native.reset)(jax.random.PRNGKey(0))
    with pytest.raises(ImplementationError, match=refused):
        jax.vmap(native.reset)(jax.random.split(jax.random.PRNGKey(0)))
    state = native.reset(jax.random.PRNGKey(0))
    for function in (native.step, vectorize(native, 1).step):
        with pytest.raises(ImplementationError, match=refused):
            jax.jit(function)(state, jnp.zeros(7))


def test_auto_is_native_on_a_cpu_where_nobody_traces():
    untraced, traced = choose_impl("auto", traced=False), choose_impl("auto")
    assert traced in ("jax", "warp")
    assert untraced == ("native" if jax.default_backend() == "cpu" else traced)
    assert choose_impl("jax", traced=False) == "jax" and choose_impl("native") == "native"
    with pytest.raises(ImplementationError, match="There are: auto, jax, native, warp"):
        choose_impl("mujoco")
