"""Environments as JAX sees them: one trace of reset and one of step for each id, which all tests of a process share."""

from __future__ import annotations

import functools
from typing import NamedTuple

import jax
import jax.numpy as jnp
from compiled import BATCH, CompiledBatch, compile_batch


class Traced(NamedTuple):
    """A batch of environments, and its functions as programs that are not compiled."""

    batch: CompiledBatch
    reset: jax.stages.Traced
    step: jax.stages.Traced


@functools.cache
def traced(name: str) -> Traced:
    """Trace ``reset`` and ``step`` of ``compile_batch(name)``, for the tests that call them too."""
    batch = compile_batch(name)
    reset = batch.reset.trace(jax.random.PRNGKey(0))
    action = jax.ShapeDtypeStruct((BATCH, batch.env.action_size), jnp.float32)
    return Traced(batch, reset, batch.step.trace(reset.out_info, action))
