"""States as compiled programs hand them to each other: without the leaves that are empty."""

from __future__ import annotations

from typing import Any

import jax


class Carried:
    """Takes states of one structure apart and puts them together again.

    Every array that enters or leaves a compiled program takes time of the thread that calls it, also where it has no entries, as
    the fields of ``mjx.Data`` for what a scene does not have.

    Args:
        state: any one of them.
    """

    def __init__(self, state: Any):
        leaves, self._structure = jax.tree.flatten(state)
        self._empty = [None if x.size else x for x in leaves]

    def arrays(self, state: Any) -> list[Any]:
        """The leaves of a state that have entries."""
        leaves = self._structure.flatten_up_to(state)
        return [x for x, empty in zip(leaves, self._empty, strict=True) if empty is None]

    def state(self, arrays: list[Any]) -> Any:
        """The state that ``arrays`` are of."""
        given = iter(arrays)
        leaves = [next(given) if empty is None else empty for empty in self._empty]
        return self._structure.unflatten(leaves)


__all__ = ["Carried"]
