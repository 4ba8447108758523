# ruff: noqa: D103 (a test's name says what it shows)
"""PPO of one agent: advantages, truncation and the loss, against closed forms."""

from __future__ import annotations

import dataclasses
import re

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from brax.training.acme.running_statistics import NestedMeanStd
from brax.training.agents.ppo.losses import compute_gae as brax_gae

from agym_jax.policy.networks import make_networks, sample_action
from train.configs import PPOConfig
from train.learning.ppo import (
    LOSSES,
    Hyper,
    architecture,
    compute_gae,
    init_agent,
    last_observations,
    learn,
    ppo_loss,
    values_of,
)
from train.learning.rollout import Batch

GAMMA, LAMBDA = 0.9, 0.8


def make_batch(obs, reward, done, truncation, final_critic_obs):
    """A batch of one-dimensional observations."""
    arrays = [jnp.asarray(x, jnp.float32) for x in (reward, done, truncation)]
    reward, done, truncation = arrays
    return Batch(
        obs=jnp.asarray(obs, jnp.float32)[..., None],
        raw_action=jnp.zeros((*reward.shape, 1)),
        log_prob=jnp.zeros_like(reward),
        reward=reward,
        discounted=jnp.zeros_like(reward),
        done=done,
        truncation=truncation,
        final_critic_obs=jnp.asarray(final_critic_obs, jnp.float32)[..., None],
        critic_obs=None,
    )


def advantages_of(batch, last_obs, value=lambda obs: obs[..., 0], episode_length=None):
    """Advantages with a value function that reads the observation."""
    last = jnp.asarray(last_obs, jnp.float32)[..., None]
    ends = last_observations(batch, episode_length)
    values, next_values = values_of(value, batch, last, ends)
    return compute_gae(batch.reward, values, next_values, batch.done, GAMMA, GAMMA * LAMBDA)


def test_a_truncation_bootstraps_with_the_value_of_the_true_last_observation():
    # Two environments, three steps; the first is cut off after step 1 at a state worth 7, and the second
    # half of the batch is another episode. The observation is its own value.
    batch = make_batch(
        obs=[[1, 4], [2, 5], [3, 6]],
        reward=[[0.5, 0], [0.25, 0], [1, 2]],
        done=[[0, 0], [1, 0], [0, 0]],
        truncation=[[0, 0], [1, 0], [0, 0]],
        final_critic_obs=[[-99, -99], [7, -99], [-99, -99]],
    )
    advantages = advantages_of(batch, [10, 20])
    a1 = 0.25 + GAMMA * 7 - 2
    a0 = 0.5 + GAMMA * 2 - 1 + GAMMA * LAMBDA * a1
    a2 = 1 + GAMMA * 10 - 3
    b2 = 2 + GAMMA * 20 - 6
    b1 = GAMMA * 6 - 5 + GAMMA * LAMBDA * b2
    b0 = GAMMA * 5 - 4 + GAMMA * LAMBDA * b1
    np.testing.assert_allclose(advantages, [[a0, b0], [a1, b1], [a2, b2]], rtol=1e-6)


def test_a_termination_is_worth_nothing_even_if_its_observation_is_nan():
    batch = make_batch([[1.0]], [[3.0]], [[1.0]], [[0.0]], [[np.nan]])
    np.testing.assert_allclose(advantages_of(batch, [50.0]), [[3.0 - 1.0]])


def test_a_time_limit_does_not_matter_to_a_value_function_that_is_right():
    # Reward 1 for ever is worth 1 / (1 - gamma) everywhere: no step is better than expected,
    # although the episode is cut off in the middle of the batch.
    steps, worth = 12, 1 / (1 - GAMMA)
    cut = np.zeros((steps, 1))
    cut[5] = 1
    same = np.full((steps, 1), worth)
    batch = make_batch(same, np.ones((steps, 1)), cut, cut, same)
    np.testing.assert_allclose(advantages_of(batch, [worth]), 0.0, atol=1e-5)
    # Taken for a termination, the same step costs all that would have come after it.
    ended = dataclasses.replace(batch, truncation=jnp.zeros_like(batch.truncation))
    np.testing.assert_allclose(advantages_of(ended, [worth])[5], -GAMMA * worth, rtol=1e-5)


