"""PPO of one agent: its state, generalised advantage estimation, the loss, and one update from one rollout.

Everything here is pure. An update makes ``ppo_epoch`` passes of mini-batch gradient steps. Where its batch is large, it
estimates advantages and targets anew before each of them, with the values of then, so that what is known of a
reward travels back by more than one rollout per update (Andrychowicz et al. 2021, "What matters in on-policy
reinforcement learning?"). Where several devices share the environments (``axis``), each has a part of the batch;
gradients and statistics are those of all of it. With a cost limit, what is learned from besides is in ``constraint``.

DEVIATION(time-limit-bootstrap): Assistive Gym's trainer takes the time limit for a terminal state. Its episodes
end by their time limit, which says nothing about what the state is worth, so a truncated step bootstraps here
with the value of the true last observation.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import optax
from brax.training.acme import running_statistics
from brax.training.agents.ppo.losses import PPONetworkParams

from agym_jax.jax_settings import full_precision
from agym_jax.policy.networks import STD_MIN, Architecture, init_policy, make_networks
from agym_jax.state import strong

from ..configs import LearnConfig
from .advantage import compute_gae, last_observations, values_of
from .constraint import (
    ConstraintHyper,
    init_constraint,
    learn_constraint,
    penalised,
)
from .noise import keep_noise
from .optimizer import make_optimizer, moved
from .rollout import Batch

REWARD_CLIP = 10.0  # normalised rewards are clipped here, as in Assistive Gym
LOSSES = ("policy_loss", "value_loss", "entropy", "kl", "clip_fraction", "noise_std")


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Hyper:
    """Hyper-parameters that are arguments of the compiled update, each float32, () or (seeds,): others compile nothing anew."""

    lr: Any
    lr_decays: Any  # 1: the learning rate falls to 0 over the run
    total_steps: Any  # environment steps at which what falls has fallen
    gamma: Any
    gae_discount: Any  # gamma times lambda
    clip_param: Any
    ratio_low: Any  # 1 - clip_param
    ratio_high: Any  # 1 + clip_param
    value_loss_coef: Any
    entropy_coef: Any
    entropy_fade: Any  # 1 over the share of the run in which the entropy bonus fades; 0: it stays
    max_grad_norm: Any
    eps: Any
    reward_scaling: Any
    clip_value_loss: Any  # 1: clip the change of the value prediction too
    recompute_advantages: Any  # 1: before every pass over the data, with the values of then
    learns: Any  # 0: one of several trainings that has been stopped
    noise_floor: Any  # least deviation of the exploration noise
    noise_ceiling: Any  # largest deviation at the end; 0: none
    noise_ceiling_from: Any  # share of the run from which it falls
    value_warm_up: Any  # share of the run before which the policy stays as it is
    constraint: ConstraintHyper | None = None  # None without a cost limit

    @classmethod
    def of(cls, config: LearnConfig, total_steps: float, episode_length: int = 1) -> Hyper:
        """Those of a configuration.

        Args:
            config: resolved settings.
            total_steps: of the run.
            episode_length: steps of an episode; of no matter without a cost limit.
        """
        share = np.float32(config.entropy_decay_share)
        values = {
            "lr": config.lr,
            "lr_decays": config.use_linear_lr_decay,
            "total_steps": total_steps,
            "gamma": config.gamma,
            "gae_discount": config.gamma * config.gae_lambda,
            "clip_param": config.clip_param,
            "ratio_low": 1 - config.clip_param,
            "ratio_high": 1 + config.clip_param,
            "value_loss_coef": config.value_loss_coef,
            "entropy_coef": config.entropy_coef,
            "entropy_fade": np.float32(1) / share if share else 0.0,
            "max_grad_norm": config.max_grad_norm,
            "eps": config.eps,
            "reward_scaling": config.reward_scaling,
            "clip_value_loss": config.clip_value_loss,
            "recompute_advantages": bool(config.recompute_advantages),
            "learns": 1.0,
            "noise_floor": config.noise_floor,
            "noise_ceiling": config.noise_ceiling,
            "noise_ceiling_from": config.noise_ceiling_from,
            "value_warm_up": config.value_warm_up or 0.0,
        }
        numbers = {name: np.float32(value) for name, value in values.items()}
        constraint = ConstraintHyper.of(config, episode_length)
        return cls(**numbers, constraint=constraint)


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class AgentState:
    """All that the learning of one agent needs to go on, but for random keys."""

    params: PPONetworkParams
    optimizer: optax.OptState
    normalizer: running_statistics.RunningStatisticsState  # of the observation
    returns: running_statistics.RunningStatisticsState  # of the discounted return
    env_steps: jax.Array  # environment steps so far; the learning rate follows it    ()
    updates: jax.Array  # updates so far    ()
    critic_normalizer: Any = None  # of what the value function reads; None where that is the same
    constraint: Any = None  # train.learning.constraint.ConstraintState; None without a cost limit


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
        value_layer_norm=config.value_layer_norm,
    )


def init_agent(
    arch: Architecture, key: jax.Array, critic_size: int | None = None, constrained: bool = False
) -> tuple[AgentState, jax.Array]:
    """An agent that has seen nothing, and a random key for what comes after.

    Args:
        arch: networks.
        key: random key.
        critic_size: size of what the value function reads; None if it reads what the policy reads.
        constrained: whether it learns under a cost limit.
    """
    networks = make_networks(arch, critic_size)
    key_policy, key_value, key = jax.random.split(key, 3)
    params: Any = PPONetworkParams(
        policy=init_policy(networks, arch, key_policy),
        value=networks.value_network.init(key_value),
    )
    statistics = running_statistics.init_state
    agent = AgentState(
        params=params,
        optimizer=make_optimizer().init(params),
        normalizer=statistics(jnp.zeros(arch.observation_size)),
        returns=statistics(jnp.zeros(())),
        env_steps=jnp.zeros((), jnp.uint32),
        updates=jnp.zeros((), jnp.int32),
        critic_normalizer=None if critic_size is None else statistics(jnp.zeros(critic_size)),
        constraint=init_constraint(networks, make_optimizer(), key_value) if constrained else None,
    )
    return strong(
        jax.tree.map(jnp.asarray, agent)
    ), key  # Brax leaves a Python number in its statistics


def ppo_loss(
    params: PPONetworkParams,
    normalizer: Any,
    data: dict[str, jax.Array],
    key: jax.Array,
    hyper: Hyper,
    networks: Any,
    entropy_coef: float | jax.Array,
    critic_normalizer: Any = None,
) -> tuple[jax.Array, dict[str, jax.Array]]:
    """Clipped surrogate, (clipped) value loss and entropy bonus of one mini-batch.

    Args:
        params: parameters to differentiate.
        normalizer: observation statistics the data were collected with.
        data: ``obs, raw_action, log_prob, advantage, value, target``, each (N, ...), and
            ``critic_obs`` where there is a ``critic_normalizer``.
        key: random key (the entropy of a squashed Gaussian is sampled).
        hyper: hyper-parameters.
        networks: from ``make_networks``.
        entropy_coef: weight of the entropy, now.
        critic_normalizer: statistics of ``critic_obs``; None if the value function reads ``obs``.

    Returns:
        The loss, and the scalars named in ``LOSSES``.
    """
    distribution = networks.parametric_action_distribution
    logits = networks.policy_network.apply(normalizer, params.policy, data["obs"])
    log_ratio = distribution.log_prob(logits, data["raw_action"]) - data["log_prob"]
    ratio = jnp.exp(log_ratio)
    clipped = jnp.clip(ratio, hyper.ratio_low, hyper.ratio_high)
    advantage = data["advantage"]
    policy_loss = -jnp.mean(jnp.minimum(ratio * advantage, clipped * advantage))

    read = (normalizer, data["obs"])
    if critic_normalizer is not None:
        read = (critic_normalizer, data["critic_obs"])
    value = networks.value_network.apply(read[0], params.value, read[1])
    error = (value - data["target"]) ** 2
    change = jnp.clip(value - data["value"], -hyper.clip_param, hyper.clip_param)
    clipped = jnp.maximum(error, (data["value"] + change - data["target"]) ** 2)
    error = jnp.where(hyper.clip_value_loss > 0, clipped, error)
    value_loss = 0.5 * jnp.mean(error)

    entropy = jnp.mean(distribution.entropy(logits, key))
    loss = policy_loss + hyper.value_loss_coef * value_loss - entropy_coef * entropy
    scalars = {
        "policy_loss": policy_loss,
        "value_loss": value_loss,
        "entropy": entropy,
        "kl": jnp.mean(ratio - 1 - log_ratio),
        "clip_fraction": jnp.mean(jnp.abs(ratio - 1) > hyper.clip_param),
        "noise_std": jnp.mean(distribution.create_dist(logits).scale),
    }
    return loss, scalars


def batch_steps(batch: Batch, axis: str | None) -> int:
    """Environment steps of a rollout, those of the other devices included."""
    return batch.reward.size * (1 if axis is None else jax.lax.axis_size(axis))


@full_precision
def learn(
    agent: AgentState,
    batch: Batch,
    last: jax.Array,
    key: jax.Array,
    hyper: Hyper,
    config: LearnConfig,
    networks: Any,
    axis: str | None = None,
    truncated_every: int | None = None,
) -> tuple[AgentState, dict[str, jax.Array]]:
    """One update from one rollout.

    Args:
        agent: state before.
        batch: rollout of (T, B), in the agent's own view.
        last: what the value function reads after it    (B, critic observation).
        key: random key.
        hyper: hyper-parameters.
        config: settings that the program is compiled for: passes, mini-batches, what is normalised.
        networks: from ``make_networks``.
        axis: name of the axis of devices that each have a part of the batch.
        truncated_every: steps between two truncations of an environment by length; None if that is not known.

    Returns:
        State after, and the mean of each of ``LOSSES``; with a cost limit also of ``COST_LOSSES``.
    """

    def mean(tree: Any) -> Any:
        return tree if axis is None else jax.lax.pmean(tree, axis)

    returns, reward = agent.returns, batch.reward
    if config.normalize_reward:
        returns = running_statistics.update(returns, batch.discounted, pmap_axis_name=axis)
        deviation: Any = returns.std
        std = jnp.sqrt(deviation**2 + 1e-8)
        reward = jnp.clip(reward / std, -REWARD_CLIP, REWARD_CLIP)

    statistics = agent.critic_normalizer or agent.normalizer
    size, ends = reward.size, last_observations(batch, truncated_every)

    def flat(leaves: dict[str, jax.Array]) -> dict[str, jax.Array]:
        return {name: leaf.reshape(size, *leaf.shape[2:]) for name, leaf in leaves.items()}

    def estimate(params: Any) -> dict[str, jax.Array]:
        """Values and normalised advantages, by these parameters of the value function."""
        values, next_values = values_of(
            lambda obs: networks.value_network.apply(statistics, params, obs), batch, last, ends
        )
        advantage = compute_gae(
            reward, values, next_values, batch.done, hyper.gamma, hyper.gae_discount
        )
        centred = advantage - mean(advantage.mean())
        used = penalised(centred, penalty)
        used = used / (jnp.sqrt(mean(jnp.mean(used**2))) + 1e-5)
        return flat({"value": values, "target": advantage + values, "advantage": used})

    optimizer = make_optimizer(hyper.max_grad_norm, hyper.eps)
    progress = agent.env_steps.astype(jnp.float32) / hyper.total_steps
    rate = hyper.lr * jnp.where(hyper.lr_decays > 0, jnp.maximum(0.0, 1.0 - progress), 1.0)
    policy_rate = jnp.where(progress < hyper.value_warm_up, 0.0, rate)
    constraint, penalty, costs = learn_constraint(
        agent.constraint,
        batch,
        last,
        ends,
        key,
        hyper,
        config,
        partial(networks.value_network.apply, statistics),
        optimizer,
        rate,
        progress,
        mean,
    )
    first = estimate(agent.params.value)
    data = {"obs": batch.obs, "raw_action": batch.raw_action, "log_prob": batch.log_prob}
    if batch.critic_obs is not None:
        data["critic_obs"] = batch.critic_obs
    data = flat(data)
    entropy_coef = hyper.entropy_coef * jnp.maximum(0.0, 1.0 - progress * hyper.entropy_fade)
    gradient = jax.grad(ppo_loss, has_aux=True)

    def step(
        data: dict[str, jax.Array], carry: tuple, item: tuple
    ) -> tuple[tuple, dict[str, jax.Array]]:
        params, state = carry
        rows, key = item
        part = {name: leaf[rows] for name, leaf in data.items()}
        with jax.default_matmul_precision(config.gradient_precision):
            grads, scalars = gradient(
                params, agent.normalizer, part, key, hyper, networks, entropy_coef,
                agent.critic_normalizer,
            )  # fmt: skip
        update: Any = optimizer.update(mean(grads), state)
        changes, state = update
        params = PPONetworkParams(
            policy=moved(params.policy, changes.policy, policy_rate),
            value=moved(params.value, changes.value, rate),
        )
        return (params, state), scalars

    def epoch(carry: tuple, key: jax.Array) -> tuple[tuple, dict[str, jax.Array]]:
        key_order, key_steps = jax.random.split(key)
        order = jax.random.permutation(key_order, size).reshape(config.num_mini_batch, -1)
        now = jax.lax.cond(
            hyper.recompute_advantages > 0, lambda: estimate(carry[0].value), lambda: first
        )
        items = (order, jax.random.split(key_steps, len(order)))
        return jax.lax.scan(partial(step, data | now), carry, items)

    (params, state), scalars = jax.lax.scan(
        epoch, (agent.params, agent.optimizer), jax.random.split(key, config.ppo_epoch)
    )
    normalizer, critic_normalizer = agent.normalizer, agent.critic_normalizer
    if config.normalize_observations:
        update = partial(running_statistics.update, std_min_value=STD_MIN, pmap_axis_name=axis)
        normalizer = update(normalizer, batch.obs)
        critic_normalizer = critic_normalizer and update(critic_normalizer, batch.critic_obs)
    steps = batch_steps(batch, axis)
    reached = progress + jnp.float32(steps) / hyper.total_steps
    bounds = (hyper.noise_floor, hyper.noise_ceiling, hyper.noise_ceiling_from)
    policy = keep_noise(params.policy, *bounds, reached)
    agent = replace(
        agent,
        params=params.replace(policy=policy),
        optimizer=state,
        normalizer=normalizer,
        returns=returns,
        env_steps=agent.env_steps + jnp.uint32(steps),
        updates=agent.updates + 1,
        critic_normalizer=critic_normalizer,
        constraint=constraint,
    )
    return agent, mean({name: jnp.mean(value) for name, value in scalars.items()}) | costs
