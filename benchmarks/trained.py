"""Among whom policies were trained, in the words of the tables."""

from __future__ import annotations

from agym_jax.changes import flags_of
from agym_jax.memory import MEMORY
from benchmarks.markdown import Line


def trained_among(line: Line) -> str:
    """Whether people of every size were among those in training, and what else was not as in the environment's id."""
    changes = dict(line.get("trained_with") or {})
    changes.pop(MEMORY, None)
    both = changes.pop("humans.sizes", None) == "both"
    others = f", `{flags_of(changes)}`" if changes else ""
    return ", people of both kinds of size" * both + others
