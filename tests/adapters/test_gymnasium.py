# ruff: noqa: D103
"""The Gymnasium interface, judged by Gymnasium's own checker."""

from __future__ import annotations

import copy
import os
import pickle
import subprocess
import sys
import warnings
from collections.abc import Iterator

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from paths import PROCESS_SECONDS

import agym_jax
from agym_jax.adapters import common
from agym_jax.adapters.gymnasium import GymnasiumEnv, RenderModeError, register_envs
from agym_jax.errors import (
    ActionError,
    AgymError,
    ImplementationError,
    UnknownNameError,
)
from agym_jax.sim.physics import choose_impl

NAME = "ScratchItchJaco-v0"
# Gymnasium prefers bounded observations; positions and forces have no bound worth the name
UNBOUNDED = ("minimum value is -infinity", "maximum value is infinity")


@pytest.fixture(scope="module")
def env() -> Iterator[gymnasium.Env]:
    env = gymnasium.make(NAME, render_mode="rgb_array", width=64, height=48)
    yield env
    env.close()


@pytest.fixture(scope="module")
def on_mjx() -> Iterator[gymnasium.Env]:
    """The same with the physics that is trained on."""
    env = gymnasium.make(NAME, impl="jax")
    yield env
    env.close()


def test_every_id_is_registered_once_and_again_is_fine():
    before = dict(gymnasium.registry)
    register_envs()
    agym_jax.register_envs()
    assert dict(gymnasium.registry) == before
    for name in agym_jax.list_envs():
        spec = gymnasium.spec(name)
        assert spec.entry_point == "agym_jax.adapters.gymnasium:GymnasiumEnv"
        assert spec.kwargs == {"env_id": name}
        assert spec.max_episode_steps is None  # the environment truncates itself


def test_module_prefix_registers_by_importing():
    code = f"import gymnasium; print(gymnasium.make('agym_jax:{NAME}').unwrapped.core.name)"
    root = os.path.dirname(os.path.dirname(agym_jax.__file__))
    path = os.pathsep.join(filter(None, (root, os.environ.get("PYTHONPATH"))))
    done = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", code], timeout=PROCESS_SECONDS,
        capture_output=True, text=True, env={**os.environ, "PYTHONPATH": path}, check=False,
    )  # fmt: skip
    assert done.stdout.strip() == NAME, done.stderr


def test_spaces_are_the_references():
    # tasks.md section 1.2
    for name, obs, action in ((NAME, 30, 7), ("ScratchItchJacoHuman-v0", 64, 17)):
        env = gymnasium.make(name).unwrapped
        assert env.observation_space == gymnasium.spaces.Box(-np.inf, np.inf, (obs,), np.float32)
        assert env.action_space == gymnasium.spaces.Box(-1.0, 1.0, (action,), np.float32)
    assert GymnasiumEnv.metadata == {"render_modes": ["rgb_array"], "render_fps": 10}


def test_instances_share_what_is_compiled():
    one, two = gymnasium.make(NAME).unwrapped, gymnasium.make(NAME).unwrapped
    assert one is not two and one._programs is two._programs
    assert one._programs is not gymnasium.make("ScratchItchJacoHuman-v0").unwrapped._programs


def test_there_is_no_state_before_reset():
    env = GymnasiumEnv(NAME)
    with pytest.raises(gymnasium.error.ResetNeeded, match="call reset"):
        env.step(np.zeros(7))
    with pytest.raises(gymnasium.error.ResetNeeded, match="no state before"):
        _ = env.state


def test_unknown_names_are_refused():
    with pytest.raises(UnknownNameError, match="Did you mean 'ScratchItchJaco-v0'"):
        GymnasiumEnv("ScratchItchJako-v0")
    with pytest.raises(ImplementationError, match=r"'natve'. Did you mean 'native'.*auto, jax"):
        GymnasiumEnv(NAME, impl="natve")
    with pytest.raises(RenderModeError, match=r"no render mode 'rgb'.*'rgb_array'"):
        GymnasiumEnv(NAME, render_mode="rgb")


