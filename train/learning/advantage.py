"""How much better a step was than expected: generalised advantage estimation with time limits.

Episodes of Assistive Gym end by their time limit, which says nothing about what the state is
worth, so a truncated step bootstraps with the value of the true last observation.

DEVIATION(time-limit-bootstrap): Assistive Gym's trainer takes the time limit for a terminal state.
"""

from __future__ import annotations

from collections.abc import Callable

import jax
import jax.numpy as jnp

from .rollout import Batch


def compute_gae(
    rewards: jax.Array,
    values: jax.Array,
    next_values: jax.Array,
    done: jax.Array,
    gamma: float,
    gae_lambda: float,
) -> jax.Array:
    """Generalised advantage estimation.

    Args:
        rewards: reward of each step    (T, B).
        values: value of the observation that each step started from    (T, B).
        next_values: value of what each step led to, before any reset: 0 after a termination, the
            value of the last observation after a truncation    (T, B).
        done: 1 where an episode ended, either way    (T, B).
        gamma: discount.
        gae_lambda: lambda.

    Returns:
        Advantages (T, B); advantages + values are the targets of the value function.
    """
    deltas = rewards + gamma * next_values - values

    def back(advantage: jax.Array, step: tuple) -> tuple[jax.Array, jax.Array]:
        delta, done = step
        advantage = delta + gamma * gae_lambda * (1 - done) * advantage
        return advantage, advantage

    _, advantages = jax.lax.scan(back, jnp.zeros_like(deltas[0]), (deltas, done), reverse=True)
    return advantages


def values_of(
    value: Callable[[jax.Array], jax.Array], batch: Batch, last_obs: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """Values that the steps of a batch started from and led to.

    Args:
        value: value function, (..., observation) -> (...).
        batch: a rollout of T steps of B environments.
        last_obs: observation that follows the rollout    (B, observation).

    Returns:
        ``values`` and ``next_values`` of ``compute_gae``    (T, B) each.
    """
    values = value(jnp.concatenate([batch.obs, last_obs[None]]))
    terminal = jnp.where(batch.truncation > 0, value(batch.final_observation), 0.0)
    return values[:-1], jnp.where(batch.done > 0, terminal, values[1:])
