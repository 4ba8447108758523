"""A loop over the moments of an environment, as one GPU kernel with one program an environment.

So the state of an environment stays in registers for the whole loop. XLA launches several kernels for every turn of a
loop, and each of them reads and writes the state of all environments.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
from jax import Array

Body = Callable[..., Any]
SumOver = Callable[[Callable[[Any], Any], Any], Any]
"""Takes a function and arrays (k,), its rows; the function makes arrays (some, n) of some of the rows. Returns
their sums over all rows, each (n,)."""

WARP, MOST_WARPS = 32, 8
"""Threads in a warp, and warps that work on one environment, at most: one thread for each entry of the state's vectors."""
TILE = 256
"""Entries of a matrix (some, n) that a kernel looks at together: 4 of each thread for 64 particles."""
SCRATCH_ROWS = 16
"""Vectors that fit on a kernel's desk (see ``kernel``)."""


def fused_scan(body: Body, carry: Any, moments: Any, still: Any) -> Any:
    """Carry a state from moment to moment.

    On an NVIDIA GPU it is one kernel, if all sizes are powers of two; everywhere else, and in derivatives, XLA
    compiles it. In a kernel there are scalars and vectors, elementwise operations, broadcasts to matrices and
    sums and maxima over their axes; no slices, no joining, no constant arrays.

    Args:
        body: takes the state, the number of the turn, what moves at its beginning and at its end, what is
            still, and how to sum over the rows of matrices; returns the state after it.
        carry: the state at the beginning, arrays () or (n,).
        moments: what moves, arrays with a leading axis T: (T,) or (T, k).
        still: arrays () or (k,).

    Returns:
        the state after T - 1 turns.
    """
    trees = carry, _moment(moments, 0), still
    sizes = {n for x in jax.tree.leaves(trees) for n in x.shape}
    if any(n & (n - 1) or not n for n in sizes):
        return _by_xla(body, carry, moments, still)
    return kernel_or_xla(partial(kernel, body), partial(_by_xla, body), carry, moments, still)


def at_once(function: Callable[[Any], Any], rows: Any) -> Any:
    """The sums of ``SumOver``, of all rows together."""
    return jax.tree.map(lambda x: jnp.sum(x, axis=0), function(rows))


def widen(x: Array, value: float) -> Array:
    """Fill the last axis up to the next power of two, as kernels need it."""
    size = x.shape[-1]
    more = (1 << max(size - 1, 0).bit_length()) - size
    return jnp.concatenate([x, jnp.full((*x.shape[:-1], more), value, x.dtype)], axis=-1)


def _by_xla(body: Body, carry: Any, moments: Any, still: Any) -> Any:
    def turn(state: tuple, moment: tuple) -> tuple[tuple, None]:
        (carry, before), (i, now) = state, moment
        return (body(carry, i, before, now, still, at_once), now), None

    later = _moment(moments, slice(1, None))
    turns = jnp.arange(len(jax.tree.leaves(later)[0]), dtype=jnp.int32)
    (carry, _), _ = jax.lax.scan(turn, (carry, _moment(moments, 0)), (turns, later))
    return carry


@partial(jax.custom_jvp, nondiff_argnums=(0, 1))
def kernel_or_xla(by_kernel: Callable[..., Any], by_xla: Callable[..., Any], *inputs: Any) -> Any:
    """One of two functions that do the same: the first on an NVIDIA GPU, the second elsewhere and in derivatives."""
    return jax.lax.platform_dependent(*inputs, cuda=by_kernel, default=by_xla)


@kernel_or_xla.defjvp
def _jvp_of_xla(
    _: Callable[..., Any], by_xla: Callable[..., Any], inputs: tuple, changes: tuple
) -> tuple:
    return jax.jvp(by_xla, inputs, changes)


