# ruff: noqa: D103
"""The PettingZoo interface, judged by PettingZoo's own test."""

from __future__ import annotations

import warnings
from collections.abc import Iterator

import gymnasium
import numpy as np
import pytest
from pettingzoo.test import parallel_api_test

from agym_jax.adapters.gymnasium import RenderModeError
from agym_jax.adapters.pettingzoo import PettingZooEnv
from agym_jax.errors import ActionError, SpecError, UnknownNameError

NAME = "ScratchItchJacoHuman-v0"


@pytest.fixture(scope="module")
def env() -> Iterator[PettingZooEnv]:
    env = PettingZooEnv(NAME, render_mode="rgb_array", width=64, height=48)
    yield env
    env.close()


def still(env: PettingZooEnv) -> dict[str, np.ndarray]:
    """Actions that do nothing."""
    return {agent: np.zeros(env.action_space(agent).shape, np.float32) for agent in env.agents}


@pytest.mark.slow
@pytest.mark.jit
def test_pettingzoos_own_test_passes(env):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        parallel_api_test(env, num_cycles=250)  # an episode of 200 steps, and into the next


def test_agents_and_spaces(env):
    # tasks.md section 1.2: robot 30 and 7, person 34 and 10
    assert env.possible_agents == ["robot", "human"]
    spaces = {
        a: (env.observation_space(a).shape, env.action_space(a).shape) for a in env.possible_agents
    }
    assert spaces == {"robot": ((30,), (7,)), "human": ((34,), (10,))}
    assert env.observation_space("robot") is env.observation_space("robot")
    assert env.metadata["name"] == NAME and env.metadata["is_parallelizable"]


@pytest.mark.jit
def test_it_is_the_gymnasium_environment_seen_by_two(env):
    single = gymnasium.make(NAME).unwrapped
    both, _ = single.reset(seed=7)
    obs, infos = env.reset(seed=7)
    assert np.array_equal(np.concatenate([obs["robot"], obs["human"]]), both)
    assert np.array_equal(env.state(), both) and infos.keys() == obs.keys()
    rng = np.random.default_rng(0)
    for _ in range(5):
        actions = {a: rng.uniform(-1, 1, env.action_space(a).shape) for a in env.agents}
        both, reward, *_, info = single.step(np.concatenate(list(actions.values())))
        obs, rewards, terminations, truncations, infos = env.step(actions)
        assert np.array_equal(np.concatenate([obs["robot"], obs["human"]]), both)
        assert rewards == {"robot": reward, "human": reward} and infos["human"] == info
        assert not any((*terminations.values(), *truncations.values()))
    assert infos["robot"] is not infos["human"]


@pytest.mark.jit
def test_an_episode_is_cut_for_both_and_then_needs_a_reset(env):
    env.reset(seed=1)
    for step in range(1, 201):
        *_, terminations, truncations, _ = env.step(still(env))
        assert set(truncations.values()) == {step == 200} and not any(terminations.values())
    assert env.agents == []
    with pytest.raises(gymnasium.error.ResetNeeded, match=r"call reset\(\)"):
        env.step(still(env))
    env.reset()
    assert env.agents == ["robot", "human"]


@pytest.mark.jit
def test_a_picture(env, raycast):
    env.reset(seed=1)
    assert env.render().shape == (48, 64, 3)


@pytest.mark.jit
def test_wrong_actions_are_refused_by_name(env):
    env.reset(seed=1)
    actions = still(env)
    with pytest.raises(ActionError, match="each of robot, human, got actions from: robot"):
        env.step({"robot": actions["robot"]})
    with pytest.raises(ActionError, match="got actions from: robot, human, dog"):
        env.step({**actions, "dog": actions["robot"]})
    with pytest.raises(ActionError, match=rf"The human of {NAME} takes .*\(10,\), got \(7,\)"):
        env.step({**actions, "human": actions["robot"]})
    with pytest.raises(ActionError, match="finite"):
        env.step({**actions, "human": np.full(10, np.nan)})
    with pytest.raises(ActionError, match="nobody"):
        env.step({})


def test_ids_that_have_no_second_agent_or_do_not_exist_are_refused():
    with pytest.raises(SpecError, match=r"only the robot acts.*'ScratchItchJacoHuman-v0'"):
        PettingZooEnv("ScratchItchJaco-v0")
    with pytest.raises(UnknownNameError, match=NAME):
        PettingZooEnv("ScratchItchJackoHuman-v0")
    with pytest.raises(RenderModeError, match="rgb_array"):
        PettingZooEnv(NAME, render_mode="human")


def test_without_an_episode_there_is_no_state():
    fresh = PettingZooEnv(NAME)
    with pytest.raises(gymnasium.error.ResetNeeded):
        fresh.state()
    with pytest.raises(gymnasium.error.ResetNeeded):
        fresh.step({})
