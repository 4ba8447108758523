"""How gently people were touched in an evaluation: peak forces by region of the body, and steps above limits.

``agym_jax.human.regions`` defines the limits and the forces that count.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from agym_jax.human.regions import NAMES

from ..learning.rollout import COMFORT_KEY, LIMIT_KEY, PEAK_KEY

PEAK, REGION_PEAKS = MAXIMA = "peak", "region_peaks"
"""Names of those sums that are maxima."""
OVER_COMFORT, OVER_LIMIT = "over_comfort", "over_limit"
HIGH = 0.99
"""Quantile of the episodes used instead of the maximum, which would grow with their number."""


@dataclass(frozen=True)
class Gentleness:
    """Forces on the person; arrays have one entry per episode.

    Attributes:
        peaks: largest force on one region of the body in a physics step [N]    (episodes,).
        over_comfort: number of steps above the comfort limit of a region    (episodes,).
        over_limit: number of steps above an ISO limit of a region    (episodes,).
        lengths: number of steps    (episodes,).
        region_peaks: peaks of each region; None if the environment does not report them    (episodes, regions).
        comfort: comfort limit of each region [N]; None if the environment does not report them    (regions,).
    """

    peaks: np.ndarray
    over_comfort: np.ndarray
    over_limit: np.ndarray
    lengths: np.ndarray
    region_peaks: np.ndarray | None = None
    comfort: np.ndarray | None = None

    @property
    def kept(self) -> np.ndarray:
        """Whether no step of the episode was above the comfort limit (episodes,)."""
        return self.over_comfort == 0

    @property
    def share_over_comfort(self) -> float:
        """Fraction of all steps above the comfort limit."""
        return float(self.over_comfort.sum() / max(1, self.lengths.sum()))

    @property
    def share_over_limit(self) -> float:
        """Fraction of all steps above an ISO limit."""
        return float(self.over_limit.sum() / max(1, self.lengths.sum()))

    @property
    def peak_quantiles(self) -> tuple[float, float]:
        """Median and 99 % quantile of the episodes' peaks [N]."""
        median, high = np.quantile(self.peaks, (0.5, HIGH))
        return float(median), float(high)

    @property
    def worst_region(self) -> str | None:
        """The region whose comfort limit is exceeded in most episodes; None if none is touched.

        Among equals, the one whose peaks (99 % quantile) are highest relative to the limit. The quantile alone would not do: with
        few episodes it is interpolated, and may be below the limit of the only region that exceeds it.
        """
        if self.region_peaks is None or self.comfort is None:
            return None
        over = np.mean(self.region_peaks > self.comfort, axis=0)
        relative = np.quantile(self.region_peaks, HIGH, axis=0) / self.comfort
        worst = int(np.lexsort((relative, over))[-1])
        return NAMES[worst] if self.region_peaks[:, worst].any() else None

    def of_region(self, name: str) -> tuple[float, float]:
        """Return the 99 % quantile of a region's peaks [N], and the fraction of episodes that exceed its comfort limit."""
        assert self.region_peaks is not None and self.comfort is not None
        i = NAMES.index(name)
        peaks = self.region_peaks[:, i]
        return float(np.quantile(peaks, HIGH)), float(np.mean(peaks > self.comfort[i]))

    def rows(self) -> list[tuple[str, str]]:
        """Return rows of a table: name, value."""
        median, high = self.peak_quantiles
        rows = [
            ("peak force [N]", f"{median:9.2f}   median of the episodes; 99 % below {high:.2f}"),
            ("steps above comfort", f"{self.share_over_comfort:9.2%}"),
            ("steps above ISO limits", f"{self.share_over_limit:9.2%}"),
        ]
        worst = self.worst_region
        if worst and self.comfort is not None:
            high, share = self.of_region(worst)
            limit = self.comfort[NAMES.index(worst)]
            text = f"{worst:>9}   99 % below {high:.2f} N; above {limit:.0f} N in {share:.1%} of the episodes"
            rows.append(("worst region", text))
        return rows

    def summary(self) -> dict[str, Any]:
        """Return the same as fields of a JSON line."""
        median, high = self.peak_quantiles
        found: dict[str, Any] = {
            "peak_median": median,
            "peak_99": high,
            "over_comfort": self.share_over_comfort,
            "over_limit": self.share_over_limit,
        }
        if self.region_peaks is not None and self.comfort is not None:
            touched = [name for i, name in enumerate(NAMES) if self.region_peaks[:, i].any()]
            found["worst_region"] = self.worst_region
            found["region_peak_99"] = {name: self.of_region(name)[0] for name in touched}
            found["region_over_comfort"] = {name: self.of_region(name)[1] for name in touched}
        return found


def zero_gentleness(state: Any, num_envs: int) -> dict[str, jax.Array]:
    """Return initial sums and maxima for ``gentleness_gains``; empty if environments do not measure it."""
    if COMFORT_KEY not in state.metrics:
        return {}
    sums = dict.fromkeys((PEAK, OVER_COMFORT, OVER_LIMIT), jnp.zeros(num_envs, jnp.float32))
    if getattr(state, "regions", None) is None:
        return sums
    return sums | {REGION_PEAKS: jnp.zeros((num_envs, len(NAMES)), jnp.float32)}


def gentleness_gains(state: Any) -> dict[str, jax.Array]:
    """Return the contributions of one step of all environments, under the names of ``zero_gentleness``."""
    metrics = state.metrics
    if COMFORT_KEY not in metrics:
        return {}
    gains = {
        PEAK: metrics[PEAK_KEY],
        OVER_COMFORT: (metrics[COMFORT_KEY] > 1).astype(jnp.float32),
        OVER_LIMIT: (metrics[LIMIT_KEY] > 1).astype(jnp.float32),
    }
    regions = getattr(state, "regions", None)
    return gains if regions is None else gains | {REGION_PEAKS: regions.peak}


def gentleness_of(sums: Mapping[str, np.ndarray], comfort: Any) -> Gentleness | None:
    """Compute the result from the sums over all steps; None if the environment does not measure it.

    Args:
        sums: NumPy arrays, including the ``length`` of the episodes.
        comfort: comfort limit of each region [N], or None.
    """
    if PEAK not in sums:
        return None
    return Gentleness(
        sums[PEAK],
        sums[OVER_COMFORT],
        sums[OVER_LIMIT],
        sums["length"],
        sums.get(REGION_PEAKS),
        None if comfort is None else np.asarray(comfort),
    )
