# ruff: noqa: D103
"""Brax's trainers and wrappers on these environments: new humans, time limits, metrics, and what is refused."""

from __future__ import annotations

import dataclasses
from functools import partial
from types import SimpleNamespace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from brax.envs.wrappers import training as brax_wrappers
from brax.training.agents.ppo import networks as ppo_networks
from brax.training.agents.ppo import train as ppo
from brax.training.agents.sac import train as sac
from guess_env import GuessEnv

import agym_jax
from agym_jax.adapters.brax import wrap_for_brax_training
from agym_jax.errors import ActionError, WrapperError
from agym_jax.wrappers import vectorize

BATCH = 3
LENGTH = GuessEnv.episode_length


def _keys(seed: int = 0, count: int = BATCH) -> jax.Array:
    return jax.random.split(jax.random.PRNGKey(seed), count)


def _play(env: Any, steps: int, keys: jax.Array | None = None, action: float = 0.0) -> list:
    """States from reset on, with the same action all the time; NumPy."""
    reset, step = jax.jit(env.reset), jax.jit(env.step)
    states = [reset(_keys() if keys is None else keys)]
    for _ in range(steps):
        states.append(step(states[-1], jnp.full((BATCH, 1), action)))
    return jax.device_get(states)


def _humans(states: list) -> np.ndarray:
    return np.stack([state.episode.human for state in states])


# -- episodes ----------------------------------------------------------------------------------


@pytest.mark.parametrize(("asked", "length"), [(LENGTH, LENGTH), (4, 4), (1000, LENGTH)])
def test_an_episode_is_cut_by_its_length_and_followed_by_another_human(asked: int, length: int):
    states = _play(wrap_for_brax_training(GuessEnv(), episode_length=asked), 2 * length + 1)
    ends = np.arange(1, 2 * length + 2) % length == 0
    for name in ("truncation", "episode_done"):
        told = np.stack([state.info[name] for state in states[1:]])
        np.testing.assert_array_equal(told, np.repeat(ends[:, None], BATCH, 1))
    np.testing.assert_array_equal([state.done[0] for state in states[1:]], ends)
    steps = [state.info["steps"][0] for state in states]
    assert steps == [0, *range(1, length + 1), *range(1, length + 1), 1]

    humans = _humans(states)
    changed = humans[1:] != humans[:-1]  # in the state that ends an episode, the next one has begun
    np.testing.assert_array_equal(changed, np.repeat(ends[:, None], BATCH, 1))
    assert len(np.unique(humans)) == 3 * BATCH
    np.testing.assert_allclose([s.obs[:, 0] for s in states], humans)


def test_a_simulation_that_diverges_truncates_the_episode():
    states = _play(wrap_for_brax_training(GuessEnv(fail_at=2)), 4)
    assert [state.done[0] for state in states] == [0, 0, 1, 0, 1]
    assert [state.info["truncation"][0] for state in states] == [0, 0, 1, 0, 1]
    assert [state.metrics["nan"][0] for state in states] == [0, 0, 1, 0, 1]


def test_time_limits_can_be_told_as_brax_bootstraps_from_them():
    env = wrap_for_brax_training(GuessEnv(), bootstrap_on_timeout=True)
    states = _play(env, LENGTH)
    assert [state.info["time_out"][0] for state in states] == [0] * LENGTH + [1]
    assert not any(state.info["truncation"].any() for state in states)


