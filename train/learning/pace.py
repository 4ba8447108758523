"""How fast a policy learns that can do its task already: so that an update changes what it does by a given amount.

How much a step of the optimizer changes a policy depends on its noise: the divergence of the policy after an update from the one that
acted grows with the square of the change of its mean, divided by the noise. The learning rates of the tasks are for new policies, whose
deviation is about 1. With the deviation of 0.1 to 0.2 that a trained policy has, they lead to divergences of 0.1 to 29 in one update (0.03 in
new trainings), far beyond the range in which PPO's objective means anything, and the policy gets worse.

The pace is a factor on the learning rate of the policy, at most 1, set after every update from the divergence of its last pass over the data.
Brax and RSL-RL do the same with the learning rate of each mini-batch; here there are hundreds of those in an update, in which the
divergence grows from 0, so that a rate that follows it would swing.
"""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp

START = 0.02
"""Pace of the first update. A pace that is too small grows within a few updates; what one that is too large spoils is lost."""
LEAST = 1e-3
SLOWER, FASTER = 0.5, 1.25
"""Largest changes of the pace after one update."""


def next_pace(pace: jax.Array, kl: jax.Array, target: Any) -> jax.Array:
    """The pace after an update    ().

    Args:
        pace: that of the update    ().
        kl: divergence that it led to    ().
        target: divergence that is wanted; 0: the pace is always 1    ().
    """
    change = jnp.sqrt(target / jnp.maximum(kl, 1e-8))  # the divergence grows with the square
    paced = jnp.clip(pace * jnp.clip(change, SLOWER, FASTER), LEAST, 1.0)
    return jnp.where(target > 0, paced, 1.0)
