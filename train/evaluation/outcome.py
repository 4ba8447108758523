"""Progress of a task in practical units, and the time it took."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import jax
import numpy as np

from agym_jax.metrics import TASK_PREFIX
from agym_jax.spec import Ending, Measure

UNDONE = "undone_until"
"""Name of a maximum among the sums: the last step after which the task was not done."""


def in_words(measure: Measure, value: float) -> str:
    """Format a measure's value: "35% wiped", "0.58 m distance"."""
    if measure.unit == "1" and measure.words.startswith("share"):
        return f"{value:.0%} {measure.name}"
    return f"{value:.3g}{'' if measure.unit == '1' else f' {measure.unit}'} {measure.name}"


def ways_in_words(failures: Mapping[str, int]) -> str:
    """Format how episodes failed, the most frequent way first: "nothing drunk (12), more than a quarter spilled (5)"."""
    found = sorted(failures.items(), key=lambda x: -x[1])
    return ", ".join(f"{words} ({n})" for words, n in found)


@dataclass(frozen=True)
class Outcome:
    """How the episodes ended; arrays have one entry per episode.

    Attributes:
        measures: measures of the task.
        values: name of each measure -> its value at the last step    (episodes,).
        times: time from which the task remained done until the end [s]; NaN if it was not    (episodes,).
        endings: ways to fail that the task tells apart.
    """

    measures: tuple[Measure, ...]
    values: Mapping[str, np.ndarray]
    times: np.ndarray
    endings: tuple[Ending, ...] = ()

    @property
    def failures(self) -> dict[str, int]:
        """How many of the failed episodes end in each of ``endings``; each counts once."""
        left, found = ~np.isfinite(self.times), dict[str, int]()
        for ending in self.endings:
            value = self.values[ending.measure]
            mine = left & (value >= ending.low) & (value < ending.high)
            found[ending.words], left = int(mine.sum()), left & ~mine
        return {words: n for words, n in found.items() if n}

    @property
    def median_time(self) -> float | None:
        """Median time of the successful episodes [s]; None if there are none."""
        done = self.times[np.isfinite(self.times)]
        return float(np.median(done)) if len(done) else None

    def rows(self) -> list[tuple[str, str]]:
        """Return rows of a table: name, value."""
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
        if self.failures:
            total = int((~np.isfinite(self.times)).sum())
            found.append(("episodes that fail", f"{total:9d}   {ways_in_words(self.failures)}"))
        return found

    def in_words(self) -> str:
        """Return the means of the measures in few words: "76% covered, 2% held"."""
        return ", ".join(in_words(x, float(self.values[x.name].mean())) for x in self.measures)

    def summary(self) -> dict[str, Any]:
        """Return the same as fields of a JSON line."""
        means = {f"{TASK_PREFIX}{x.name}": float(self.values[x.name].mean()) for x in self.measures}
        failures = {"failures": self.failures} if self.endings else {}
        return means | {"time_to_success": self.median_time} | failures


def zero_outcome(state: Any, zeros: jax.Array) -> dict[str, jax.Array]:
    """Return initial sums and maxima for ``outcome_gains``."""
    names = [name for name in state.metrics if name.startswith(TASK_PREFIX)]
    return dict.fromkeys([*names, UNDONE], zeros)


def outcome_gains(state: Any, steps: jax.Array) -> dict[str, jax.Array]:
    """Return the contributions of one step of all environments, under the names of ``zero_outcome``.

    Args:
        state: state after the step.
        steps: steps taken in each episode, including this one (B,).
    """
    metrics = state.metrics
    gains = {
        name: value * state.done for name, value in metrics.items() if name.startswith(TASK_PREFIX)
    }
    return gains | {UNDONE: steps * (1 - metrics.get("success", 0.0))}


def outcome_of(env: Any, sums: Mapping[str, np.ndarray], successes: np.ndarray) -> Outcome:
    """Compute the outcome from the sums over all steps.

    Args:
        env: environment whose task has measures.
        sums: NumPy arrays.
        successes: whether the task was done at the last step (episodes,).
    """
    measures = getattr(getattr(env, "task", None), "measures", ())
    known = tuple(x for x in measures if f"{TASK_PREFIX}{x.name}" in sums)
    times = np.where(successes, (sums[UNDONE] + 1) * getattr(env, "dt", 0.1), np.nan)
    values = {x.name: sums[f"{TASK_PREFIX}{x.name}"] for x in known}
    endings = getattr(getattr(env, "task", None), "endings", ())
    return Outcome(known, values, times, tuple(x for x in endings if x.measure in values))
