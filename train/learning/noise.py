"""Bounds of the exploration noise, for the Gaussian whose deviation is a parameter of its own ("normal").

A policy gradient lowers the noise as soon as it costs something, often before a rare success, such as the first
drop of water drunk, was seen: then it never is. With a floor, the noise lasts for half of the run.

The deterministic action of a policy is the mean of its noise. A policy that learned with noise until the end was never
tried without; a ceiling that falls lets it learn to do without. In a policy that can do its task already, it may fall from
the start; in a new one that did harm (docs/sweeps.md), as did noise of which a share is held for a whole rollout.
"""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp

FALLS = (0.5, 1.0)  # shares of the run between which the floor falls to 0
LEAST = 1e-6  # deviation; below it there is no floor


def log_floor(floor: Any, progress: jax.Array) -> jax.Array:
    """Least logarithm of the deviation after a share of the run ().

    Args:
        floor: least deviation in the first half of the run    ().
        progress: share of the run that is made    ().
    """
    fallen = jnp.clip((progress - FALLS[0]) / (FALLS[1] - FALLS[0]), 0.0, 1.0)
    return jnp.log(jnp.maximum(floor * (1 - fallen), LEAST))


def log_ceiling(ceiling: Any, falls_from: Any, progress: jax.Array) -> jax.Array:
    """Largest logarithm of the deviation after a share of the run: that of 1, then equal factors down to ``ceiling`` ().

    Args:
        ceiling: largest deviation at the end of the run; 0: none    ().
        falls_from: share of the run from which it falls, below 1    ().
        progress: share of the run that is made    ().
    """
    fallen = jnp.clip((progress - falls_from) / (1.0 - falls_from), 0.0, 1.0)
    return jnp.where(ceiling > 0, fallen * jnp.log(jnp.maximum(ceiling, LEAST)), jnp.inf)


def keep_noise(policy: Any, floor: Any, ceiling: Any, falls_from: Any, progress: jax.Array) -> Any:
    """A policy's parameters with deviations from the floor to the ceiling; those of another distribution as they are.

    Args:
        policy: parameters of the policy network.
        floor: least deviation in the first half of the run    ().
        ceiling: largest deviation at the end of the run; 0: none    ().
        falls_from: share of the run from which the ceiling falls, below 1    ().
        progress: share of the run that is made    ().
    """
    layers = policy["params"]
    if "std_logparam" not in layers:  # Brax's name
        return policy
    value = layers["std_logparam"]["log_value"]
    kept = jnp.maximum(value, log_floor(floor, progress))
    kept = {"log_value": jnp.minimum(kept, log_ceiling(ceiling, falls_from, progress))}
    return {**policy, "params": {**layers, "std_logparam": kept}}
