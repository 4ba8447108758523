# ruff: noqa: D103
"""Many environments through ``gymnasium.make_vec``: Gymnasium's conventions, seeds, ends of episodes, processes."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from types import SimpleNamespace

import gymnasium
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode
from gymnasium.wrappers.vector import ClipReward, RecordEpisodeStatistics, RescaleAction
from paths import ROOT

import agym_jax
from agym_jax.adapters.vector import GymnasiumVectorEnv
from agym_jax.errors import ActionError, AgymError, ArgumentError, ImplementationError
from agym_jax.human.population import Population
from agym_jax.state import drawable, drawn_of
from agym_jax.wrappers import available_cores

NAME = "ReachingJaco-v0"
B, T = 3, 200
ASYNC = f"""
import agym_jax, gymnasium, numpy as np
if __name__ == "__main__":
    envs = gymnasium.make_vec("{NAME}", num_envs=2, vectorization_mode="async", vector_kwargs=KWARGS)
    obs, _ = envs.reset(seed=0)
    print(envs.step(np.zeros((2, 7), np.float32))[0].shape)
    envs.close()
"""


@pytest.fixture(scope="module")
def envs() -> Iterator[GymnasiumVectorEnv]:
    envs = gymnasium.make_vec(
        NAME, num_envs=B, impl="native", render_mode="rgb_array", width=64, height=48
    )
    yield envs
    envs.close()


def random_actions(steps: int) -> np.ndarray:
    return np.random.default_rng(0).uniform(-1, 1, (steps, B, 7)).astype(np.float32)


def test_make_vec_gives_all_environments_at_once(envs):
    assert isinstance(envs, GymnasiumVectorEnv) and envs.num_envs == B
    assert envs.metadata["autoreset_mode"] is AutoresetMode.SAME_STEP
    assert envs.single_action_space.shape == (7,) and envs.action_space.shape == (B, 7)
    assert envs.observation_space.shape == (B, *envs.single_observation_space.shape)
    assert envs.spec.id == NAME and str(B) in repr(envs)
    for name in agym_jax.list_envs():
        assert gymnasium.spec(name).vector_entry_point.endswith("vector:GymnasiumVectorEnv")


@pytest.mark.jit
def test_episodes_are_those_of_one_environment_with_the_same_seed(envs):
    actions = random_actions(5)
    obs, info = envs.reset(seed=4)
    steps = [envs.step(action) for action in actions]
    for i in range(B):
        one = gymnasium.make(NAME, impl="native")
        mine, told = one.reset(seed=4 + i)
        np.testing.assert_array_equal(obs[i], mine)
        assert info["obs_robot_len"][i] == told["obs_robot_len"]
        for action, (all_obs, rewards, ended, cut, infos) in zip(actions, steps, strict=True):
            mine, reward, terminated, truncated, told = one.step(action[i])
            np.testing.assert_array_equal(all_obs[i], mine)
            assert (rewards[i], ended[i], cut[i]) == (reward, terminated, truncated)
            assert infos["total_force_on_human"][i] == told["total_force_on_human"]
            assert infos["reward_terms"]["distance"][i] == told["reward_terms"]["distance"]


@pytest.mark.jit
def test_seeds_may_be_an_array(envs):
    one = envs.reset(seed=list(range(B)))[0]
    assert np.array_equal(one, envs.reset(seed=np.arange(B))[0])


def test_seeds_decide_every_environment(envs):
    first = envs.reset(seed=7)[0]
    again = envs.reset()[0]
    np.testing.assert_array_equal(envs.reset(seed=7)[0], first)
    np.testing.assert_array_equal(envs.reset()[0], again)
    np.testing.assert_array_equal(envs.reset(seed=[9, 8, 7])[0][2], first[0])
    assert len(np.unique(envs.reset(seed=[1, 1, None])[0], axis=0)) == 2
    assert not np.array_equal(first, again)


@pytest.mark.jit
def test_what_ends_begins_anew_in_the_same_step(envs):
    wrapped = RecordEpisodeStatistics(envs)
    wrapped.reset(seed=0)
    total = np.zeros(B)
    for step, action in enumerate(random_actions(T + 2), 1):
        obs, rewards, ended, cut, info = wrapped.step(action)
        assert not ended.any() and cut.all() == (step == T) and cut.dtype == ended.dtype == bool
        assert ("final_obs" in info) == (step == T)
        total += rewards if step <= T else 0.0
        if step == T:
            assert info["_final_obs"].all() and info["_final_info"].all()
            assert all(info["final_obs"][i].shape == obs[i].shape for i in range(B))
            assert not np.array_equal(info["final_obs"][0], obs[0])  # somebody else's
            last = info["final_info"]
            assert last["_task_success"].all() and last["reward_terms"]["distance"].shape == (B,)
            np.testing.assert_allclose(info["episode"]["r"], total, rtol=1e-6)
            assert (info["episode"]["l"] == T).all()
    assert wrapped.episode_count == B


@pytest.mark.jit
def test_other_wrappers_of_gymnasium_take_it(envs):
    wrapped = ClipReward(RescaleAction(envs, np.float32(-2.0), np.float32(2.0)), min_reward=0.0)
    wrapped.reset(seed=0)
    assert (wrapped.action_space.high == 2.0).all()
    obs, rewards, *_ = wrapped.step(wrapped.action_space.sample())
    assert obs.shape == envs.observation_space.shape and (rewards == 0.0).all()


@pytest.mark.jit
def test_a_state_with_shared_buffers_can_be_drawn():
    """Warp's data has leaves without an axis of environments."""
    data = SimpleNamespace(qpos=np.eye(3), qvel=2 * np.eye(3), nacon=np.zeros(1))
    batch = SimpleNamespace(data=data, task={"a": np.arange(3)}, episode={"b": np.arange(3)})
    one = drawn_of(drawable(batch), 2)
    assert (one.task["a"], one.episode["b"]) == (2, 2)
    assert one.data.qpos.tolist() == [0, 0, 1] and one.data.qvel.tolist() == [0, 0, 2]