@pytest.mark.parametrize(
    ("action", "message"),
    [
        (np.zeros(6), rf"{NAME} takes actions of shape \(7,\), got \(6,\)"),
        (np.zeros((1, 7)), r"got \(1, 7\)"),
        (np.full(7, np.nan), rf"{NAME} takes finite actions of shape \(7,\)"),
        (np.array([0, 0, 0, np.inf, 0, 0, 0]), "NaN or infinity"),
    ],
)
def test_actions_are_checked(action: np.ndarray, message: str):
    with pytest.raises(ActionError, match=message):
        GymnasiumEnv(NAME).step(action)


@pytest.mark.jit
def test_gymnasiums_checker_has_nothing_to_say(env: gymnasium.Env, raycast: None):
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        check_env(env.unwrapped)
    ours = [str(w.message) for w in caught if not any(u in str(w.message) for u in UNBOUNDED)]
    assert not ours


@pytest.mark.jit
def test_info_has_assistive_gyms_keys_and_the_rewards_terms(env: gymnasium.Env):
    _, info = env.reset(seed=0)
    obs, reward, terminated, truncated, after = env.step(env.action_space.sample())
    assert set(info) == set(after)
    lengths = {
        "obs_robot_len": 30,
        "obs_human_len": 0,
        "action_robot_len": 7,
        "action_human_len": 0,
    }
    assert {k: after[k] for k in lengths} == lengths
    assert after["total_force_on_human"] >= 0.0 and after["task_success"] == 0
    assert sum(after["reward_terms"].values()) == pytest.approx(reward, abs=1e-5)
    assert after["reward_terms"]["distance"] < 0
    assert isinstance(reward, float) and terminated is False and truncated is False
    assert obs.dtype == np.float32 and obs.shape == (30,)


@pytest.mark.jit
def test_seed_decides_the_episode_and_the_ones_after(env: gymnasium.Env):
    first = [env.reset(seed=5)[0], env.reset()[0], env.reset()[0]]
    again = [env.reset(seed=5)[0], env.reset()[0], env.reset()[0]]
    np.testing.assert_array_equal(first, again)
    assert len(np.unique(first, axis=0)) == 3
    assert not np.array_equal(env.reset(seed=6)[0], first[0])


@pytest.mark.jit
def test_episode_is_truncated_at_200_steps_and_then_needs_a_reset(env: gymnasium.Env):
    env.reset(seed=0)
    ends = [env.step(np.zeros(7, np.float32))[2:4] for _ in range(200)]
    assert ends == [(False, False)] * 199 + [(False, True)]  # tasks.md section 1.1
    with pytest.raises(gymnasium.error.ResetNeeded):
        env.step(np.zeros(7, np.float32))
    env.reset()
    assert env.step(np.zeros(7, np.float32))[2:4] == (False, False)


@pytest.mark.jit
@pytest.mark.parametrize("physics", ["env", pytest.param("on_mjx", marks=pytest.mark.slow)])
def test_broken_physics_truncates(physics: str, request: pytest.FixtureRequest):
    env = request.getfixturevalue(physics)
    first, _ = env.reset(seed=0)
    core = env.unwrapped
    qpos = np.array(core.state.data.qpos)
    qpos[0] = np.nan
    core._state = core.state.replace(data=core.state.data.replace(qpos=qpos))
    obs, reward, terminated, truncated, _ = env.step(np.zeros(7, np.float32))
    assert (terminated, truncated, reward) == (False, True, 0.0)
    np.testing.assert_array_equal(obs, first)  # the last that could be seen
    with pytest.raises(gymnasium.error.ResetNeeded):
        env.step(np.zeros(7, np.float32))


