"""What steps were worth: generalised advantage estimation, of any value function."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

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


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class LastObservations:
    """What value functions read at the truncations of a batch, of each environment up to K; the others are rows without one."""

    step: jax.Array  # int32 (K, B)
    critic_obs: jax.Array  # (K, B, critic observation)


def last_observations(batch: Batch, truncated_every: int | None = None) -> LastObservations:
    """The last observations of the episodes that a batch cut off.

    Few steps end an episode by its length, so that a value function need not read what follows each step.

    Args:
        batch: a rollout of T steps of B environments, in the agent's own view.
        truncated_every: steps between two truncations of an environment by the length of its episodes; None if every step may
            be one. Divergences are not counted, see ``values_of``.
    """
    steps = len(batch.truncation)
    most = steps if truncated_every is None else -(-steps // truncated_every)
    step = jnp.argsort(batch.truncation <= 0, axis=0, stable=True)[:most]
    return LastObservations(
        step, jnp.take_along_axis(batch.final_critic_obs, step[..., None], axis=0)
    )


def values_of(
    value: Callable[[jax.Array], jax.Array], batch: Batch, last: jax.Array, ends: LastObservations
) -> tuple[jax.Array, jax.Array]:
    """Values that the steps of a batch started from and led to.

    Args:
        value: value function, (..., critic observation) -> (...).
        batch: a rollout of T steps of B environments, in the agent's own view.
        last: what the value function reads after the rollout    (B, critic observation).
        ends: ``last_observations`` of the batch.

    Returns:
        ``values`` and ``next_values`` of ``compute_gae``    (T, B) each.
    """
    read = batch.obs if batch.critic_obs is None else batch.critic_obs
    values = value(jnp.concatenate([read, last[None], ends.critic_obs]))
    values, after, final = jnp.split(values, [len(read), len(read) + 1])
    # A truncation beyond the K that were read is a divergence: the last observation is the one that the step started from.
    final = values.at[ends.step, jnp.arange(len(last))].set(final)
    final = jnp.where(batch.truncation > 0, final, 0.0)
    following = jnp.concatenate([values[1:], after])
    return values, jnp.where(batch.done > 0, final, following)
