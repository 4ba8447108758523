# ruff: noqa: D103
"""Memory: averages of what agents observe, appended to their observations."""

from __future__ import annotations

import dataclasses
import json
import re
from pathlib import Path
from typing import Any

import gymnasium
import jax
import numpy as np
import pytest

import agym_jax
from agym_jax import __main__ as cli
from agym_jax import observe
from agym_jax.adapters.brax import wrap_for_brax_training
from agym_jax.adapters.pettingzoo import PettingZooEnv
from agym_jax.changes import arguments_of, flags_of
from agym_jax.errors import ArgumentError, PolicyEnvironmentError, PolicyNotFoundError
from agym_jax.memory import checked_memory, with_memory
from agym_jax.policy import load_policy, save_policy
from agym_jax.policy.export import choose_policy
from agym_jax.policy.files import find_policies
from agym_jax.policy.policy import shipped
from agym_jax.tasks import TASKS
from agym_jax.wrappers import vectorize
from benchmarks import in_assistive_gym
from train import evaluate

PAIR, ALONE = "ReachingSawyerHuman-v0", "ReachingSawyer-v0"
TIMES = (0.3, 4.0)
KEY = jax.random.key(3)


def make(name: str = PAIR, **options: Any) -> agym_jax.Env:
    return agym_jax.make(name, impl="native", **options)


@pytest.fixture(scope="module")
def episode() -> tuple[agym_jax.Env, list[Any]]:
    """A pair's environment, and two of them over an end of their first episodes."""
    env = make(memory=TIMES, episode_length=6)
    batch = vectorize(env, 2)
    states = [batch.reset(KEY)]
    rng = np.random.default_rng(0)
    for _ in range(8):
        states.append(batch.step(states[-1], rng.uniform(-1, 1, (2, env.action_size))))
    return env, states


def split(env: agym_jax.Env, obs: np.ndarray) -> dict[str, np.ndarray]:
    """What each agent observes now and its averages (..., 1 + averages, n_obs)."""
    edges = np.cumsum(list(env.observation_sizes.values()))[:-1]
    parts = np.split(np.asarray(obs), edges, -1)
    shape = (1 + len(env.memory), -1)
    return {
        agent: part.reshape(*part.shape[:-1], *shape)
        for agent, part in zip(env.observation_sizes, parts, strict=True)
    }


@pytest.mark.parametrize("agent", ["robot", "human"])
def test_averages_forget_with_their_time_constants(episode, agent):
    env, states = episode
    seen = [split(env, s.info["final_observation"])[agent] for s in states[1:7]]
    first = split(env, states[0].obs)[agent]
    expected = np.repeat(first[:, :1], 2, 1)
    np.testing.assert_array_equal(first[:, 1:], expected)
    for now in seen:
        expected = expected + 0.1 / np.array(TIMES)[:, None] * (now[:, :1] - expected)
        np.testing.assert_allclose(now[:, 1:], expected, rtol=1e-4, atol=1e-5)
    moved = abs(seen[-1] - seen[-1][:, :1]).max((0, 2))
    assert moved[0] == 0 < moved[1] < moved[2]  # the longer one lags behind more


def test_an_episode_does_not_remember_the_last_one(episode):
    env, states = episode
    assert (np.asarray(states[6].done) == 1).all()
    for now in split(env, states[6].obs).values():
        np.testing.assert_array_equal(now[:, 1:], np.repeat(now[:, :1], 2, 1))
    for last in split(env, states[6].info["final_observation"]).values():
        assert (last[:, 1] != last[:, 0]).any()
    assert any((now[:, 1] != now[:, 0]).any() for now in split(env, states[7].obs).values())


def test_a_single_environment_remembers_as_one_of_a_batch(episode):
    env, states = episode
    key = jax.random.split(KEY, 2)[0]
    state, rng = env.reset(key), np.random.default_rng(0)
    for at in states[1:5]:
        state = env.step(state, rng.uniform(-1, 1, (2, env.action_size))[0].astype(np.float32))
        np.testing.assert_allclose(state.obs, at.obs[0], atol=1e-5)


