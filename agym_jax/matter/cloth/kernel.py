"""The substeps of a physics step of cloth: one GPU kernel with one program an environment, or a loop that XLA compiles.

XLA makes one kernel of each colour of edges, and each of them reads and writes the positions of all environments. In
the kernel here positions and velocities stay in the registers of the program of their world; to look at each
other, vertices write their positions to a memory that only this program uses and read those of their partners.

The physics itself, ``cloth``'s, is the same Python function for both. Whatever is no array of its own vertices it
looks up in ``Rows``: arrays under XLA, references into GPU memory in the kernel.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any, Protocol

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from agym_jax.matter.fused_scan import kernel_or_xla
from agym_jax.matter.shapes import Xyz, columns

WARPS = 16
"""Of 32 threads each, that work on one environment: 2 vertices of a gown to a thread."""

At = int | tuple[int, int | Array]
"""A row, or a row and numbers in it."""


class Rows(Protocol):
    """A table: ``rows[row]``, or of a row the entries of some numbers, ``rows[row, numbers]``."""

    def __getitem__(self, at: At, /) -> Array:
        """A row or its entries."""
        ...


State = tuple[Xyz, Xyz, Xyz, Array]
"""Of n vertices: position [m], velocity [m/s], how far solids have pushed it [m] and which, -1 for none."""
Show = Callable[[Xyz], Rows]
"""Lets vertices look at each other: rows x, y and z of their positions."""
Substep = Callable[[Any, Any, Show, State], State]
"""The state after a substep, from the tables and what is of its moment, both with ``Rows`` for arrays."""


@dataclass(frozen=True)
class InArrays:
    """Rows in arrays."""

    rows: Array | Xyz

    def __getitem__(self, at: At, /) -> Array:
        """Entries that exist; checking that they do would cost more than taking them."""
        if isinstance(at, int):
            return self.rows[at]
        row, numbers = at
        if isinstance(numbers, int):
            return self.rows[row][numbers]
        return self.rows[row].at[numbers].get(mode="promise_in_bounds")


@dataclass(frozen=True)
class InMemory:
    """Rows in GPU memory, of which a part is meant."""

    memory: Any  # a reference
    before: tuple[Array | int, ...]  # indices that come before those of a look
    after: tuple[Array, ...] = ()  # that come after them

    def __getitem__(self, at: At, /) -> Array:
        """Read."""
        own = at if isinstance(at, tuple) else (at,)
        return self.memory[(*self.before, *own, *self.after)]


def advance(
    substep: Substep, tables: Any, pos_w: Array, vel_w: Array, path: Any, held: Array | None
) -> tuple[Array, Array, Xyz, Array]:
    """State of an environment's cloth after all substeps.

    On an NVIDIA GPU it is one kernel; everywhere else, and in derivatives, XLA compiles it.

    Args:
        substep: the physics. Elementwise operations and broadcasts only.
        tables: of NumPy arrays (2, r, n): while the cloth is held, and while it is not.
        pos_w: of n vertices [m] (n, 3).
        vel_w: [m/s] (n, 3).
        path: of arrays (s, r, m): what is different in each of s substeps.
        held: whether it is, () bool; it is if left out.

    Returns:
        positions [m] and velocities [m/s] (n, 3), how far solids have pushed each vertex [m], each (n,), and the
        number of the last one that did, -1 for none (n,) int32.
    """
    by_xla, by_kernel = (partial(way, substep, tables) for way in (_by_xla, kernel))
    if any(x.size == 0 for x in jax.tree.leaves(path)):
        return by_xla(pos_w, vel_w, path, held)
    return kernel_or_xla(by_kernel, by_xla, pos_w, vel_w, path, held)


def _by_xla(
    substep: Substep, tables: Any, pos_w: Array, vel_w: Array, path: Any, held: Array | None
) -> tuple[Array, Array, Xyz, Array]:
    def chosen(table: np.ndarray) -> InArrays:
        if held is None or (table[0] == table[1]).all():
            return InArrays(jnp.asarray(table[0]))
        return InArrays(jnp.where(held, table[0], table[1]))

    now = jax.tree.map(chosen, tables)

    def one(state: State, moment: Any) -> tuple[State, None]:
        return substep(now, jax.tree.map(InArrays, moment), InArrays, state), None

    start = columns(pos_w), columns(vel_w), *_untouched(len(pos_w))
    (pos, vel, pushed, touched), _ = jax.lax.scan(one, start, path)
    return jnp.stack(pos, -1), jnp.stack(vel, -1), pushed, touched


def _untouched(n: int) -> tuple[Xyz, Array]:
    """Nothing has pushed n vertices."""
    still = jnp.zeros(n, jnp.float32)
    return (still, still, still), jnp.full(n, -1, jnp.int32)


def kernel(
    substep: Substep, tables: Any, pos_w: Array, vel_w: Array, path: Any, held: Array | None,
    interpret: bool = False,
) -> tuple[Array, Array, Xyz, Array]:  # fmt: skip
    """What ``advance`` does on an NVIDIA GPU; with ``interpret``, step by step anywhere.

    A program's arrays have a power of two of entries. Those beyond the last vertex do again what it does.
    """
    from jax.experimental import pallas  # takes half a second, and only matter needs it
    from jax.experimental.pallas import triton

    n, size = len(pos_w), 1 << (len(pos_w) - 1).bit_length()
    substeps = len(jax.tree.leaves(path)[0])
    case = jnp.zeros(1, jnp.int32) if held is None else 1 - held.astype(jnp.int32)[None]
    given, form = jax.tree.flatten((tables, path, pos_w, vel_w, case))

    def wait() -> None:
        """Until all threads are here, and see what all have written."""
        if not interpret:
            triton.debug_barrier()

    def program(*refs: Any) -> None:
        tables, path, pos_w, vel_w, case = form.unflatten(refs[: len(given)])
        *made, seen = refs[len(given) :]
        own = jnp.minimum(jnp.arange(size), n - 1)

        def one(i: Array, state: State) -> State:
            # the case is read each time: if it were known, the addresses of all tables would fill the registers
            table, looks = (case[0],), 0

            def show(pos: Xyz) -> InMemory:
                nonlocal looks
                looks += 1
                place = looks % 2  # others may still look at the last one
                for row, x in enumerate(pos):
                    seen[place, row, own] = x
                wait()
                return InMemory(seen, (place,))

            now = jax.tree.map(lambda x: InMemory(x, table, (own,)), tables)
            state = substep(now, jax.tree.map(lambda x: InMemory(x, (i,)), path), show, state)
            wait()
            return state

        start = *(tuple(x[own, c] for c in range(3)) for x in (pos_w, vel_w)), *_untouched(size)
        pos, vel, pushed, touched = jax.lax.fori_loop(0, substeps, one, start)
        for ref, vectors in zip(made[:2], (pos, vel), strict=True):
            for c, x in enumerate(vectors):
                ref[own, c] = x
        for ref, x in zip(made[2:], (*pushed, touched), strict=True):
            ref[own] = x

    of_one = jax.ShapeDtypeStruct((n,), jnp.float32)
    whole = jax.ShapeDtypeStruct((n, 3), jnp.float32)
    number = jax.ShapeDtypeStruct((n,), jnp.int32)
    seen = jax.ShapeDtypeStruct((2, 3, n), jnp.float32)
    pos, vel, x, y, z, touched, _ = pallas.pallas_call(
        program,
        out_shape=(whole, whole, of_one, of_one, of_one, number, seen),
        compiler_params=triton.CompilerParams(num_warps=WARPS, num_stages=1),
        interpret=interpret,
        name="cloth",
    )(*given)
    return pos, vel, (x, y, z), touched
