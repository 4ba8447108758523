"""A scan over a trajectory as one GPU kernel, with one program per environment.

The state of an environment stays in registers for the whole scan. XLA launches several kernels per iteration, and
each of them reads and writes the state of all environments.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
from jax import Array

from agym_jax.matter.gpu_kernel import THREADS_PER_WARP, block, kernel_or_xla, run_kernel

Body = Callable[..., Any]
SumOver = Callable[[Callable[[Any], Any], Any], Any]
"""Sums over the rows of matrices. Takes a function and a tree of arrays (k,); the function turns some entries of
these, arrays (r,), into a tree of matrices (r, n). Returns the sums over all k rows, each (n,)."""

MAX_WARPS = 8
"""Warps that work on one environment, at most; otherwise one thread per entry of the state's vectors."""
TILE = 256
"""Entries of a matrix (r, n) that a kernel computes at a time: 4 per thread for 64 particles."""
SCRATCH_ROWS = 16
"""Vectors that fit into a kernel's scratch array (see ``kernel``)."""


def fused_scan(body: Body, carry: Any, trajectory: Any, constants: Any) -> Any:
    """Carry a state along a trajectory.

    On an NVIDIA GPU this is one kernel, if all sizes are powers of two; elsewhere, and for derivatives, XLA compiles
    it. A kernel may use scalars and vectors, elementwise operations, broadcasts to matrices and sums and maxima
    over their axes; no slices, no concatenation and no constant arrays.

    Args:
        body: takes the state, the number of the iteration, the trajectory at its start and at its end, the
            constants, and a ``SumOver``; returns the state after the iteration.
        carry: the initial state, arrays () or (n,).
        trajectory: what changes from iteration to iteration, arrays with a leading axis T: (T,) or (T, k).
        constants: arrays () or (k,).

    Returns:
        the state after T - 1 iterations.
    """
    trees = carry, _at(trajectory, 0), constants
    sizes = {n for x in jax.tree.leaves(trees) for n in x.shape}
    if any(n & (n - 1) or not n for n in sizes):
        return _by_xla(body, carry, trajectory, constants)
    by_kernel, by_xla = partial(kernel, body), partial(_by_xla, body)
    return kernel_or_xla(by_kernel, by_xla, carry, trajectory, constants)


def sum_rows(function: Callable[[Any], Any], rows: Any) -> Any:
    """A ``SumOver`` that computes all rows at a time."""
    return jax.tree.map(lambda x: jnp.sum(x, axis=0), function(rows))


def pad_to_power_of_two(x: Array, value: float) -> Array:
    """Pad the last axis with a value to the next power of two, as kernels need it."""
    size = x.shape[-1]
    more = (1 << max(size - 1, 0).bit_length()) - size
    return jnp.concatenate([x, jnp.full((*x.shape[:-1], more), value, x.dtype)], axis=-1)


def _by_xla(body: Body, carry: Any, trajectory: Any, constants: Any) -> Any:
    def iteration(state: tuple, inputs: tuple) -> tuple[tuple, None]:
        (carry, start), (i, end) = state, inputs
        return (body(carry, i, start, end, constants, sum_rows), end), None

    ends = _at(trajectory, slice(1, None))
    numbers = jnp.arange(len(jax.tree.leaves(ends)[0]), dtype=jnp.int32)
    (carry, _), _ = jax.lax.scan(iteration, (carry, _at(trajectory, 0)), (numbers, ends))
    return carry


