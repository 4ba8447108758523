"""Arguments of ``reset`` and ``step`` that are refused before anything is computed; actions are in ``sim.control``."""

from __future__ import annotations

from typing import Any

import jax
import numpy as np

from agym_jax.errors import ArgumentError


def check_key(key: Any, name: str, num_envs: int | None = None) -> None:
    """Refuse what is no PRNG key.

    Args:
        key: to check: one, or with ``num_envs`` as many, typed or raw.
        name: of the environment.
        num_envs: of a batch.

    Raises:
        ArgumentError: it is something else, or they are too many or too few.
    """
    dtype, shape = getattr(key, "dtype", None), getattr(key, "shape", ())
    typed = dtype is not None and jax.dtypes.issubdtype(dtype, jax.dtypes.prng_key)
    raw = dtype is not None and dtype == np.uint32 and len(shape) > 0
    keys = shape if typed else shape[:-1]
    if (typed or raw) and keys in ((), () if num_envs is None else (num_envs,)):
        return
    several = f", or {num_envs} of them: jax.random.split(key, {num_envs})" if num_envs else ""
    got = f"keys of shape {keys}" if typed or raw else repr(key)
    raise ArgumentError(
        f"{name}.reset takes a PRNG key such as jax.random.key(0){several}; got {got}."
        + ("" if num_envs else " Batches go through agym_jax.wrappers.vectorize(env, num_envs).")
    )


def check_single(state: Any, name: str) -> None:
    """Refuse a state of a batch where one of one environment is asked for.

    Raises:
        ArgumentError: says what steps batches.
    """
    if np.ndim(state.obs) != 1:
        raise ArgumentError(
            f"{name}.step takes the state of one environment, got one of a batch of {np.shape(state.obs)[0]}. Batches "
            f"go through agym_jax.wrappers.vectorize(env, num_envs), whose states its own step takes."
        )
