"""States in the form passed between compiled programs: without their empty leaves."""

from __future__ import annotations

from typing import Any

import jax


class Carried:
    """Splits states of one structure into arrays and reassembles them.

    Every array that enters or leaves a compiled program costs the calling thread time, even if it is empty, as are the
    fields of ``mjx.Data`` for features that a scene does not use.

    Args:
        state: any state of that structure.
    """

    def __init__(self, state: Any):
        leaves, self._structure = jax.tree.flatten(state)
        self._empty = [None if x.size else x for x in leaves]

    def arrays(self, state: Any) -> list[Any]:
        """Return the leaves of a state that are not empty."""
        leaves = self._structure.flatten_up_to(state)
        return [x for x, empty in zip(leaves, self._empty, strict=True) if empty is None]

    def state(self, arrays: list[Any]) -> Any:
        """Reassemble the state from its ``arrays``."""
        given = iter(arrays)
        leaves = [next(given) if empty is None else empty for empty in self._empty]
        return self._structure.unflatten(leaves)


__all__ = ["Carried"]