def kernel(
    body: Body, carry: Any, trajectory: Any, constants: Any, *, interpret: bool = False
) -> Any:
    """``fused_scan`` as one GPU kernel; with ``interpret``, operation by operation on any device.

    A sum over more rows than fit into a tile is computed tile by tile: the vectors are copied to the scratch array,
    where every thread can read them. (A register is only read by its own thread.)
    """
    state, motion, fixed = _Layout(carry), _Layout(trajectory), _Layout(constants)
    starts, moving, resting = state.pack(carry, 0), motion.pack(trajectory, 1), fixed.pack(constants, 0)  # fmt: skip
    count = _longest(carry)
    tile, warps = max(TILE // count, 1), min(max(count // THREADS_PER_WARP, 1), MAX_WARPS)

    def program(
        inputs: Sequence[Any], outputs: Sequence[Any], scratch: Any, barrier: Callable[[], None]
    ) -> None:
        first, second = len(starts), len(starts + moving)
        start_refs, moving_refs, fixed_refs = inputs[:first], inputs[first:second], inputs[second:]

        def sum_over(function: Callable[..., Any], rows: Any) -> Any:
            leaves, structure = jax.tree.flatten(rows)
            size = _longest(rows)
            if size <= tile:
                return sum_rows(function, rows)
            if len(leaves) > SCRATCH_ROWS:
                raise ValueError(
                    f"The scratch array of a kernel has {SCRATCH_ROWS} rows, got {len(leaves)} vectors."
                )
            barrier()  # all threads have read what was there before
            for i, x in enumerate(leaves):
                scratch[i, block(0, size)] = x
            barrier()

            def read(at: Array | int) -> Any:
                parts = (scratch[i, block(at, tile)] for i in range(len(leaves)))
                return structure.unflatten(parts)

            def add_tile(i: Array, sums: Any) -> Any:
                return jax.tree.map(jnp.add, sums, sum_rows(function, read(i * tile)))

            sums = jax.eval_shape(partial(sum_rows, function), read(0))
            zeros = jax.tree.map(lambda x: jnp.zeros(x.shape, x.dtype), sums)
            return jax.lax.fori_loop(0, size // tile, add_tile, zeros)

        def iteration(i: Array, carry: Any) -> Any:
            start, end = motion.read(moving_refs, i), motion.read(moving_refs, i + 1)
            return body(carry, i, start, end, fixed.read(fixed_refs), sum_over)

        iterations = len(moving[0]) - 1
        after = jax.lax.fori_loop(0, iterations, iteration, state.read(start_refs))
        state.write(outputs, after)

    columns = max(count, _longest(_at(trajectory, 0)), _longest(constants))
    made = run_kernel(
        program,
        [*starts, *moving, *resting],
        [jax.ShapeDtypeStruct(x.shape, x.dtype) for x in starts],
        (SCRATCH_ROWS, columns),
        num_warps=warps,
        name="particles",
        interpret=interpret,
    )
    return state.read(made)


def _at(trajectory: Any, index: int | slice) -> Any:
    return jax.tree.map(lambda x: x[index], trajectory)


def _longest(tree: Any) -> int:
    return max(x.size for x in jax.tree.leaves(tree))


class _Layout:
    """Packs a tree of arrays into few: those of one shape and type into one, so that a kernel has few addresses."""

    def __init__(self, tree: Any) -> None:
        leaves, self.structure = jax.tree.flatten(tree)
        kinds = [(x.shape, x.dtype) for x in leaves]
        self.kinds = list(dict.fromkeys(kinds))
        self.slots = [(self.kinds.index(x), kinds[:i].count(x)) for i, x in enumerate(kinds)]

    def pack(self, tree: Any, axis: int) -> list[Array]:
        """The packed arrays of a tree of this layout, stacked along a new axis."""
        groups: list[list[Array]] = [[] for _ in self.kinds]
        for (which, _), x in zip(self.slots, jax.tree.leaves(tree), strict=True):
            groups[which].append(x)
        return [jnp.stack(group, axis) for group in groups]

    def read(self, packed: Any, *index: Array) -> Any:
        """The tree; for an index along the first axis, if the arrays of a trajectory are packed."""
        return self.structure.unflatten([packed[which][*index, i] for which, i in self.slots])

    def write(self, packed: Any, tree: Any) -> None:
        """Write a tree into packed references."""
        for (which, i), x in zip(self.slots, jax.tree.leaves(tree), strict=True):
            packed[which][i] = x
