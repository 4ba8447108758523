"""Full float32 in matrix products, whoever compiles them.

GPUs round the factors of a product to TF32's 10 bits unless they are told not to: up to half a
millimetre in a metre. Environments, policies and learning are guarded.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import ParamSpec, TypeVar

import jax

P = ParamSpec("P")
R = TypeVar("R")


def full_precision(function: Callable[P, R]) -> Callable[P, R]:
    """A function that is traced with full precision, inside of any ``jax.jit``."""

    @functools.wraps(function)
    def traced(*args: P.args, **kwargs: P.kwargs) -> R:
        with jax.default_matmul_precision("highest"):
            return function(*args, **kwargs)

    return traced
