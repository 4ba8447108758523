"""Trees of many environments as one array each, for compiled programs that are called often and do little.

Every array that enters a compiled program costs a call one (from the device) or six microseconds (from NumPy), and every one
that leaves it eight: of 40 and 30 small ones that is more than all arithmetic. Here a tree lies in the columns of one array,
one environment a row, bit by bit.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from agym_jax.jax_settings import full_precision, known_options, own_stream

ALIGNMENT = 64
"""Of arrays that compiled programs read where they lie [bytes]; others they copy, large ones (100 kB) in another thread."""
CARRIED = {"f": np.dtype(np.float32), "i": np.dtype(np.int32), "u": np.dtype(np.uint32)}
"""Kind of number -> as what it lies in the columns; truth values are unsigned there."""
Part = tuple[int, int, tuple[int, ...], np.dtype]
"""First column, the one after the last, and shape and type of a leaf."""


def aligned(shape: tuple[int, ...], dtype: Any = np.float32) -> np.ndarray:
    """An array for compiled programs; what is in it means nothing yet."""
    size = math.prod(shape) * np.dtype(dtype).itemsize
    memory = np.empty(size + ALIGNMENT, np.uint8)
    start = -memory.ctypes.data % ALIGNMENT
    return memory[start : start + size].view(dtype).reshape(shape)


@dataclass(frozen=True, eq=False)  # compared often: one for each tree, see ``layout_of``
class Layout:
    """Where the leaves of a tree lie in the columns."""

    tree: Any
    parts: tuple[Part, ...]
    width: int

    def read(self, columns: Any, bits: Callable[[Any, np.dtype], Any]) -> Any:
        """The tree of columns (..., width), with the same leading axes; ``bits`` reads numbers as of another type."""
        leaves = []
        for start, stop, shape, dtype in self.parts:
            part = columns[..., start:stop].reshape(*columns.shape[:-1], *shape)
            leaves.append(part != 0 if dtype == np.bool_ else bits(part, dtype))
        return jax.tree.unflatten(self.tree, leaves)


_LAYOUTS: dict[Any, Layout] = {}


def layout_of(tree: Any, leaves: Sequence[Any]) -> Layout:
    """The layout of a tree with these leaves, which have a leading axis; the same one for each like it."""
    key = tree, tuple((x.shape[1:], x.dtype) for x in leaves)
    found = _LAYOUTS.get(key)
    if found is None:
        parts, start = [], 0
        for shape, dtype in key[1]:
            stop = start + math.prod(shape)
            kept = np.dtype(np.bool_) if dtype == np.bool_ else CARRIED[dtype.kind]
            parts.append((start, stop, shape, kept))
            start = stop
        found = _LAYOUTS.setdefault(key, Layout(tree, tuple(parts), start))
    return found


@dataclass(frozen=True, eq=False)
class Columns:
    """A tree of environments, one a row."""

    array: Any  # uint32, of NumPy or on the device (rows, width)
    layout: Layout

    @classmethod
    def of(
        cls, tree: Any, count: int, part: slice | None = None, rows: np.ndarray | None = None
    ) -> Columns:
        """Of a tree of arrays.

        Args:
            tree: with a leading axis of environments (n, ...).
            count: rows of the columns; those that are missing are as the first environment.
            part: which environments; by default all, at most ``count``.
            rows: in which they lie (n,); by default the first ones.
        """
        leaves, structure = jax.tree.flatten(tree)
        leaves = [np.asarray(x) for x in leaves]
        layout = layout_of(structure, leaves)
        array = aligned((count, layout.width), np.uint32)
        views = {kind: array.view(dtype) for kind, dtype in CARRIED.items()} | {"b": array}
        n = count
        with np.errstate(over="ignore"):
            for (start, stop, _, _), x in zip(layout.parts, leaves, strict=True):
                given = x if part is None else x[part]
                n = len(given)
                views[x.dtype.kind][:n, start:stop] = given.reshape(n, stop - start)
        if rows is not None:
            given = array[:n].copy()
            array[:] = given[0]
            array[rows] = given
        elif n < count:
            array[n:] = array[0]
        return cls(array, layout)

    def on_device(self) -> Columns:
        """The same, to be given to several programs."""
        return Columns(jax.device_put(self.array), self.layout)

    def tree(self, count: int | None = None) -> Any:
        """The first rows as a tree, in NumPy (count, ...); by default all."""
        return self.layout.read(np.asarray(self.array)[:count], lambda x, dtype: x.view(dtype))


class Program:
    """A function of trees, compiled for rows of environments.

    Args:
        function: of one environment.
        rows: whether it is a function of all rows instead, its arguments and results with that leading axis.
        small: whether it takes less than a millisecond.
        options: of XLA, besides.
    """

    def __init__(
        self,
        function: Callable[..., Any],
        rows: bool = False,
        small: bool = True,
        options: dict[str, Any] | None = None,
    ):
        whole = full_precision(function)
        self._function, self._small = whole if rows else jax.vmap(whole), small
        self._options = options or {}
        self._compiled: dict[Any, tuple[Callable[..., Array], list[Layout]]] = {}

    def __call__(self, *given: Columns | np.ndarray) -> Columns:
        """Its result for ``Columns``, or for arrays with the leading axis."""
        run, found = self._for(given)
        arrays = [x.array if isinstance(x, Columns) else x for x in given]
        with own_stream():
            array = run(*arrays)
        return Columns(array, found[0])

    def shapes(self, *given: Columns | np.ndarray) -> Any:
        """Zeros like its result, in NumPy; it is not compiled."""
        run, found = self._for(given)
        like = [x.array if isinstance(x, Columns) else x for x in given]
        array = jax.eval_shape(run, *like)
        return Columns(np.zeros(array.shape, np.uint32), found[0]).tree()

    def _for(self, given: Sequence[Any]) -> tuple[Callable[..., Array], list[Layout]]:
        layouts = tuple(x.layout if isinstance(x, Columns) else None for x in given)
        if layouts not in self._compiled:
            self._compiled.setdefault(layouts, self._build(layouts))
        return self._compiled[layouts]

    def _build(self, layouts: Sequence[Layout | None]) -> tuple[Callable[..., Array], list[Layout]]:
        found: list[Layout] = []  # of the result, known when it has been traced

        def run(*arrays: Array) -> Array:
            trees = [
                x if layout is None else layout.read(x, _as)
                for x, layout in zip(arrays, layouts, strict=True)
            ]
            leaves, structure = jax.tree.flatten(self._function(*trees))
            found[:] = [layout_of(structure, leaves)]
            flat = [_as(x, CARRIED["u"]).reshape(len(x), -1) for x in leaves]
            return jnp.concatenate(flat, axis=1)

        return jax.jit(run, compiler_options=known_options(self._small) | self._options), found


def _as(x: Array, dtype: np.dtype) -> Array:
    """The bits of numbers, read as of another type of 32 bits."""
    return x.astype(dtype) if x.dtype == bool else jax.lax.bitcast_convert_type(x, dtype)
