"""The pace of a policy that training starts from: its learning rate is such that an update changes what it does by a given amount.

How much the steps of the optimizer change a policy depends on its noise: the divergence from the policy that acted grows with the square
of the change of the mean, divided by the deviation. The learning rates of the tasks are for new policies, whose deviation is about 1. Those
that training starts from often have 0.1 to 0.2, and diverge more (docs/training_notes.md, "Continued trainings").

The pace is a factor on the learning rate of the policy, at most 1, set after every update from the divergence in its last pass over the
data. Brax and RSL-RL adapt the learning rate after each mini-batch; here there are hundreds of those in an update, in which the divergence
grows from 0, so that a rate that follows it would swing.
"""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp

START = 0.02
"""Pace of the first update. A pace that is too small grows within some ten updates; what too large a pace spoils does not come back."""
LEAST = 1e-3
SLOWER, FASTER = 0.5, 1.25
"""Largest changes of the pace after one update."""


def next_pace(pace: jax.Array, kl: jax.Array, target: Any) -> jax.Array:
    """The pace after an update    ().

    Args:
        pace: that of the update    ().
        kl: divergence that it led to    ().
        target: divergence that is wanted    ().
    """
    change = jnp.sqrt(target / jnp.maximum(kl, 1e-8))  # the divergence grows with the square
    return jnp.clip(pace * jnp.clip(change, SLOWER, FASTER), LEAST, 1.0)
