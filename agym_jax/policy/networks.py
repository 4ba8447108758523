"""Brax's PPO networks, described by a small hashable record, and functions to initialise and evaluate them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache, partial
from typing import Any

import jax
import jax.numpy as jnp
from brax.training import networks as brax_networks
from brax.training.acme import running_statistics
from brax.training.agents.ppo import networks as ppo_networks
from flax import linen

from agym_jax.jax_settings import full_precision

OBSERVATION_CLIP = 10.0  # normalised observations are clipped here, as in Assistive Gym
HIDDEN_GAIN = 2.0**0.5  # of the orthogonal initial weights, as in Assistive Gym
STD_MIN = 1e-4  # smallest deviation an observation is divided by, as in Assistive Gym

ACTIVATIONS = {
    "tanh": linen.tanh,
    "swish": linen.swish,
    "elu": linen.elu,
    "relu": linen.relu,
}


_normalised: Any = partial(running_statistics.normalize, max_abs_value=OBSERVATION_CLIP)


@dataclass(frozen=True)
class Architecture:
    """Everything that must match for weights to be compatible: sizes, layers, activation and distribution."""

    observation_size: int
    action_size: int
    policy_hidden: tuple[int, ...]
    value_hidden: tuple[int, ...]
    activation: str
    distribution: str
    init_noise_std: float = 1.0
    policy_head_gain: float = 1.0
    value_layer_norm: bool = False


@cache
def make_networks(arch: Architecture, value_size: int | None = None) -> ppo_networks.PPONetworks:
    """Build policy network, value network and action distribution of an architecture.

    Args:
        arch: architecture of the networks.
        value_size: input size of the value network; defaults to ``arch.observation_size``.
    """
    if value_size is not None:
        networks: Any = make_networks(arch)
        wider = make_networks(replace(arch, observation_size=value_size))
        return networks.replace(value_network=wider.value_network)
    # Brax makes a constant here, which must not belong to whichever function is being traced.
    with jax.ensure_compile_time_eval():
        networks = ppo_networks.make_ppo_networks(
            arch.observation_size,
            arch.action_size,
            preprocess_observations_fn=_normalised,
            policy_hidden_layer_sizes=arch.policy_hidden,
            activation=ACTIVATIONS[arch.activation],
            distribution_type=arch.distribution,  # pyrefly: ignore
            noise_std_type="log",
            init_noise_std=arch.init_noise_std,
            policy_network_kernel_init_fn=jax.nn.initializers.orthogonal,
            policy_network_kernel_init_kwargs={"scale": HIDDEN_GAIN},
            mean_kernel_init_fn=jax.nn.initializers.orthogonal,
            mean_kernel_init_kwargs={"scale": arch.policy_head_gain},
        )
    return networks.replace(value_network=_value_network(arch))  # pyrefly: ignore


def _value_network(arch: Architecture) -> brax_networks.FeedForwardNetwork:
    """Build the value network, whose layers Brax's PPO does not normalise."""
    module = brax_networks.MLP(
        layer_sizes=(*arch.value_hidden, 1),
        activation=ACTIVATIONS[arch.activation],
        kernel_init=jax.nn.initializers.orthogonal(HIDDEN_GAIN),
        layer_norm=arch.value_layer_norm,
    )

    def init(key: jax.Array) -> Any:
        return module.init(key, jnp.zeros((1, arch.observation_size)))

    def apply(normalizer: Any, weights: Any, obs: jax.Array) -> jax.Array:
        value: Any = module.apply(weights, _normalised(obs, normalizer))
        return jnp.squeeze(value, -1)

    return brax_networks.FeedForwardNetwork(init=init, apply=apply)


def init_policy(networks: ppo_networks.PPONetworks, arch: Architecture, key: jax.Array) -> Any:
    """Initialise the weights of the policy network, with gain ``policy_head_gain`` for the last layer."""
    policy = networks.policy_network.init(key)
    if arch.distribution == "tanh_normal":  # Brax gives its head the gain of the hidden layers
        head = f"hidden_{len(arch.policy_hidden)}"
        layers = policy["params"]
        kernel = layers[head]["kernel"] * (arch.policy_head_gain / HIDDEN_GAIN)
        policy = {**policy, "params": {**layers, head: {**layers[head], "kernel": kernel}}}
    return policy


@full_precision
def sample_action(
    networks: ppo_networks.PPONetworks, normalizer: Any, policy: Any, obs: jax.Array, key: jax.Array
) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Draw actions.

    Args:
        networks: from ``make_networks``.
        normalizer: running statistics of the observation (``mean`` and ``std``).
        policy: parameters of the policy network.
        obs: (..., observation_size).
        key: random key.

    Returns:
        The action (..., action_size), the raw sample from which it was computed (same shape), and the
        log-probability of the raw sample (...). An action of "normal" may lie beyond [-1, 1], where environments penalise it, but do
        not move farther.
    """
    distribution = networks.parametric_action_distribution
    logits = networks.policy_network.apply(normalizer, policy, obs)
    raw = distribution.sample_no_postprocessing(logits, key)
    return distribution.postprocess(raw), raw, distribution.log_prob(logits, raw)


@full_precision
def mode_action(
    networks: ppo_networks.PPONetworks, normalizer: Any, policy: Any, obs: jax.Array
) -> jax.Array:
    """Return the deterministic action in [-1, 1] (..., action_size)."""
    logits = networks.policy_network.apply(normalizer, policy, obs)
    if isinstance(logits, tuple):  # "normal": (mean, deviation)
        return jnp.clip(logits[0], -1.0, 1.0)
    return networks.parametric_action_distribution.mode(logits)
