"""How far a task got in the units of care, and how long it took."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import jax
import numpy as np

from agym_jax.metrics import TASK_PREFIX
from agym_jax.spec import Measure

UNDONE = "undone_until"
"""Of the sums, a maximum: the last step after which the task was not done."""


def in_words(measure: Measure, value: float) -> str:
    """A measure's value: "35% wiped", "0.58 m distance"."""
    if measure.unit == "1" and measure.words.startswith("share"):
        return f"{value:.0%} {measure.name}"
    return f"{value:.3g}{'' if measure.unit == '1' else f' {measure.unit}'} {measure.name}"


@dataclass(frozen=True)
class Outcome:
    """How the episodes ended; arrays have one entry an episode.

    Attributes:
        measures: of the task.
        values: name of each measure -> its value at the last step    (episodes,).
        times: from when on the task was done until the end [s]; NaN where it was not    (episodes,).
    """

    measures: tuple[Measure, ...]
    values: Mapping[str, np.ndarray]
    times: np.ndarray

    @property
    def median_time(self) -> float | None:
        """Median of the times of the successes [s]; None if there is none."""
        done = self.times[np.isfinite(self.times)]
        return float(np.median(done)) if len(done) else None

    def rows(self) -> list[tuple[str, str]]:
        """Lines of a table: name, value."""
        found = []
        for measure in self.measures:
            low, middle, high = np.quantile(self.values[measure.name], (0.25, 0.5, 0.75))
            unit = "" if measure.unit == "1" else f" [{measure.unit}]"
            mean = self.values[measure.name].mean()
            text = f"{mean:9.3g}   {measure.words}; quartiles {low:.3g}, {middle:.3g}, {high:.3g}"
            found.append((measure.name + unit, text))
        if self.median_time is not None:
            done = self.times[np.isfinite(self.times)]
            high = float(np.quantile(done, 0.9))
            found.append(("time to success [s]", f"{self.median_time:9.1f}   median; 90 % within {high:.1f}"))  # fmt: skip
        return found

    def summary(self) -> dict[str, Any]:
        """The same for a JSON line."""
        means = {f"{TASK_PREFIX}{x.name}": float(self.values[x.name].mean()) for x in self.measures}
        return means | {"time_to_success": self.median_time}


def zero_outcome(state: Any, zeros: jax.Array) -> dict[str, jax.Array]:
    """What ``outcome_gains`` is added to, or the largest of."""
    names = [name for name in state.metrics if name.startswith(TASK_PREFIX)]
    return dict.fromkeys([*names, UNDONE], zeros)


def outcome_gains(state: Any, steps: jax.Array) -> dict[str, jax.Array]:
    """Of one step of all environments, under the names of ``zero_outcome``.

    Args:
        state: after the step.
        steps: of each episode, this one included (B,).
    """
    metrics = state.metrics
    gains = {
        name: value * state.done for name, value in metrics.items() if name.startswith(TASK_PREFIX)
    }
    return gains | {UNDONE: steps * (1 - metrics.get("success", 0.0))}


def outcome_of(env: Any, sums: Mapping[str, np.ndarray], successes: np.ndarray) -> Outcome:
    """What the sums of all steps make.

    Args:
        env: whose task measures.
        sums: NumPy.
        successes: whether the task was done at the last step (episodes,).
    """
    measures = getattr(getattr(env, "task", None), "measures", ())
    known = tuple(x for x in measures if f"{TASK_PREFIX}{x.name}" in sums)
    times = np.where(successes, (sums[UNDONE] + 1) * getattr(env, "dt", 0.1), np.nan)
    return Outcome(known, {x.name: sums[f"{TASK_PREFIX}{x.name}"] for x in known}, times)
