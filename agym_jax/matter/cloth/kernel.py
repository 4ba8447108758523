"""The substeps of a physics step of cloth: one GPU kernel, or a loop that XLA compiles.

XLA makes one kernel per colour of edges, and each of them reads and writes the positions of all environments. In
the kernel here positions and velocities stay in registers; where a substep needs the positions of other vertices,
all vertices write theirs to the scratch array first (``agym_jax.matter.gpu_kernel``).

The physics itself is the same Python function for both (``cloth.solver``). Whatever is not an array of its own
vertices it reads through ``Rows``: arrays under XLA, references to GPU memory in the kernel.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, Protocol

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from agym_jax.matter.gpu_kernel import kernel_or_xla, run_kernel
from agym_jax.matter.shapes import Xyz, columns

WARPS = 16
"""Warps of 32 threads that work on one environment: 2 vertices of the gown per thread."""

RowIndex = int | tuple[int, int | Array]
"""A row, or a row and the columns wanted of it."""


class Rows(Protocol):
    """A table: ``table[row]`` is a row, ``table[row, columns]`` some of its entries."""

    def __getitem__(self, index: RowIndex, /) -> Array:
        """A row or some of its entries."""
        ...


State = tuple[Xyz, Xyz, Xyz, Array]
"""Of n vertices: position [m], velocity [m/s], total displacement by solids [m] and the index of the solid that
displaced it last, -1 for none."""
Publish = Callable[[Xyz], Rows]
"""Makes the positions of all vertices readable for each other: rows x, y and z."""
Substep = Callable[[Any, Any, Publish, State], State]
"""The state after a substep, from the tables and this substep's inputs, both with ``Rows`` for arrays."""


@dataclass(frozen=True)
class InArrays:
    """Rows in arrays."""

    rows: Array | Xyz

    def __getitem__(self, index: RowIndex, /) -> Array:
        """Entries that exist: a bounds check would cost more than the lookup."""
        if isinstance(index, int):
            return self.rows[index]
        row, at = index
        if isinstance(at, int):
            return self.rows[row][at]
        return self.rows[row].at[at].get(mode="promise_in_bounds")


@dataclass(frozen=True)
class InMemory:
    """Rows in a part of GPU memory."""

    memory: Any  # a reference
    before: tuple[Array | int, ...]  # indices that come before those of a lookup
    after: tuple[Array, ...] = ()  # indices that come after them

    def __getitem__(self, index: RowIndex, /) -> Array:
        """Read."""
        own = index if isinstance(index, tuple) else (index,)
        return self.memory[(*self.before, *own, *self.after)]


def advance(
    substep: Substep, tables: Any, pos_w: Array, vel_w: Array, trajectory: Any, held: Array | None
) -> tuple[Array, Array, Xyz, Array]:
    """Advance an environment's cloth by all substeps of a physics step.

    On an NVIDIA GPU this is one kernel; elsewhere, and for derivatives, XLA compiles it.

    Args:
        substep: the physics. Elementwise operations and broadcasts only.
        tables: tree of NumPy arrays (2, r, n): while the cloth is held, and while it is not.
        pos_w: of n vertices [m] (n, 3).
        vel_w: of n vertices [m/s] (n, 3).
        trajectory: tree of arrays (s, r, m): the inputs of each of s substeps.
        held: whether the cloth is held, () bool; it is if left out.

    Returns:
        positions [m] and velocities [m/s] (n, 3), total displacement of each vertex by solids [m], each (n,), and
        the index of the last solid that displaced it, -1 for none (n,) int32.
    """
    by_xla, by_kernel = (partial(way, substep, tables) for way in (_by_xla, kernel))
    if any(x.size == 0 for x in jax.tree.leaves(trajectory)):
        return by_xla(pos_w, vel_w, trajectory, held)
    return kernel_or_xla(by_kernel, by_xla, pos_w, vel_w, trajectory, held)


