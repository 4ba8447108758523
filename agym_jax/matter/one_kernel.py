"""Sums over all pairs of particles of a world, as one GPU kernel with one program a world.

So the pairs live in registers, a few columns at a time. XLA writes no array of pairs either, but its kernel
does not know of worlds.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import jax
import jax.numpy as jnp
from jax import Array

WARPS = 4
"""Of 32 threads each, that work on one world."""
COLUMNS = 8
"""Others that are looked at together: 64 x 8 pairs are 4 to a thread."""
LEAST = 16
"""Fewer particles than this are left to XLA."""

OfPairs = Callable[..., tuple[Array, ...]]


def sum_over_others(function: OfPairs, *inputs: Array) -> tuple[Array, ...]:
    """Sums over the others of what is between every particle and each of them.

    On an NVIDIA GPU, for n a power of two, it is one kernel; everywhere else, and in derivatives, XLA compiles it.

    Args:
        function: takes the inputs of some particles and those of some others, and gives a tuple of arrays
            (some, others). It may use elementwise operations and broadcasts.
        inputs: of all n particles (n,), or of the world (), float32.

    Returns:
        sums over the others, each (n,).
    """
    n = max(x.size for x in inputs)
    if n < LEAST or n & (n - 1):
        return _by_xla(function, *inputs)
    return _either(function, *inputs)


def _by_xla(function: OfPairs, *inputs: Array) -> tuple[Array, ...]:
    return tuple(jnp.sum(x, axis=1) for x in function(inputs, inputs))


@partial(jax.custom_jvp, nondiff_argnums=(0,))
def _either(function: OfPairs, *inputs: Array) -> tuple[Array, ...]:
    return jax.lax.platform_dependent(
        *inputs, cuda=partial(kernel, function), default=partial(_by_xla, function)
    )


@_either.defjvp
def _either_jvp(function: OfPairs, inputs: tuple[Array, ...], changes: tuple[Array, ...]) -> tuple:
    return jax.jvp(partial(_by_xla, function), inputs, changes)


def kernel(function: OfPairs, *inputs: Array, interpret: bool = False) -> tuple[Array, ...]:
    """What ``sum_over_others`` does on an NVIDIA GPU; with ``interpret``, step by step anywhere."""
    from jax.experimental import pallas  # takes half a second, and only matter needs it
    from jax.experimental.pallas import triton

    n = max(x.size for x in inputs)
    some = [jnp.zeros(min(COLUMNS, n)) if x.ndim else x for x in inputs]
    outputs = len(jax.eval_shape(function, inputs, some))

    def program(*refs) -> None:
        given, made = refs[: len(inputs)], refs[len(inputs) :]

        def read(at: Array | int, size: int) -> list[Array]:
            pairs = zip(given, inputs, strict=True)
            return [ref[pallas.ds(at, size)] if x.ndim else ref[0] for ref, x in pairs]

        own = read(0, n)

        def add(i: Array, sums: tuple[Array, ...]) -> tuple[Array, ...]:
            more = function(own, read(i * COLUMNS, COLUMNS))
            return tuple(a + b for a, b in zip(sums, more, strict=True))

        if n <= COLUMNS:
            sums = function(own, own)
        else:
            zeros = (jnp.zeros((n, COLUMNS), jnp.float32),) * outputs
            sums = jax.lax.fori_loop(0, n // COLUMNS, add, zeros)
        for ref, x in zip(made, sums, strict=True):
            ref[...] = jnp.sum(x, axis=1)

    return tuple(
        pallas.pallas_call(
            program,
            out_shape=(jax.ShapeDtypeStruct((n,), jnp.float32),) * outputs,
            compiler_params=triton.CompilerParams(num_warps=WARPS),
            interpret=interpret,
        )(*map(jnp.atleast_1d, inputs))
    )