@pytest.mark.parametrize("length", [None, 20])
def test_a_simulation_that_diverges_is_no_way_out_of_negative_rewards(length):
    # Reward -1 for ever. In steps 2 and 5 the simulation diverges: reward 0, and a new episode begins.
    steps, worth = 12, -1 / (1 - GAMMA)
    failed = np.zeros((steps, 1))
    failed[[2, 5]] = 1  # the second one is more than ``length`` lets expect
    same = np.full((steps, 1), worth)
    batch = make_batch(same, failed - 1.0, failed, failed, same)
    gains = advantages_of(batch, [worth], episode_length=length)
    np.testing.assert_allclose(gains[failed > 0], 1.0, rtol=1e-5)  # the one reward it was spared
    # Taken for a termination, it would be spared all that follows.
    ended = dataclasses.replace(batch, truncation=jnp.zeros_like(batch.truncation))
    np.testing.assert_allclose(advantages_of(ended, [worth])[failed > 0], -worth, rtol=1e-5)


@pytest.mark.parametrize("length", [4, 9, 20])
def test_only_last_observations_of_episodes_are_read(length):
    rng = np.random.default_rng(0)
    steps, envs = 9, 6
    obs, reward, final = rng.normal(size=(3, steps, envs))
    phase = rng.integers(length, size=envs)
    cut = (np.arange(steps)[:, None] + phase) % length == length - 1
    assert cut.sum(0).max() == -(-steps // length)
    failed = (rng.random((steps, envs)) < 0.1) & ~cut
    batch = make_batch(obs, reward, cut | failed, cut, np.where(failed, np.nan, final))
    read = []

    def value(obs):
        read.append(obs.size)
        return jnp.sin(obs[..., 0])

    some = advantages_of(batch, obs[0], value, length)
    np.testing.assert_allclose(some, advantages_of(batch, obs[0], value), rtol=1e-6)
    assert np.isfinite(some).all()
    assert read == [(steps + 1 + -(-steps // length)) * envs, (2 * steps + 1) * envs]


def test_value_targets_agree_with_brax_where_nothing_is_truncated():
    rng = np.random.default_rng(0)
    reward, values = rng.normal(size=(2, 9, 4)).astype(np.float32)
    done = (rng.random((9, 4)) < 0.3).astype(np.float32)
    last = rng.normal(size=4).astype(np.float32)
    zeros = np.zeros_like(done)
    theirs, _ = brax_gae(zeros, done, reward, values, last, LAMBDA, GAMMA)
    batch = make_batch(values, reward, done, zeros, zeros)
    np.testing.assert_allclose(advantages_of(batch, last) + values, theirs, atol=1e-5)


@pytest.mark.parametrize("distribution", ["normal", "tanh_normal"])
def test_the_first_loss_of_an_update_has_ratio_one(distribution):
    config = PPOConfig(distribution=distribution, policy_hidden=(8,), value_hidden=(8,))
    arch = architecture(config, 3, 2)
    networks = make_networks(arch)
    agent, _ = jax.jit(lambda key: init_agent(arch, key))(jax.random.PRNGKey(0))
    obs = jax.random.normal(jax.random.PRNGKey(1), (16, 3))
    action, raw, log_prob = sample_action(
        networks, agent.normalizer, agent.params.policy, obs, jax.random.PRNGKey(2)
    )
    np.testing.assert_array_equal(action, raw if distribution == "normal" else jnp.tanh(raw))
    value = networks.value_network.apply(agent.normalizer, agent.params.value, obs)
    advantage = jnp.linspace(-1.0, 2.0, 16)
    data = {
        "obs": obs,
        "raw_action": raw,
        "log_prob": log_prob,
        "advantage": advantage,
        "value": value,
        "target": value + 3.0,
    }
    hyper = Hyper.of(config, 800)
    loss, scalars = ppo_loss(
        agent.params, agent.normalizer, data, jax.random.PRNGKey(3), hyper, networks, 0.0
    )
    assert set(scalars) == set(LOSSES)
    np.testing.assert_allclose(scalars["policy_loss"], -0.5, atol=1e-5)
    np.testing.assert_allclose(scalars["value_loss"], 0.5 * 9.0, rtol=1e-5)
    np.testing.assert_allclose(scalars["kl"], 0.0, atol=1e-5)
    np.testing.assert_allclose(loss, -0.5 + 0.5 * 4.5, rtol=1e-4)


@pytest.mark.parametrize("normalised", [True, False])
def test_the_value_of_an_observation_is_what_its_layers_make_of_it(normalised):
    config = PPOConfig(value_hidden=(8, 6), activation="relu", value_layer_norm=normalised)
    networks = make_networks(architecture(config, 3, 2), 5)
    rng = np.random.default_rng(0)
    shapes = jax.eval_shape(networks.value_network.init, jax.random.PRNGKey(0))
    weights = jax.tree.map(lambda x: rng.normal(size=x.shape).astype(np.float32), shapes)
    mean, std, obs = rng.normal(size=5), rng.uniform(0.5, 2, 5), rng.normal(size=(4, 5))
    x, layers = (obs - mean) / std, weights["params"]
    for i in range(2):
        x = np.maximum(x @ layers[f"hidden_{i}"]["kernel"] + layers[f"hidden_{i}"]["bias"], 0)
        if normalised:
            x = (x - x.mean(-1, keepdims=True)) / np.sqrt(x.var(-1, keepdims=True) + 1e-6)
            x = x * layers[f"LayerNorm_{i}"]["scale"] + layers[f"LayerNorm_{i}"]["bias"]
    wanted = (x @ layers["hidden_2"]["kernel"] + layers["hidden_2"]["bias"])[:, 0]
    statistics = NestedMeanStd(mean=jnp.asarray(mean), std=jnp.asarray(std))
    value = networks.value_network.apply(statistics, weights, jnp.asarray(obs))
    np.testing.assert_allclose(value, wanted, rtol=1e-4, atol=1e-4)
    assert len(layers) == (5 if normalised else 3)


def test_a_new_agent_has_strong_types_so_that_a_restored_one_needs_no_new_compilation():
    config = PPOConfig(policy_hidden=(8,), value_hidden=(8,))
    arch = architecture(config, 3, 2)
    agent, _ = jax.jit(lambda key: init_agent(arch, key))(jax.random.PRNGKey(0))
    assert not any(leaf.weak_type for leaf in jax.tree.leaves(agent))


def test_the_entropy_bonus_fades_where_it_is_asked_to():
    rows = np.random.default_rng(0).normal(size=(5, 4))
    batch = make_batch(rows, rows, rows * 0, rows * 0, rows)

    config = PPOConfig(policy_hidden=(8,), value_hidden=(8,), num_mini_batch=1, ppo_epoch=2,
                       distribution="normal", use_linear_lr_decay=False)  # fmt: skip
    arch = architecture(config, 1, 1)
    begun, _ = init_agent(arch, jax.random.PRNGKey(1))
    key, last = jax.random.PRNGKey(2), batch.obs[-1]
    updated = jax.jit(
        lambda agent, hyper: learn(agent, batch, last, key, hyper, config, make_networks(arch))
    )

    def after(step: int, **settings):
        agent = dataclasses.replace(begun, env_steps=jnp.uint32(step))
        agent, _ = updated(agent, Hyper.of(dataclasses.replace(config, **settings), 100))
        return jax.tree.leaves(agent.params)

    def same(a, b):
        return all(np.allclose(x, y, atol=1e-7) for x, y in zip(a, b, strict=True))

    half, fades = {"entropy_coef": 0.5}, {"entropy_coef": 1.0, "entropy_decay_share": 1.0}
    assert same(after(0, **fades), after(0, entropy_coef=1.0))
    assert same(after(50, **fades), after(0, **half))
    assert same(after(100, **fades), after(0))
    assert not same(after(0), after(0, **half))
    early = fades | {"entropy_decay_share": 0.4}
    assert same(after(20, **early), after(0, **half)) and same(after(40, **early), after(0))
    assert same(after(70, **early), after(0))


def test_advantages_are_estimated_anew_before_every_pass_where_that_is_asked_for():
    rows = np.random.default_rng(0).normal(size=(5, 4))
    batch = make_batch(rows, rows, rows * 0, rows * 0, rows)

    def after(**settings):
        config = PPOConfig(policy_hidden=(8,), value_hidden=(8,), num_mini_batch=1, lr=0.1,
                           distribution="normal", **settings)  # fmt: skip
        arch = architecture(config, 1, 1)
        agent, _ = init_agent(arch, jax.random.PRNGKey(1))
        agent, _ = learn(agent, batch, batch.obs[-1], jax.random.PRNGKey(2),
                              Hyper.of(config, 100), config, make_networks(arch))  # fmt: skip
        return np.concatenate([x.ravel() for x in jax.tree.leaves(agent.params)])

    once, often = {"ppo_epoch": 1}, {"ppo_epoch": 6}
    same = after(recompute_advantages=True, **once), after(recompute_advantages=False, **once)
    np.testing.assert_allclose(*same, atol=1e-6)  # before the first pass there is nothing new
    other = after(recompute_advantages=True, **often), after(recompute_advantages=False, **often)
    assert np.abs(other[0] - other[1]).max() > 1e-3


def test_only_gradients_are_less_precise_unless_full_precision_is_asked_for():
    rows = np.random.default_rng(0).normal(size=(5, 4))
    batch = make_batch(rows, rows, rows * 0, rows * 0, rows)

    def precisions(**settings):
        config = PPOConfig(policy_hidden=(8,), value_hidden=(8,), num_mini_batch=1, **settings)
        arch = architecture(config, 1, 1)
        agent, _ = init_agent(arch, jax.random.PRNGKey(1))
        traced = jax.make_jaxpr(
            lambda agent: learn(agent, batch, batch.obs[-1], jax.random.PRNGKey(2), Hyper.of(config, 100),
                                config, make_networks(arch))
        )(agent)  # fmt: skip
        found = re.findall(r"precision=\(?(?:Precision\.)?(\w+)", str(traced))
        return {name: found.count(name) for name in set(found)}

    full, fast = precisions(gradient_precision="float32"), precisions()
    assert set(full) == {"HIGHEST"} and set(fast) == {"HIGHEST", "HIGH"}
    assert fast["HIGH"] + fast["HIGHEST"] == full["HIGHEST"]
    assert fast["HIGH"] >= 2 * 2 + 2 * 2 - 2  # two networks of two layers, forwards and backwards
    assert fast["HIGHEST"] >= 2  # values


def test_the_change_of_a_value_is_clipped_where_that_is_asked_for():
    config = PPOConfig(policy_hidden=(8,), value_hidden=(8,), distribution="normal")
    arch = architecture(config, 3, 2)
    agent, _ = init_agent(arch, jax.random.PRNGKey(0))
    obs = jax.random.normal(jax.random.PRNGKey(1), (16, 3))
    networks = make_networks(arch)
    _, raw, log_prob = sample_action(
        networks, agent.normalizer, agent.params.policy, obs, jax.random.PRNGKey(2)
    )
    value = networks.value_network.apply(agent.normalizer, agent.params.value, obs)
    # the value has gone from 1 below to its target: clipped, only clip_param of the way counts
    data = {"obs": obs, "raw_action": raw, "log_prob": log_prob, "advantage": jnp.zeros(16),
            "value": value - 1.0, "target": value}  # fmt: skip

    def value_loss(clips: bool) -> float:
        hyper = Hyper.of(dataclasses.replace(config, clip_value_loss=clips), 800)
        key = jax.random.PRNGKey(3)
        _, scalars = ppo_loss(agent.params, agent.normalizer, data, key, hyper, networks, 0.0)
        return float(scalars["value_loss"])

    assert value_loss(clips=False) == pytest.approx(0.0, abs=1e-6)
    assert value_loss(clips=True) == pytest.approx(0.5 * 0.8**2, rel=1e-4)
