"""Statistics over seeds and episodes, following the recommendations for reporting in reinforcement learning.

Agarwal et al. 2021, "Deep reinforcement learning at the edge of the statistical precipice": interquartile mean over
seeds, intervals by the stratified bootstrap, probability of improvement between two settings.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

RESAMPLES = 2000


def iqm(scores: Any, axis: int = -1) -> Any:
    """Compute the interquartile mean: the mean without the lowest and the highest quarter.

    If a quarter is not a whole number of scores, the next score is weighted partially, so that the result varies
    continuously; for up to three scores, or equal scores, it is close or equal to the mean.

    Args:
        scores: (..., n, ...).
        axis: axis of the n scores.

    Returns:
        A float, or an array without that axis.

    Raises:
        ValueError: if there are no scores.
    """
    ordered = np.sort(np.moveaxis(np.asarray(scores, float), axis, -1), axis=-1)
    n = ordered.shape[-1]
    if n == 0:
        raise ValueError("The interquartile mean needs at least one score.")
    place = np.arange(n)
    inside = np.minimum(place + 1, 0.75 * n) - np.maximum(place, 0.25 * n)
    mean = ordered @ (np.maximum(inside, 0.0) / (0.5 * n))
    return float(mean) if np.ndim(mean) == 0 else mean


def bootstrap_interval(
    scores: Any,
    statistic: Callable[[np.ndarray], np.ndarray] = iqm,
    confidence: float = 0.95,
    resamples: int = RESAMPLES,
    seed: int = 0,
) -> tuple[float, float]:
    """Compute a bootstrap interval of a statistic over seeds, resampling seeds and the episodes within each seed.

    Args:
        scores: score of each episode of each seed (seeds, episodes); a single column to resample seeds only.
        statistic: statistic of the seeds' mean scores, (resamples, seeds) -> (resamples,).
        confidence: fraction of the resamples within the interval.
        resamples: number of resamples.
        seed: seed of the resampling.

    Returns:
        Lower and upper bound.
    """
    scores = np.asarray(scores, float)
    seeds, episodes = scores.shape
    rng = np.random.default_rng(seed)
    if episodes == 1:
        # at once: training computes several in every line of its curve, while a GPU waits
        drawn = scores[rng.integers(0, seeds, (resamples, seeds)), 0]
    else:
        drawn = np.empty((resamples, seeds))
        for i in range(resamples):
            rows = scores[rng.integers(0, seeds, seeds)]
            rows = np.take_along_axis(rows, rng.integers(0, episodes, rows.shape), axis=1)
            drawn[i] = rows.mean(axis=1)
    low, high = np.quantile(statistic(drawn), [(1 - confidence) / 2, (1 + confidence) / 2])
    return float(low), float(high)


def probability_of_improvement(ours: Any, theirs: Any) -> float:
    """Return the probability that a seed of one setting scores higher than a seed of another; ties count half.

    Args:
        ours: score of each seed (n,).
        theirs: score of each seed (m,).
    """
    difference = np.asarray(ours, float)[:, None] - np.asarray(theirs, float)[None]
    return float(np.mean((difference > 0) + 0.5 * (difference == 0)))


def improvement_interval(
    ours: Any, theirs: Any, confidence: float = 0.95, resamples: int = RESAMPLES, seed: int = 0
) -> tuple[float, float]:
    """Compute a bootstrap interval of ``probability_of_improvement``, resampling the seeds of both settings.

    Args:
        ours: score of each seed (n,).
        theirs: score of each seed (m,).
        confidence: fraction of the resamples within the interval.
        resamples: number of resamples.
        seed: seed of the resampling.
    """
    rng = np.random.default_rng(seed)
    ours, theirs = np.asarray(ours, float), np.asarray(theirs, float)
    drawn = [
        probability_of_improvement(
            ours[rng.integers(0, len(ours), len(ours))],
            theirs[rng.integers(0, len(theirs), len(theirs))],
        )
        for _ in range(resamples)
    ]
    low, high = np.quantile(drawn, [(1 - confidence) / 2, (1 + confidence) / 2])
    return float(low), float(high)