def kernel(body: Body, carry: Any, moments: Any, still: Any, *, interpret: bool = False) -> Any:
    """What ``fused_scan`` does on an NVIDIA GPU; with ``interpret``, step by step anywhere.

    Sums over rows that are more than a piece go piece by piece: the rows are laid on a desk, in memory that all
    threads of the environment's program can read. (A register is only read by its own thread.)
    """
    from jax.experimental import pallas  # takes half a second, and only matter needs it
    from jax.experimental.pallas import triton

    state, motion, rest = _Layout(carry), _Layout(moments), _Layout(still)
    starts, moving, resting = state.pack(carry, 0), motion.pack(moments, 1), rest.pack(still, 0)
    count = _longest(carry)
    piece, warps = max(TILE // count, 1), min(max(count // WARP, 1), MOST_WARPS)

    def program(*refs: Any) -> None:
        first, second, third = len(starts), len(starts + moving), len(starts + moving + resting)
        moved, rested, desk = refs[first:second], refs[second:third], refs[-1]

        def barrier() -> None:
            if not interpret:
                triton.debug_barrier()

        def sum_over(function: Callable[..., Any], rows: Any) -> Any:
            leaves, structure = jax.tree.flatten(rows)
            size = _longest(rows)
            if size <= piece:
                return at_once(function, rows)
            if len(leaves) > SCRATCH_ROWS:
                raise ValueError(
                    f"The desk of a kernel has room for {SCRATCH_ROWS} vectors, got {len(leaves)}."
                )
            barrier()  # all have read what was there before
            for i, x in enumerate(leaves):
                desk[i, pallas.ds(0, size)] = x
            barrier()

            def read(at: Array | int) -> Any:
                parts = (desk[i, pallas.ds(at, piece)] for i in range(len(leaves)))
                return structure.unflatten(parts)

            def more(i: Array, sums: Any) -> Any:
                return jax.tree.map(jnp.add, sums, at_once(function, read(i * piece)))

            sums = jax.eval_shape(partial(at_once, function), read(0))
            zeros = jax.tree.map(lambda x: jnp.zeros(x.shape, x.dtype), sums)
            return jax.lax.fori_loop(0, size // piece, more, zeros)

        def turn(i: Array, carry: Any) -> Any:
            before, now = motion.read(moved, i), motion.read(moved, i + 1)
            return body(carry, i, before, now, rest.read(rested), sum_over)

        turns = len(moving[0]) - 1
        after = jax.lax.fori_loop(0, turns, turn, state.read(refs[:first]))
        state.write(refs[third:-1], after)

    sizes = max(count, _longest(_moment(moments, 0)), _longest(still))
    *made, _ = pallas.pallas_call(
        program,
        out_shape=[jax.ShapeDtypeStruct(x.shape, x.dtype) for x in starts]
        + [jax.ShapeDtypeStruct((SCRATCH_ROWS, sizes), jnp.float32)],
        compiler_params=triton.CompilerParams(num_warps=warps, num_stages=1),
        interpret=interpret,
    )(*starts, *moving, *resting)
    return state.read(made)


def _moment(moments: Any, at: int | slice) -> Any:
    return jax.tree.map(lambda x: x[at], moments)


def _longest(tree: Any) -> int:
    return max(x.size for x in jax.tree.leaves(tree))


class _Layout:
    """How a tree of arrays is kept in few: those of one shape and type in one, so that a kernel has few addresses."""

    def __init__(self, tree: Any) -> None:
        leaves, self.structure = jax.tree.flatten(tree)
        kinds = [(x.shape, x.dtype) for x in leaves]
        self.kinds = list(dict.fromkeys(kinds))
        self.places = [(self.kinds.index(x), kinds[:i].count(x)) for i, x in enumerate(kinds)]

    def pack(self, tree: Any, axis: int) -> list[Array]:
        """The arrays that keep a tree of this layout, stacked along a new axis."""
        kept: list[list[Array]] = [[] for _ in self.kinds]
        for (which, _), x in zip(self.places, jax.tree.leaves(tree), strict=True):
            kept[which].append(x)
        return [jnp.stack(group, axis) for group in kept]

    def read(self, kept: Any, *at: Array) -> Any:
        """The tree; of one moment, if the first axis is of moments."""
        return self.structure.unflatten([kept[which][*at, i] for which, i in self.places])

    def write(self, kept: Any, tree: Any) -> None:
        """Set what is kept."""
        for (which, i), x in zip(self.places, jax.tree.leaves(tree), strict=True):
            kept[which][i] = x
