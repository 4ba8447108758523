"""The PPO learner of one agent: state, loss, and what one update does with one rollout.

Everything here is pure. An update is generalised advantage estimation with the values of before
it, and ``ppo_epoch`` passes of mini-batch gradient steps. Where several devices share the environments
(``axis``), each has a part of the batch; gradients and statistics are those of all of it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import optax
from brax.training.acme import running_statistics
from brax.training.agents.ppo.losses import PPONetworkParams

from agym_jax.jax_settings import full_precision
from agym_jax.policy.networks import STD_MIN, Architecture, init_policy, make_networks

from ..configs import LearnConfig
from .advantage import compute_gae, values_of
from .rollout import Batch, strong_types

REWARD_CLIP = 10.0  # normalised rewards are clipped here, as in Assistive Gym
LOSSES = ("policy_loss", "value_loss", "entropy", "kl", "clip_fraction", "noise_std")


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class LearnerState:
    """All that learning needs to go on; exactly this is saved in a checkpoint."""

    params: PPONetworkParams
    optimizer: optax.OptState
    normalizer: running_statistics.RunningStatisticsState  # of the observation
    returns: running_statistics.RunningStatisticsState  # of the discounted return
    key: jax.Array
    env_steps: jax.Array  # environment steps so far; the learning rate follows it    ()
    updates: jax.Array  # updates so far    ()
    value_normalizer: Any = None  # of what the value function reads; None where that is the same


def architecture(config: LearnConfig, observation_size: int, action_size: int) -> Architecture:
    """The networks that a configuration asks for."""
    return Architecture(
        observation_size=observation_size,
        action_size=action_size,
        policy_hidden=tuple(config.policy_hidden),
        value_hidden=tuple(config.value_hidden),
        activation=config.activation,
        distribution=config.distribution,
        init_noise_std=config.init_noise_std,
        policy_head_gain=config.policy_head_gain,
    )


def make_optimizer(config: LearnConfig) -> optax.GradientTransformation:
    """Gradient clipping and Adam, without the learning rate."""
    return optax.chain(
        optax.clip_by_global_norm(config.max_grad_norm), optax.scale_by_adam(eps=config.eps)
    )


def init_learner(
    config: LearnConfig, arch: Architecture, key: jax.Array, value_size: int | None = None
) -> LearnerState:
    """A learner that has seen nothing.

    Args:
        config: settings.
        arch: networks.
        key: random key.
        value_size: size of what the value function reads; None if it reads what the policy reads.
    """
    networks = make_networks(arch, value_size)
    key_policy, key_value, key = jax.random.split(key, 3)
    params: Any = PPONetworkParams(
        policy=init_policy(networks, arch, key_policy),
        value=networks.value_network.init(key_value),
    )
    learner = LearnerState(
        params=params,
        optimizer=make_optimizer(config).init(params),
        normalizer=running_statistics.init_state(jnp.zeros(arch.observation_size)),
        returns=running_statistics.init_state(jnp.zeros(())),
        key=key,
        env_steps=jnp.zeros((), jnp.uint32),
        updates=jnp.zeros((), jnp.int32),
        value_normalizer=None
        if value_size is None
        else running_statistics.init_state(jnp.zeros(value_size)),
    )
    return strong_types(learner)


def ppo_loss(
    params: PPONetworkParams,
    normalizer: Any,
    data: dict[str, jax.Array],
    key: jax.Array,
    config: LearnConfig,
    networks: Any,
    entropy_coef: float | jax.Array,
    value_normalizer: Any = None,
) -> tuple[jax.Array, dict[str, jax.Array]]:
    """Clipped surrogate, (clipped) value loss and entropy bonus of one mini-batch.

    Args:
        params: parameters to differentiate.
        normalizer: observation statistics the data were collected with.
        data: ``obs, raw_action, log_prob, advantage, value, target``, each (N, ...), and
            ``value_obs`` where there is a ``value_normalizer``.
        key: random key (the entropy of a squashed Gaussian is sampled).
        config: settings.
        networks: from ``make_networks``.
        entropy_coef: weight of the entropy, now.
        value_normalizer: statistics of ``value_obs``; None if the value function reads ``obs``.

    Returns:
        The loss, and the scalars named in ``LOSSES``.
    """
    distribution = networks.parametric_action_distribution
    logits = networks.policy_network.apply(normalizer, params.policy, data["obs"])
    log_ratio = distribution.log_prob(logits, data["raw_action"]) - data["log_prob"]
    ratio = jnp.exp(log_ratio)
    clipped = jnp.clip(ratio, 1 - config.clip_param, 1 + config.clip_param)
    advantage = data["advantage"]
    policy_loss = -jnp.mean(jnp.minimum(ratio * advantage, clipped * advantage))

    seen = (normalizer, data["obs"])
    if value_normalizer is not None:
        seen = (value_normalizer, data["value_obs"])
    value = networks.value_network.apply(seen[0], params.value, seen[1])
    error = (value - data["target"]) ** 2
    if config.clip_value_loss:
        change = jnp.clip(value - data["value"], -config.clip_param, config.clip_param)
        error = jnp.maximum(error, (data["value"] + change - data["target"]) ** 2)
    value_loss = 0.5 * jnp.mean(error)

    entropy = jnp.mean(distribution.entropy(logits, key))
    loss = policy_loss + config.value_loss_coef * value_loss - entropy_coef * entropy
    scalars = {
        "policy_loss": policy_loss,
        "value_loss": value_loss,
        "entropy": entropy,
        "kl": jnp.mean(ratio - 1 - log_ratio),
        "clip_fraction": jnp.mean(jnp.abs(ratio - 1) > config.clip_param),
        "noise_std": jnp.mean(distribution.create_dist(logits).scale),
    }
    return loss, scalars


def batch_steps(batch: Batch, axis: str | None) -> int:
    """Environment steps of a rollout, those of the other devices included."""
    return batch.reward.size * (1 if axis is None else jax.lax.axis_size(axis))


@full_precision
def learn(
    learner: LearnerState,
    batch: Batch,
    last_obs: jax.Array,
    key: jax.Array,
    config: LearnConfig,
    networks: Any,
    total_steps: jax.Array,
    axis: str | None = None,
) -> tuple[LearnerState, dict[str, jax.Array]]:
    """One update from one rollout.

    Args:
        learner: state before.
        batch: rollout of (T, B).
        last_obs: what the value function reads after it    (B, observation).
        key: random key.
        config: settings.
        networks: from ``make_networks``.
        total_steps: environment steps at which what fades has faded, float32    ().
        axis: name of the axis of devices that each have a part of the batch.

    Returns:
        State after (``key`` untouched) and the mean of each of ``LOSSES``.
    """

    def mean(tree: Any) -> Any:
        return tree if axis is None else jax.lax.pmean(tree, axis)

    stats_returns, reward = learner.returns, batch.reward
    if config.normalize_reward:
        stats_returns = running_statistics.update(
            stats_returns, batch.discounted, pmap_axis_name=axis
        )
        spread: Any = stats_returns.std
        std = jnp.sqrt(spread**2 + 1e-8)
        reward = jnp.clip(reward / std, -REWARD_CLIP, REWARD_CLIP)

    statistics = learner.value_normalizer or learner.normalizer

    def value_fn(obs: jax.Array) -> jax.Array:
        return networks.value_network.apply(statistics, learner.params.value, obs)

    value_obs = batch.obs if batch.value_obs is None else batch.value_obs
    values, next_values = values_of(value_fn, replace(batch, obs=value_obs), last_obs)
    advantage = compute_gae(
        reward, values, next_values, batch.done, config.gamma, config.gae_lambda
    )
    centred = advantage - mean(advantage.mean())
    data = {
        "obs": batch.obs,
        "raw_action": batch.raw_action,
        "log_prob": batch.log_prob,
        "value": values,
        "target": advantage + values,
        "advantage": centred / (jnp.sqrt(mean(jnp.mean(centred**2))) + 1e-5),
    }
    if batch.value_obs is not None:
        data["value_obs"] = batch.value_obs
    size = reward.size
    data = {name: leaf.reshape(size, *leaf.shape[2:]) for name, leaf in data.items()}
    optimizer = make_optimizer(config)
    progress = learner.env_steps.astype(jnp.float32) / total_steps
    left = jnp.maximum(0.0, 1.0 - progress)
    rate = config.lr * (left if config.use_linear_lr_decay else 1.0)
    entropy_coef = jnp.float32(config.entropy_coef)
    if config.entropy_decay_share:
        entropy_coef *= jnp.maximum(0.0, 1.0 - progress / config.entropy_decay_share)
    gradient = jax.grad(ppo_loss, has_aux=True)

    def step(carry: tuple, item: tuple) -> tuple[tuple, dict[str, jax.Array]]:
        params, state = carry
        rows, key = item
        part = {name: leaf[rows] for name, leaf in data.items()}
        grads, scalars = gradient(
            params, learner.normalizer, part, key, config, networks, entropy_coef,
            learner.value_normalizer,
        )  # fmt: skip
        changes, state = optimizer.update(mean(grads), state)
        params = jax.tree.map(lambda p, c: p - rate * c, params, changes)
        return (params, state), scalars

    def epoch(carry: tuple, key: jax.Array) -> tuple[tuple, dict[str, jax.Array]]:
        key_order, key_steps = jax.random.split(key)
        order = jax.random.permutation(key_order, size).reshape(config.num_mini_batch, -1)
        return jax.lax.scan(step, carry, (order, jax.random.split(key_steps, len(order))))

    (params, state), scalars = jax.lax.scan(
        epoch, (learner.params, learner.optimizer), jax.random.split(key, config.ppo_epoch)
    )
    normalizer, value_normalizer = learner.normalizer, learner.value_normalizer
    if config.normalize_observations:
        update = partial(running_statistics.update, std_min_value=STD_MIN, pmap_axis_name=axis)
        normalizer = update(normalizer, batch.obs)
        value_normalizer = value_normalizer and update(value_normalizer, batch.value_obs)
    learner = replace(
        learner,
        params=params,
        optimizer=state,
        normalizer=normalizer,
        returns=stats_returns,
        env_steps=learner.env_steps + jnp.uint32(batch_steps(batch, axis)),
        updates=learner.updates + 1,
        value_normalizer=value_normalizer,
    )
    return learner, mean({name: jnp.mean(value) for name, value in scalars.items()})