def test_repeated_actions_are_one_step_with_the_sum_of_the_rewards():
    single = _play(wrap_for_brax_training(GuessEnv()), LENGTH, action=0.3)
    double = _play(wrap_for_brax_training(GuessEnv(), action_repeat=2), LENGTH // 2, action=0.3)
    rewards = np.stack([state.reward for state in single[1:]])
    np.testing.assert_allclose(
        [state.reward for state in double[1:]], rewards[::2] + rewards[1::2], rtol=1e-6
    )
    assert [state.info["steps"][0] for state in double] == [0, 2, 4, 6]
    assert [state.done[0] for state in double] == [0, 0, 0, 1]
    for name, total in single[-1].info["episode_metrics"].items():
        np.testing.assert_allclose(double[-1].info["episode_metrics"][name], total, rtol=1e-6)


def test_nothing_counts_after_a_failure_between_repeated_actions():
    states = _play(wrap_for_brax_training(GuessEnv(fail_at=1), action_repeat=2), 1, action=0.3)
    np.testing.assert_allclose(states[1].reward, -((0.3 - states[0].episode.human) ** 2), rtol=1e-5)
    assert states[1].done.all() and states[1].info["truncation"].all()
    assert (states[1].metrics["nan"] == 1).all()


# -- metrics -----------------------------------------------------------------------------------


def test_brax_sums_metrics_to_what_an_episode_achieved():
    env = brax_wrappers.EvalWrapper(wrap_for_brax_training(GuessEnv()))
    states = _play(env, LENGTH + 2, action=0.1)
    error = (0.1 - states[0].episode.human) ** 2
    found = states[-1].info["eval_metrics"]
    np.testing.assert_array_equal(found.active_episodes, 0)
    np.testing.assert_array_equal(found.episode_steps, LENGTH)
    sums = found.episode_metrics
    np.testing.assert_allclose(sums["reward"], -LENGTH * error, rtol=1e-5)
    np.testing.assert_allclose(sums["reward/guess"], sums["reward"], rtol=1e-5)
    np.testing.assert_array_equal(sums["success"], error < 0.1)
    assert 0 < sums["success"].sum() < BATCH
    mean = sums["force/on_human_per_step"] / found.episode_steps
    np.testing.assert_allclose(mean, (LENGTH + 1) / 2)


def test_totals_of_an_episode_stand_where_it_ends():
    states = _play(wrap_for_brax_training(GuessEnv()), 2 * LENGTH)
    rewards = np.stack([state.reward for state in states[1:]])
    for episode in (0, 1):
        totals = states[(episode + 1) * LENGTH].info["episode_metrics"]
        own = rewards[episode * LENGTH : (episode + 1) * LENGTH].sum(0)
        np.testing.assert_allclose(totals["sum_reward"], own, rtol=1e-5)
        np.testing.assert_array_equal(totals["length"], LENGTH)
        np.testing.assert_allclose(totals["force/on_human_per_step"], LENGTH * (LENGTH + 1) / 2)


# -- keys, shapes ------------------------------------------------------------------------------


def test_typed_keys_make_the_same_episodes_as_raw_keys():
    typed = jax.random.split(jax.random.key(0), BATCH)
    raw = _play(wrap_for_brax_training(GuessEnv()), LENGTH)
    states = _play(wrap_for_brax_training(GuessEnv()), LENGTH, keys=typed)
    np.testing.assert_array_equal(_humans(states), _humans(raw))
    assert states[0].info["steps"].shape == (BATCH,)


@pytest.mark.parametrize("make_key", [jax.random.PRNGKey, jax.random.key])
def test_a_single_key_is_refused(make_key: Any):
    with pytest.raises(WrapperError, match=r"jax\.random\.split"):
        wrap_for_brax_training(GuessEnv()).reset(make_key(0))


def test_actions_of_another_shape_are_refused():
    env = wrap_for_brax_training(GuessEnv())
    with pytest.raises(ActionError, match=r"\(3, 1\), got \(3, 2\)"):
        env.step(env.reset(_keys()), jnp.zeros((BATCH, 2)))


@pytest.mark.slow
@pytest.mark.jit
def test_an_environment_steps_to_what_it_was_reset_to(static_env):
    env = brax_wrappers.EvalWrapper(wrap_for_brax_training(static_env))
    first = jax.eval_shape(env.reset, _keys())
    action = jax.ShapeDtypeStruct((BATCH, env.action_size), jnp.float32)
    second = jax.eval_shape(env.step, first, action)
    assert jax.tree.structure(first) == jax.tree.structure(second)
    assert jax.tree.leaves(first) == jax.tree.leaves(second)  # shapes, types, weak types
    assert env.observation_size == first.obs.shape[1] and env.unwrapped is static_env
    named = {"success", "nan", "overflow", "force/tool_on_human_per_step", "reward"}
    assert named <= set(second.metrics)


# -- refusals ----------------------------------------------------------------------------------


def test_what_is_wrapped_already_is_refused(static_env):
    for env in (
        wrap_for_brax_training(static_env),
        vectorize(static_env, 2),
        brax_wrappers.VmapWrapper(static_env),
    ):
        with pytest.raises(WrapperError, match=rf"got a {type(env).__name__}"):
            wrap_for_brax_training(env)


def test_an_environment_that_cannot_be_compiled_is_refused():
    with pytest.raises(WrapperError, match=r"impl='native'.*impl='jax'"):
        wrap_for_brax_training(GuessEnv(impl="native"))


@pytest.mark.parametrize("repeat", [0, 4, 7])
def test_an_action_repeat_that_does_not_fit_is_refused(repeat: int):
    with pytest.raises(WrapperError, match="multiple of action_repeat"):
        wrap_for_brax_training(GuessEnv(), action_repeat=repeat)


def test_randomized_models_are_refused_by_name(static_env):
    change = lambda sys, rng=None: (sys, sys)  # noqa: E731
    for wrap in (wrap_for_brax_training, brax_wrappers.wrap):
        with pytest.raises(WrapperError, match=r"DomainRandomizationVmapWrapper.*Population"):
            wrap(static_env, randomization_fn=change)
    assert not hasattr(static_env, "sys")


# -- Brax's own wrappers -----------------------------------------------------------------------


def test_brax_auto_reset_begins_anew_with_the_same_human_and_says_so():
    env = brax_wrappers.wrap(GuessEnv(), episode_length=LENGTH)
    with pytest.warns(UserWarning, match=r"AutoResetWrapper.*same human.*wrap_for_brax_training"):
        states = _play(env, 2 * LENGTH + 1)
    humans = _humans(states)
    np.testing.assert_array_equal(humans, np.repeat(humans[:1], len(states), 0))
    clock = [state.episode.step[0] for state in states]
    assert clock == [*range(LENGTH), *range(LENGTH), 0, 1]
    assert [state.task[0] for state in states] == clock  # the task begins anew, too
    ends = [float(step % LENGTH == 0) for step in range(1, 2 * LENGTH + 2)]
    assert [state.info["truncation"][0] for state in states[1:]] == ends
    assert [state.done[0] for state in states[1:]] == ends


def test_pipeline_state_is_the_whole_simulation():
    state = GuessEnv().reset(jax.random.PRNGKey(0))
    later = GuessEnv().step(state, jnp.ones(1))
    again = later.replace(pipeline_state=state.pipeline_state)
    assert (again.data, again.task, again.episode) == (state.data, state.task, state.episode)
    assert again.obs is later.obs
    assert state.pipeline_state.qpos is state.data.qpos
    with pytest.raises(AttributeError, match="qacc"):
        _ = state.pipeline_state.qacc
    only_data = later.replace(pipeline_state=state.data)
    assert only_data.data is state.data and only_data.episode is later.episode


def test_brax_auto_reset_is_refused_on_warp_as_it_resets():
    state = GuessEnv().reset(jax.random.PRNGKey(0))
    data = SimpleNamespace(impl=SimpleNamespace(value="warp"))
    inner = SimpleNamespace(reset=lambda rng: state.replace(data=data))
    with pytest.raises(WrapperError, match=r"AutoResetWrapper.*wrap_for_brax_training"):
        brax_wrappers.AutoResetWrapper(inner).reset(_keys())


def test_the_limit_is_the_wrappers_where_brax_counts():
    env = agym_jax.make("ReachingJaco-v0", impl="native")
    state = env.reset(jax.random.PRNGKey(0))
    last = dataclasses.replace(state.episode, step=jnp.int32(env.episode_length - 1))
    state = state.replace(episode=last)
    action = np.zeros(env.action_size)
    assert env.step(state, action).done == 1
    assert env.step(state.replace(info={"steps": jnp.zeros(())}), action).done == 0


# -- training ----------------------------------------------------------------------------------

NETWORKS = partial(
    ppo_networks.make_ppo_networks,
    policy_hidden_layer_sizes=(32, 32),
    value_hidden_layer_sizes=(32, 32),
)


@pytest.mark.slow
def test_brax_ppo_learns():
    seen = {}
    make_policy, params, metrics = ppo.train(
        GuessEnv(),
        num_timesteps=30_000,
        episode_length=LENGTH,
        wrap_env_fn=wrap_for_brax_training,
        num_envs=64,
        num_eval_envs=64,
        unroll_length=5,
        batch_size=16,
        num_minibatches=4,
        num_updates_per_batch=4,
        learning_rate=3e-3,
        num_evals=2,
        deterministic_eval=True,
        network_factory=NETWORKS,
        progress_fn=lambda steps, metrics: seen.update({steps: metrics["eval/episode_success"]}),
    )
    before, after = seen.values()
    assert before < 0.7 < 0.95 < after
    assert metrics["eval/avg_episode_length"] == LENGTH
    obs = jnp.array([[0.5, 0.0], [-0.5, 0.0]])
    action, _ = make_policy(params, deterministic=True)(obs, jax.random.PRNGKey(0))
    assert action[0, 0] > 0.2 and action[1, 0] < -0.2


@pytest.mark.slow
def test_brax_sac_learns():
    _, _, metrics = sac.train(
        GuessEnv(),
        num_timesteps=3_000,
        episode_length=LENGTH,
        wrap_env_fn=wrap_for_brax_training,
        num_envs=16,
        num_eval_envs=64,
        batch_size=64,
        min_replay_size=256,
        grad_updates_per_step=4,
        learning_rate=3e-3,
        reward_scaling=10.0,
        deterministic_eval=True,
    )
    assert metrics["eval/episode_success"] > 0.9
    assert np.isfinite(metrics["training/critic_loss"])