def test_without_memory_nothing_is_added():
    env = make()
    assert env.memory == () and env.changes == {}
    task = TASKS["Reaching"]
    assert env.observation_size == observe.size(task.robot_obs) + observe.size(task.human_obs)
    assert env.layout_version == observe.layout_version(task.robot_obs, task.human_obs)
    assert env.reset(KEY).past.averages is None


@pytest.mark.parametrize("name", sorted(TASKS))
def test_each_column_is_followed_by_its_averages(name):
    record = TASKS[name].robot_obs
    plain, remembering = observe.columns(record), observe.columns(with_memory(record, TIMES))
    names = [f"{x}{over}" for over in ("", "_mean_300ms", "_mean_4000ms") for x in plain]
    assert list(remembering) == names
    for column, whole in zip(names, remembering.values(), strict=True):
        now = plain[column.partition("_mean_")[0]] if "_mean_" in column else plain[column]
        assert (whole.size, whole.unit, whole.source) == (now.size, now.unit, now.source)


@pytest.mark.parametrize("impl", ["jax", "native"])
def test_shapes_are_those_that_the_environment_states(impl):
    env = agym_jax.make("ScratchItchJacoHuman-v0", impl=impl, memory=(1.0,))
    assert env.observation_sizes == {"robot": 60, "human": 68}
    if impl == "jax":
        state = jax.eval_shape(env.reset, KEY)
        after = jax.eval_shape(env.step, state, np.zeros(env.action_size, np.float32))
        assert jax.tree.structure(state) == jax.tree.structure(after)
        assert state.obs.shape == after.obs.shape == (128,)


@pytest.mark.parametrize(
    "memory", ["4", 4.0, (0.0,), (-1.0,), (0.1,), (float("nan"),), (float("inf"),), (1.0, 1.0), (1.0, 1.0003), (True,), ("4",)]
)  # fmt: skip
def test_what_is_no_memory_is_refused(memory):
    with pytest.raises(ArgumentError, match="memory must be a tuple of different time constants"):
        make(memory=memory)


def test_the_order_of_time_constants_does_not_matter():
    assert checked_memory([4, 0.3], 0.1) == checked_memory((0.3, 4.0), 0.1) == TIMES
    assert checked_memory(None, 0.1) == ()


def test_the_memory_is_a_setting_that_can_be_made_again():
    env = make(ALONE, memory=TIMES)
    assert env.changes == {"memory": [0.3, 4.0]} and flags_of(env.changes) == "--memory 0.3 4.0"
    again = make(ALONE, **arguments_of(env.changes))
    assert again.memory == TIMES and again.layout_version == env.layout_version
    assert env.layout_version != make(ALONE, memory=(4.0,)).layout_version
    one: Any = gymnasium.make(ALONE, memory=TIMES)
    assert one.observation_space.shape == (63,)
    assert one.reset(seed=0)[0].shape == (63,)


def test_a_policy_needs_the_memory_that_it_was_trained_with(tmp_path):
    plain = load_policy(ALONE)
    with pytest.raises(
        PolicyEnvironmentError, match=r"has no memory.* Make the environment without"
    ):
        load_policy("assets/policies/ReachingSawyer-v0.npz", make(ALONE, memory=TIMES))
    info = {**plain.info, "changes": {"memory": [0.3, 4.0]}}
    path = save_policy(tmp_path / "p.npz", dataclasses.replace(plain, info=info))
    with pytest.raises(PolicyEnvironmentError, match=r"--memory 0.3 4 .*memory=\(0.3, 4.0\)\)"):
        load_policy(path, make(ALONE))


