"""The optimizer of policies and value functions."""

from __future__ import annotations

from typing import Any

import jax
import optax


def make_optimizer(max_grad_norm: Any = 0.5, eps: Any = 1e-5) -> optax.GradientTransformation:
    """Gradient clipping and Adam, without the learning rate; its state is the same for all arguments."""
    return optax.chain(optax.clip_by_global_norm(max_grad_norm), optax.scale_by_adam(eps=eps))


def moved(params: Any, changes: Any, rate: jax.Array) -> Any:
    """Parameters after one step.

    Args:
        params: before it.
        changes: what the optimizer makes of their gradients.
        rate: learning rate ().
    """
    return jax.tree.map(lambda p, c: p - rate * c, params, changes)
