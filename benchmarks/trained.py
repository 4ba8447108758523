"""How policies were trained, in the words of the tables: among whom, and with which statistics of the observation."""

from __future__ import annotations

from agym_jax.changes import flags_of
from agym_jax.memory import MEMORY
from benchmarks.markdown import Line

KEPT_SINCE = "2026-11-29T05:05"
"""Start of the first training (UTC) in which a policy that it starts from keeps the statistics by which its observation is normalised. Before,
they went on changing, and the policy with them."""


SIZES = {None: "", "both": ", people of both kinds of size", "continuous": ", people of every size"}
"""Setting ``humans.sizes`` of a training, None: that of the id -> what is said of it."""


def trained_among(line: Line) -> str:
    """Whether people of every size were among those in training, and what else was not as in the environment's id."""
    changes = dict(line.get("trained_with") or {})
    changes.pop(MEMORY, None)
    sizes = SIZES[changes.pop("humans.sizes", None)]
    others = f", `{flags_of(changes)}`" if changes else ""
    return sizes + others


def statistics(training: Line) -> dict[str, str | None]:
    """Whether the statistics of a policy that training started from were "kept" or did "drift"; None if all policies were new."""
    begun = training["started_from"] or training["person_started_from"]
    return {
        "statistics": None if not begun else "kept" if training["time"] >= KEPT_SINCE else "drift"
    }
