"""What steps were worth: generalised advantage estimation, of any value function."""

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
    gamma: jax.Array | float,
    gae_discount: jax.Array | float,
) -> jax.Array:
    """Generalised advantage estimation.

    Args:
        rewards: reward of each step    (T, B).
        values: value of the observation that each step started from    (T, B).
        next_values: value of what each step led to, before any reset: 0 after a termination, the
            value of the last observation after a truncation    (T, B).
        done: 1 where an episode ended, either way    (T, B).
        gamma: discount.
        gae_discount: gamma times lambda.

    Returns:
        Advantages (T, B); advantages + values are the targets of the value function.
    """
    deltas = rewards + gamma * next_values - values

    def back(advantage: jax.Array, step: tuple) -> tuple[jax.Array, jax.Array]:
        delta, done = step
        advantage = delta + gae_discount * (1 - done) * advantage
        return advantage, advantage

    _, advantages = jax.lax.scan(back, jnp.zeros_like(deltas[0]), (deltas, done), reverse=True)
    return advantages


def values_of(
    value: Callable[[jax.Array], jax.Array], batch: Batch, last: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """Values that the steps of a batch started from and led to.

    Args:
        value: value function, (..., critic observation) -> (...).
        batch: a rollout of T steps of B environments, in the agent's own view.
        last: what the value function reads after the rollout    (B, critic observation).

    Returns:
        ``values`` and ``next_values`` of ``compute_gae``    (T, B) each.
    """
    read = batch.obs if batch.critic_obs is None else batch.critic_obs
    values = value(jnp.concatenate([read, last[None]]))
    final = jnp.where(batch.truncation > 0, value(batch.final_critic_obs), 0.0)
    return values[:-1], jnp.where(batch.done > 0, final, values[1:])
