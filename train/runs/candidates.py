"""Which candidates of a run continue: one for each seed, by success and return at the end of what they were trained for.

This is one round of successive halving (Jamieson and Talwalkar 2016, "Non-stochastic best arm identification and hyperparameter
optimization") over random numbers instead of hyper-parameters.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ..configs import LearnConfig
from ..errors import CheckpointMismatchError
from ..learning.agents import Agents
from ..learning.seeds import SideBySide, candidates_of, lanes_of, stacked
from .curve import Row
from .manager import CheckpointManager
from .overview import CANDIDATES
from .result import TrainResult

NEWEST = 0.05
"""Fraction of a run, before the choice, in which success and return are measured."""


def score(curve: Sequence[Row], total_steps: int, limited: bool = False) -> tuple[float, float]:
    """How good a training is at the end of its curve; larger is better.

    Success comes before return because what has the larger return is often what cannot be improved: a sleeve held beside the hand
    (docs/rare_success.md, "Candidates").

    Args:
        curve: its rows.
        total_steps: environment steps of the whole run.
        limited: whether it is trained under a cost limit; then gentle successes count as much as all of them.

    Returns:
        The success rate of the episodes that ended in the newest rows (0 if none did), with a limit the mean of that and the rate of
        gentle successes; and the mean return. Of an empty curve, 0 and minus infinity.
    """
    if not curve:
        return 0.0, -np.inf
    begin = curve[-1]["env_steps"] - NEWEST * total_steps
    newest = [row for row in curve if row["env_steps"] > begin]
    names = ("success", "gentle") if limited else ("success",)
    ended = [row for row in newest if all(row.get(name) is not None for name in names)]
    rate = 0.0
    if weights := [row["episodes"] for row in ended]:
        rate = float(np.average([np.mean([row[x] for x in names]) for row in ended], None, weights))
    return rate, float(np.mean([row["return_per_step"] for row in newest]))


def hand_over(
    before: TrainResult,
    config: LearnConfig,
    single: Agents,
    manager: CheckpointManager,
    say: Callable[[str], None],
) -> Any:
    """Choose the candidates with the largest scores, and begin the curves of the run with theirs.

    Args:
        before: result of all candidates, in the order of ``candidates_of``.
        config: of the run.
        single: the agents of one training.
        manager: of the run.
        say: is told which candidates continue.

    Returns:
        The learner of the run. A seed of which all candidates diverged is stopped.
    """
    count, limited = config.num_candidates, config.cost_limit is not None
    chosen, numbers = [], {}
    for i, lane in enumerate(lanes_of(config)):
        group = range(i * count, (i + 1) * count)
        sound = [j for j in group if not before.seeds[j].stopped]
        scores = {j: score(before.seeds[j].curve, config.num_env_steps, limited) for j in group}
        chosen.append(max(sound or group, key=lambda j, scores=scores: scores[j]))
        numbers[lane.name] = chosen[-1] - group.start + 1
        if not sound:
            manager.stopped[lane.name] = before.seeds[chosen[-1]].stopped
    manager.candidates = {
        "count": count, "until": config.candidates_until, "chosen": numbers,
        "rule": "success and gentle success" if limited else "success",
    }  # fmt: skip
    manager.continue_curves([list(before.seeds[j].curve) for j in chosen])
    each = ", ".join(f"candidate {number} of {name}" for name, number in numbers.items())
    say(f"Continuing with the best candidates: {each}.")
    learners = SideBySide(single, candidates_of(config)).of_seeds(before.learner)
    return stacked([learners[j] for j in chosen])


def refuse_unfinished(run: Path, config: LearnConfig) -> None:
    """Refuse to start from nothing beside the candidates of a run that was interrupted.

    Raises:
        CheckpointMismatchError: there are such.
    """
    if config.num_candidates == 1 and any((run / CANDIDATES / "checkpoints").glob("step_*.npz")):
        raise CheckpointMismatchError(
            f"{str(run)!r} has candidates of which none has been chosen yet. Continue them with --num-candidates as before, "
            f"choose another --save-dir, or start over with --fresh (which moves the folder aside)."
        )


def say_what_stays(
    begun: dict[str, Any] | None, config: LearnConfig, say: Callable[[str], None]
) -> None:
    """Say if a run that goes on began with other candidates than are asked for now.

    Args:
        begun: ``CheckpointManager.candidates``.
        config: of the run.
        say: is told.
    """
    asked = (config.num_candidates, config.candidates_until) if config.num_candidates > 1 else None
    had = (begun["count"], begun["until"]) if begun else None
    if had != asked:
        many = (
            f"{had[0]} candidates for each seed, until {had[1]:.0%} of the steps"
            if had
            else "no candidates"
        )
        say(
            f"This run began with {many}; --num-candidates and --candidates-until have no effect on it now."
        )