def _by_xla(
    substep: Substep, tables: Any, pos_w: Array, vel_w: Array, trajectory: Any, held: Array | None
) -> tuple[Array, Array, Xyz, Array]:
    def select(table: np.ndarray) -> InArrays:
        if held is None or (table[0] == table[1]).all():
            return InArrays(jnp.asarray(table[0]))
        return InArrays(jnp.where(held, table[0], table[1]))

    selected = jax.tree.map(select, tables)

    def one(state: State, inputs: Any) -> tuple[State, None]:
        return substep(selected, jax.tree.map(InArrays, inputs), InArrays, state), None

    start = columns(pos_w), columns(vel_w), *_no_displacement(len(pos_w))
    (pos, vel, pushed, touched), _ = jax.lax.scan(one, start, trajectory)
    return jnp.stack(pos, -1), jnp.stack(vel, -1), pushed, touched


def _no_displacement(n: int) -> tuple[Xyz, Array]:
    """No solid has displaced any of n vertices."""
    zero = jnp.zeros(n, jnp.float32)
    return (zero, zero, zero), jnp.full(n, -1, jnp.int32)


def kernel(
    substep: Substep, tables: Any, pos_w: Array, vel_w: Array, trajectory: Any, held: Array | None,
    interpret: bool = False,
) -> tuple[Array, Array, Xyz, Array]:  # fmt: skip
    """``advance`` as one GPU kernel; with ``interpret``, operation by operation on any device.

    Arrays in a kernel have a power of two of entries. Those beyond the last vertex repeat what it does.
    """
    n, size = len(pos_w), 1 << (len(pos_w) - 1).bit_length()
    substeps = len(jax.tree.leaves(trajectory)[0])
    case = jnp.zeros(1, jnp.int32) if held is None else 1 - held.astype(jnp.int32)[None]
    inputs, structure = jax.tree.flatten((tables, trajectory, pos_w, vel_w, case))

    def program(
        inputs: Sequence[Any], outputs: Sequence[Any], scratch: Any, barrier: Callable[[], None]
    ) -> None:
        tables, trajectory, pos_w, vel_w, case = structure.unflatten(inputs)
        own = jnp.minimum(jnp.arange(size), n - 1)

        def one(i: Array, state: State) -> State:
            # the case is read each time: if it were known, the addresses of all tables would fill the registers
            table, published = (case[0],), 0

            def publish(pos: Xyz) -> InMemory:
                nonlocal published
                published += 1
                half = published % 2  # other threads may still be reading the half before
                for row, x in enumerate(pos):
                    scratch[half, row, own] = x
                barrier()
                return InMemory(scratch, (half,))

            selected = jax.tree.map(lambda x: InMemory(x, table, (own,)), tables)
            now = jax.tree.map(lambda x: InMemory(x, (i,)), trajectory)
            state = substep(selected, now, publish, state)
            barrier()
            return state

        start = *(tuple(x[own, c] for c in range(3)) for x in (pos_w, vel_w)), *_no_displacement(size)  # fmt: skip
        pos, vel, pushed, touched = jax.lax.fori_loop(0, substeps, one, start)
        for ref, vectors in zip(outputs[:2], (pos, vel), strict=True):
            for c, x in enumerate(vectors):
                ref[own, c] = x
        for ref, x in zip(outputs[2:], (*pushed, touched), strict=True):
            ref[own] = x

    number = jax.ShapeDtypeStruct((n,), jnp.float32)
    vector = jax.ShapeDtypeStruct((n, 3), jnp.float32)
    solid = jax.ShapeDtypeStruct((n,), jnp.int32)
    pos, vel, x, y, z, touched = run_kernel(
        program,
        inputs,
        (vector, vector, number, number, number, solid),
        (2, 3, n),
        num_warps=WARPS,
        name="cloth",
        interpret=interpret,
    )
    return pos, vel, (x, y, z), touched
