"""Many Cholesky factorisations at once on a CPU, without the deadlock of jaxlib 0.10.

jaxlib 0.10 divides a large batch among its threads and waits for them in a thread of the same pool. Two such calls at
a time on two cores wait for each other for ever; MJX has several in every physics step. On two cores that was
seen from 512 matrices of 12 x 12 or 128 of 24 x 24 on, and in half of the runs of 4,096 environments. From
jaxlib 0.11.2 on LAPACK runs in one thread again (``jaxlib/cpu/lapack_kernels.cc``).

``apply`` changes how JAX compiles two operations for CPUs, ``cholesky`` and ``triangular_solve``: a batch that is large
enough to be divided is a loop over pieces that are not. Smaller ones, values, derivatives and other devices
stay as they are. ``tests/compat/test_lapack_batches.py`` fails when jaxlib no longer hangs; delete both then. ``sim.mjx`` applies it.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import jax
from jax._src.interpreters.mlir import _platform_specific_lowerings
from jax.interpreters import mlir
from jax.lax import linalg

from agym_jax.compat.switch import applies

MOST_WORK = {linalg.cholesky_p: 2**19, linalg.triangular_solve_p: 2**16}
"""Multiplications of a call from which on it is made in pieces. Hangs were seen from 0.9 and 0.25 million on."""


def piece(most_work: int, *shapes: tuple[int, ...]) -> int | None:
    """How many of a batch are computed at once; None for all of them.

    Args:
        most_work: multiplications of a call.
        shapes: of the matrices, and of the right-hand sides if there are any (..., n, n), (..., n, k).
    """
    *batch, rows, columns = shapes[-1]
    size = math.prod(batch)
    each = max(1, rows * columns * shapes[0][-1])
    return max(1, most_work // each) if size > 1 and size * each > most_work else None


def apply() -> bool:
    """Change JAX, once, where it is needed and not switched off.

    Returns:
        Whether it is changed now.
    """
    rules = _platform_specific_lowerings["cpu"]
    if applies("lapack_batches", "jaxlib", "0.10", "0.11.2"):
        for primitive, most_work in MOST_WORK.items():
            if not hasattr(rules[primitive].rule, "most_work"):
                rule = _in_pieces(primitive, most_work, rules[primitive].rule)
                mlir.register_lowering(primitive, rule, platform="cpu")
    return all(hasattr(rules[primitive].rule, "most_work") for primitive in MOST_WORK)


def _in_pieces(primitive: Any, most_work: int, whole: Callable[..., Any]) -> Callable[..., Any]:
    """How an operation is compiled: as JAX does, or as a loop over pieces of its batch."""

    def lower(context: Any, *operands: Any, **settings: Any) -> Any:
        shapes = [aval.shape for aval in context.avals_in]
        fixed = all(isinstance(side, int) for shape in shapes for side in shape)
        count = piece(most_work, *shapes) if fixed else None
        if count is None:
            return whole(context, *operands, **settings)

        def pieces(*arrays: jax.Array) -> jax.Array:
            flat = [array.reshape(-1, *array.shape[-2:]) for array in arrays]
            one = lambda matrices: primitive.bind(*matrices, **settings)  # noqa: E731
            return jax.lax.map(one, flat, batch_size=count).reshape(arrays[-1].shape)

        return mlir.lower_fun(pieces, multiple_results=False)(context, *operands)

    lower.most_work = most_work  # type: ignore[attr-defined]
    return lower
