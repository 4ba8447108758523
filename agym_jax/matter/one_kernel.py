"""A function of one world as one GPU kernel, one program a world, so that its intermediate arrays stay in registers.

XLA writes no array of pairs either, but computes each of several sums over them again from the start, and a
world per block of threads is not what it finds: the sweep over the pairs of 64 particles takes it 270 us in
4,096 worlds on an H200.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import jax
import jax.numpy as jnp
from jax import Array

WARPS = 16
"""Of 32 threads each, that work on one world: 64 x 64 pairs are 8 to a thread."""
LEAST = 16
"""Fewer entries than this are left to XLA."""

Worldly = Callable[..., tuple[Array, ...]]


def in_one_kernel(function: Worldly, *inputs: Array) -> tuple[Array, ...]:
    """The outputs of a function of one world, as one kernel where Triton can make one.

    It can on an NVIDIA GPU, for n a power of two. Everywhere else, and in derivatives, XLA compiles the
    function like any other.

    Args:
        function: takes the inputs, and gives a tuple of arrays of the shape and type of the first one. It
            may use elementwise operations, broadcasts and reductions.
        inputs: arrays (n,) or scalars, float32.
    """
    n = inputs[0].size
    if n < LEAST or n & (n - 1):
        return function(*inputs)
    return _either(function, *inputs)


@partial(jax.custom_jvp, nondiff_argnums=(0,))
def _either(function: Worldly, *inputs: Array) -> tuple[Array, ...]:
    return jax.lax.platform_dependent(
        *inputs, cuda=partial(kernel, function), default=lambda *x: function(*x)
    )


@_either.defjvp
def _either_jvp(function: Worldly, inputs: tuple[Array, ...], changes: tuple[Array, ...]) -> tuple:
    return jax.jvp(lambda *x: tuple(function(*x)), inputs, changes)


def kernel(function: Worldly, *inputs: Array, interpret: bool = False) -> tuple[Array, ...]:
    """What ``in_one_kernel`` does on an NVIDIA GPU; with ``interpret``, step by step anywhere."""
    from jax.experimental import pallas  # takes half a second, and only matter needs it
    from jax.experimental.pallas import triton

    first = inputs[0]
    outputs = len(jax.eval_shape(function, *inputs))

    def program(*refs) -> None:
        given, made = refs[: len(inputs)], refs[len(inputs) :]
        values = [ref[0] if x.ndim == 0 else ref[...] for ref, x in zip(given, inputs, strict=True)]
        for ref, value in zip(made, function(*values), strict=True):
            ref[...] = value

    return tuple(
        pallas.pallas_call(
            program,
            out_shape=(jax.ShapeDtypeStruct(first.shape, first.dtype),) * outputs,
            compiler_params=triton.CompilerParams(num_warps=WARPS),
            interpret=interpret,
        )(*map(jnp.atleast_1d, inputs))
    )