def test_the_cores_are_counted_where_the_system_does_not_tell(monkeypatch):
    assert available_cores() >= 1
    monkeypatch.delattr(os, "sched_getaffinity", raising=False)  # macOS, Windows
    assert available_cores() == os.cpu_count()


def test_pictures_show_each_person(envs, raycast):
    envs.reset(seed=0)
    pictures = envs.render()
    assert len(pictures) == B and all(x.shape == (48, 64, 3) for x in pictures)
    assert not np.array_equal(pictures[0], pictures[1])


@pytest.mark.jit
def test_people_of_every_size_and_what_is_compiled_is_shared(envs):
    assert gymnasium.make_vec(NAME, num_envs=B, impl="native")._programs is envs._programs
    other = gymnasium.make_vec(NAME, num_envs=B, impl="native", humans=Population("continuous"))
    other.reset(seed=0)
    envs.reset(seed=0)
    assert len(np.unique(other.state.episode.human.stature)) == B
    assert len(np.unique(envs.state.episode.human.stature)) == 1


@pytest.mark.parametrize(
    ("call", "error", "told"),
    [
        (lambda e: e.reset(seed=[1, 2]), ArgumentError, "one seed or 3, got 2"),
        (lambda e: e.reset(options={"x": 1}), AgymError, "no reset options, got: x"),
        (lambda e: e.step(np.full((B, 7), np.nan)), ActionError, "NaN"),
        (lambda e: gymnasium.make_vec(NAME, num_envs=0), ArgumentError, "num_envs"),
        (lambda e: gymnasium.make_vec(NAME, num_envs=2, impl="mjx"), ImplementationError, "native"),
        (lambda e: gymnasium.make_vec(NAME, num_envs=2, humans=3), ArgumentError, "Population"),
        (lambda e: GymnasiumVectorEnv(NAME, 2, impl="native").step(np.zeros((2, 7))),
         gymnasium.error.ResetNeeded, "reset"),
    ],
)  # fmt: skip
def test_bad_input(envs, call, error, told):
    with pytest.raises(error, match=told):
        call(envs)


def test_actions_of_another_shape(envs):
    envs.reset(seed=0)
    with pytest.raises(ActionError, match=r"shape \(3, 7\), got \(7,\)"):
        envs.step(np.zeros(7))


@pytest.mark.jit
def test_gymnasiums_own_loop_over_environments_works_too():
    sync = gymnasium.make_vec(NAME, num_envs=2, vectorization_mode="sync", impl="native")
    assert sync.reset(seed=0)[0].shape[0] == 2
    sync.close()


def run_async(tmp_path, kwargs: str) -> subprocess.CompletedProcess:
    program = tmp_path / "program.py"
    program.write_text(ASYNC.replace("KWARGS", kwargs))
    env = {**os.environ, "PYTHONPATH": str(ROOT), "JAX_PLATFORMS": "cpu"}
    return subprocess.run(
        [sys.executable, "-W", "ignore", program],
        capture_output=True,
        text=True,
        timeout=120,
        env=env,
    )


@pytest.mark.slow
def test_forked_processes_are_refused_with_what_to_use_instead(tmp_path):
    done = run_async(tmp_path, "{'context': 'fork'}")
    assert done.returncode != 0 and "ForkedProcessError" in done.stderr
    assert "gymnasium.make_vec(id, num_envs=64)" in done.stderr and "'spawn'" in done.stderr


@pytest.mark.slow
def test_new_processes_work(tmp_path):
    done = run_async(tmp_path, "{'context': 'spawn'}")
    assert done.returncode == 0 and done.stdout.startswith("(2, "), done.stderr
