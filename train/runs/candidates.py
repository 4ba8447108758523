"""Which candidates of a run continue: one for each seed, by success and return of the newest steps.

This is one round of successive halving (Jamieson and Talwalkar 2016, "Non-stochastic best arm identification and hyperparameter
optimization") over random numbers instead of hyper-parameters.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..configs import LearnConfig
from ..learning.agents import Agents
from ..learning.seeds import SideBySide, candidates_of, lanes_of, stacked
from .curve import Row, combine_rows
from .manager import CheckpointManager
from .result import TrainResult

ROWS = 4  # newest rows of a curve that count: 5 % of a run


@dataclass(frozen=True)
class Chosen:
    """The candidates that continue.

    Attributes:
        learner: of the run that continues them.
        curves: of each seed, so far.
        stopped: why a seed cannot continue, where all of its candidates diverged; by the seed's name.
        numbers: which candidate it is, from 1, by the seed's name.
    """

    learner: Any
    curves: list[list[Row]]
    stopped: dict[str, str]
    numbers: dict[str, int]

    def words(self) -> str:
        """Which candidates continue."""
        each = ", ".join(f"{number} of {name}" for name, number in self.numbers.items())
        return f"Of the candidates, the best continue: {each}."

    def hand_over(self, manager: CheckpointManager, seconds: float) -> None:
        """Put the curves so far, and the seconds they took, at the beginning of those of a run."""
        manager.curves, manager.stopped = self.curves, dict(self.stopped)
        if len(self.curves) == 1:
            manager.combined = manager.curves[0]
        else:
            going = [curve for curve in self.curves if curve]
            manager.combined = [combine_rows(rows) for rows in zip(*going, strict=True)]
        manager.seconds = seconds


def score(curve: Sequence[Row]) -> tuple[float, float]:
    """How good a training is, larger is better: its success rate, then its return (of an empty curve, -inf), of the newest rows.

    Success comes first because what has the larger return is often what cannot be improved: a sleeve held beside the hand
    (docs/seeds.md, "Candidates").
    """
    newest = curve[-ROWS:]
    if not newest:
        return 0.0, -np.inf
    success = [row["success"] for row in newest if row["success"] is not None]
    returns = [row["return_per_step"] for row in newest]
    return float(np.mean(success)) if success else 0.0, float(np.mean(returns))


def choose(result: TrainResult, config: LearnConfig, single: Agents) -> Chosen:
    """The candidates with the largest scores.

    Args:
        result: of all candidates, in the order of ``candidates_of``.
        config: of the run.
        single: the agents of one training.
    """
    lanes, count = lanes_of(config), config.num_candidates
    learners = SideBySide(single, candidates_of(config)).of_seeds(result.learner)
    best, stopped, numbers = [], {}, {}
    for i, lane in enumerate(lanes):
        group = range(i * count, (i + 1) * count)
        sound = [j for j in group if not result.seeds[j].stopped]
        best.append(max(sound or group, key=lambda j: score(result.seeds[j].curve)))
        numbers[lane.name] = best[-1] - group.start + 1
        if not sound:
            stopped[lane.name] = result.seeds[best[-1]].stopped
    curves = [list(result.seeds[j].curve) for j in best]
    return Chosen(stacked([learners[j] for j in best]), curves, stopped, numbers)