@pytest.mark.parametrize("name", shipped(memory=True))
def test_what_ships_with_a_memory_is_used_where_the_environment_has_it(name):
    env, plain = make(name, memory=TIMES), make(name)
    policy, without = agym_jax.load_policy(name, env), agym_jax.load_policy(name, plain)
    meant = policy.info.get("meant_for", policy.info["changes"])
    assert meant == {"memory": list(TIMES)} and "memory" not in without.info["changes"]
    assert policy.arch.observation_size == 3 * without.arch.observation_size
    assert find_policies(name, memory=TIMES).robot.endswith(f"policies/memory/{name}.npz")
    state = jax.eval_shape(agym_jax.make(name, impl="jax", memory=TIMES).reset, KEY)
    assert jax.eval_shape(policy, state.obs).shape == (env.action_size,)


def test_commands_take_the_memory_from_the_policy(tmp_path, capsys):
    words = ["--env-name", "BedBathingJaco-v0", "--num-episodes", "1", "--impl", "native"]
    words += ["--episode-length", "2", "--json", str(tmp_path / "line.jsonl")]
    file = str(find_policies("BedBathingJaco-v0", memory=TIMES).robot)
    assert evaluate.main([*words, "--policy", file]) == 0
    line = json.loads((tmp_path / "line.jsonl").read_text())
    assert line["changes"] == {"memory": list(TIMES), "episode_length": 2}
    assert evaluate.main([*words, "--policy", file, "--memory", "2"]) == 2
    assert "Make the environment with --memory 0.3 4 " in capsys.readouterr().err
    assert cli.main(["observe", "BedBathingJaco-v0", "--memory", "0.3", "4"]) == 0
    assert "tool_force_mean_4000ms" in capsys.readouterr().out
    assert cli.main(["observe", "BedBathingJaco-v0", "--memory", "0"]) == 2
    assert choose_policy("BedBathingJaco-v0", memory=TIMES) == Path(file)


def test_where_no_policy_with_a_memory_ships_that_is_said():
    with pytest.raises(
        PolicyNotFoundError,
        match=r"the memory \(0.3, 4.0\) for .*Without a memory, one does.*--memory 0.3 4$",
    ):
        agym_jax.load_policy(ALONE, make(ALONE, memory=TIMES))
    with pytest.raises(
        PolicyNotFoundError, match=r"With \(0.3, 4.0\), policies ship for BedBathing"
    ):
        agym_jax.load_policy("BedBathingJaco-v0", make("BedBathingJaco-v0", memory=(2.0,)))


def test_in_assistive_gym_a_policy_is_shown_the_same_averages(episode):
    env, states = episode
    remember = in_assistive_gym.Memory(TIMES)
    n = env.observation_sizes["robot"]
    seen = [states[0].obs, *(s.info["final_observation"] for s in states[1:7])]
    for obs in (np.asarray(x)[0, :n] for x in seen):
        np.testing.assert_allclose(remember(obs[: n // 3]), obs, rtol=1e-4, atol=1e-5)
    assert in_assistive_gym.Memory(())(np.arange(3.0)).tolist() == [0.0, 1.0, 2.0]


def test_the_page_computes_the_same_averages():
    (code,) = re.findall(
        r"```python\n(import numpy.*?)```", Path("docs/memory.md").read_text(), re.S
    )
    known: dict[str, Any] = {}
    exec(code, known)
    theirs, ours = known["Memory"](TIMES), in_assistive_gym.Memory(TIMES)
    for obs in np.random.default_rng(1).normal(size=(5, 4)):
        np.testing.assert_allclose(theirs(obs), ours(obs), rtol=1e-12)


@pytest.mark.slow
def test_adapters_have_it_too():
    pair = PettingZooEnv(PAIR, impl="native", memory=TIMES)
    assert {x: pair.observation_space(x).shape for x in pair.agents or pair.possible_agents} == {
        "robot": (63,), "human": (57,)
    }  # fmt: skip
    env = wrap_for_brax_training(agym_jax.make(ALONE, impl="jax", memory=TIMES))
    state = jax.eval_shape(env.reset, jax.random.split(KEY, 2))
    after = jax.eval_shape(env.step, state, np.zeros((2, env.action_size), np.float32))
    assert after.obs.shape == (2, 63)