@pytest.mark.jit
@pytest.mark.slow
def test_one_environment_is_c_mujocos_on_a_cpu_and_the_same_as_mjxs(
    env: gymnasium.Env, on_mjx: gymnasium.Env
):
    assert env.unwrapped.core.impl == choose_impl("auto", traced=False)
    assert on_mjx.unwrapped.core.impl == "jax"
    (mine, info), (theirs, their_info) = env.reset(seed=3), on_mjx.reset(seed=3)
    np.testing.assert_allclose(mine, theirs, atol=1e-5)
    assert set(info) == set(their_info)
    for action in np.random.default_rng(0).uniform(-1, 1, (5, 7)).astype(np.float32):
        mine, reward, *ends, info = env.step(action)
        theirs, their_reward, *their_ends, their_info = on_mjx.step(action)
        # free motion: float64 beside float32 over half a second
        np.testing.assert_allclose(mine, theirs, atol=1e-3)
        assert reward == pytest.approx(their_reward, abs=1e-3) and ends == their_ends
        assert set(info["reward_terms"]) == set(their_info["reward_terms"])


def _same(one: tuple, other: tuple) -> None:
    """Two results of ``step`` are equal."""
    np.testing.assert_array_equal(one[0], other[0])
    assert one[1:] == other[1:]


@pytest.mark.jit
@pytest.mark.parametrize("how", ["deepcopy", "pickle"])
def test_a_copy_goes_on_as_the_original_would_and_by_itself(env: gymnasium.Env, raycast, how: str):
    env.reset(seed=2)
    actions = np.random.default_rng(0).uniform(-1, 1, (8, 7)).astype(np.float32)
    for action in actions[:3]:
        env.step(action)
    env.render()  # what draws is not copied
    other = copy.deepcopy(env) if how == "deepcopy" else pickle.loads(pickle.dumps(env))
    assert other.unwrapped.core is env.unwrapped.core  # what is compiled is shared
    planned = [other.step(action) for action in actions[3:]]  # a planner tries something
    assert other.render().shape == (48, 64, 3)
    fresh = other.reset()[0]
    for action, found in zip(actions[3:], planned, strict=True):
        _same(env.step(action), found)
    np.testing.assert_array_equal(env.reset()[0], fresh)  # the next person too
    other.close()


def test_a_copy_does_not_go_on_in_a_forked_process(env: gymnasium.Env, monkeypatch):
    copied = pickle.dumps(env.unwrapped)
    monkeypatch.setattr(common._Process, "pid", -1)  # as if another process had made it
    with pytest.raises(common.ForkedProcessError, match="does not work in forked processes"):
        pickle.loads(copied)


def test_what_has_not_begun_can_be_copied():
    for other in (
        copy.deepcopy(GymnasiumEnv(NAME)),
        pickle.loads(pickle.dumps(GymnasiumEnv(NAME))),
    ):
        with pytest.raises(gymnasium.error.ResetNeeded, match="no state before"):
            _ = other.state


@pytest.mark.jit
def test_options_are_refused(env: gymnasium.Env):
    with pytest.raises(AgymError, match="has no reset options, got: gender"):
        env.unwrapped.reset(options={"gender": "male"})


@pytest.mark.jit
def test_pictures_show_this_episodes_person_and_what_moves(env: gymnasium.Env, raycast: None):
    env.reset(seed=0)
    first = env.render()
    assert first.shape == (48, 64, 3) and first.dtype == np.uint8
    assert first.std() > 10 and len(np.unique(first.reshape(-1, 3), axis=0)) > 100
    np.testing.assert_array_equal(env.render(), first)  # looking changes nothing
    for _ in range(10):
        env.step(np.ones(7, np.float32))
    moved = env.render()
    assert (np.abs(moved.astype(int) - first).max(-1) > 20).sum() > 10
    model = env.unwrapped._pictures[1]
    env.reset(seed=1)
    env.render()
    assert env.unwrapped._pictures[1] is not model  # somebody else


@pytest.mark.jit
def test_without_a_render_mode_there_is_a_hint_and_no_picture():
    env = gymnasium.make(NAME).unwrapped
    env.reset(seed=0)
    with pytest.warns(UserWarning, match='render_mode="rgb_array"'):
        assert env.render() is None


@pytest.mark.jit
def test_default_way_to_draw_gives_a_picture(env: gymnasium.Env):
    env.reset(seed=0)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # without OpenGL the first picture says so
        picture = env.render()
    assert picture.std() > 10
