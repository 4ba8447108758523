"""Scores of the policies of several seeds on the same episodes, and statistics of their setting."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

import jax
import numpy as np

from agym_jax.metrics import TASK_PREFIX
from agym_jax.policy.agents import AnyPolicy

from .evaluator import Evaluator
from .score import EvaluationResult
from .statistics import bootstrap_interval, iqm

Measure = Literal["success", "gentle", "both"]


@dataclass(frozen=True)
class SeedScores:
    """Results of each seed of one setting.

    Attributes:
        results: seed -> its evaluation, on the same episodes.
        by: what seeds are ranked by: success, gentle success, or the sum of both; if gentle success is not measured, by
            success.
        at_least: measure of the task -> what its mean over the episodes has to be; seeds that miss one rank behind all others.
    """

    results: Mapping[int, EvaluationResult]
    by: Measure = "success"
    at_least: Mapping[str, float] = field(default_factory=dict)

    @property
    def successes(self) -> np.ndarray:
        """Successes: 1 if an episode succeeded (seeds, episodes)."""
        return np.stack([np.asarray(x.successes, float) for x in self.results.values()])

    @property
    def of_some(self) -> float:
        """Share of the episodes in which at least one seed succeeds: the others may be too hard for any policy."""
        return float(self.successes.max(0).mean())

    @property
    def of_all(self) -> float:
        """Share of the episodes in which every seed succeeds."""
        return float(self.successes.min(0).mean())

    @property
    def returns(self) -> np.ndarray:
        """Returns (seeds, episodes)."""
        return np.stack([x.returns for x in self.results.values()])

    @property
    def best(self) -> int:
        """The first seed by this measure, among those that fulfil ``at_least``; ties are broken by success, then by the return."""
        return max(self.results, key=lambda seed: (self.fulfils(seed), self._rank(seed)))

    @property
    def worst(self) -> int:
        """The last seed by this measure; ties are broken by success, then by the return."""
        return min(self.results, key=self._rank)

    def fulfils(self, seed: int) -> bool:
        """Return whether the measures of a seed are as large as ``at_least`` asks; False if they are not measured."""
        outcome = self.results[seed].outcome
        means = outcome.summary() if outcome else {}
        return all(means.get(TASK_PREFIX + x, -np.inf) >= low for x, low in self.at_least.items())

    def _rank(self, seed: int) -> tuple[float, float, float]:
        found = self.results[seed]
        gentle = found.gentle_success
        if self.by == "success" or gentle is None:
            first = found.success
        else:
            first = gentle if self.by == "gentle" else found.success + gentle
        return first, found.success, float(found.returns.mean())

    def table(self) -> str:
        """Format the seeds and their statistics as a table."""
        first = next(iter(self.results.values()))
        lines = [f"{first.env}, {len(self.results)} seeds, {first.episodes} episodes each"]
        for seed, x in self.results.items():
            gentle = "" if x.gentle_success is None else f"   gentle {x.gentle_success:6.1%}"
            lines.append(
                f"  seed {seed:<4} success {x.success:6.1%}{gentle}   return {x.returns.mean():9.2f}   "
                f"force {x.forces.mean():6.2f} N{_least(x, '   least helped: ')}{_outcome(x, '   ')}"
            )
        for name, scores, form in (
            ("success", self.successes, "{:.1%}"),
            ("return", self.returns, "{:.2f}"),
        ):
            low, high = bootstrap_interval(scores)
            shown = [form.format(x) for x in (iqm(scores.mean(1)), low, high)]
            lines.append(
                "  interquartile mean of {}: {}   95 % interval {} to {}".format(name, *shown)
            )
        if len(self.results) > 1:
            lines.append(
                f"  of the same episodes, some seed succeeds in {self.of_some:.1%}, every seed in {self.of_all:.1%}"
            )
        return "\n".join(lines)

    def summary(self) -> dict[str, Any]:
        """Return the same as fields of a JSON line."""
        first = next(iter(self.results.values()))
        gentle = {}
        if first.gentle_success is not None:
            gentle["gentle_success_of_seeds"] = [x.gentle_success for x in self.results.values()]
        least = [x.least_helped for x in self.results.values()]
        groups = {"least_helped_of_seeds": [x and vars(x) for x in least]} if any(least) else {}
        ends = [x.outcome and x.outcome.summary() for x in self.results.values()]
        outcomes = {"outcome_of_seeds": ends} if any(ends) else {}
        success, returns = bootstrap_interval(self.successes), bootstrap_interval(self.returns)
        return {
            "env": first.env,
            "episodes": first.episodes,
            "seeds": list(self.results),
            "success_of_seeds": [x.success for x in self.results.values()],
            "success_of_some": self.of_some,
            "success_of_all": self.of_all,
            **gentle,
            **groups,
            **outcomes,
            "return_of_seeds": [float(x.returns.mean()) for x in self.results.values()],
            "force_of_seeds": [float(x.forces.mean()) for x in self.results.values()],
            "success_iqm": iqm(self.successes.mean(1)),
            "success_iqm_low": success[0],
            "success_iqm_high": success[1],
            "return_iqm": iqm(self.returns.mean(1)),
            "return_iqm_low": returns[0],
            "return_iqm_high": returns[1],
            **({"at_least": dict(self.at_least)} if self.at_least else {}),
            "worst": self.worst,
            "best": self.best,
            "nan_episodes": sum(int(x.nan.sum()) for x in self.results.values()),
            "overflow": sum(x.overflow for x in self.results.values()),
        }


def score_seeds(
    evaluator: Evaluator,
    policies: Mapping[int, AnyPolicy],
    key: jax.Array,
    deterministic: bool = True,
    by: Measure = "success",
    report: Callable[[str], None] | None = None,
    at_least: Mapping[str, float] | None = None,
) -> SeedScores:
    """Run the same episodes with the policy of each seed.

    Args:
        evaluator: evaluator of the environment.
        policies: seed -> policy.
        key: determines the episodes.
        deterministic: act by the mode of the policies' distributions.
        by: what seeds are ranked by.
        report: called with the success of each seed in words, as soon as it is known.
        at_least: as in ``SeedScores``.
    """
    results: dict[int, EvaluationResult] = {}
    for seed, policy in policies.items():
        results[seed] = found = evaluator(policy, key, deterministic)
        gentle = "" if found.gentle_success is None else f", gently in {found.gentle_success:.1%}"
        if report:
            more = _least(found, "; least helped: ") + _outcome(found, "; ")
            report(
                f"{len(results)} of {len(policies)}: seed {seed} succeeds in {found.success:.1%}{gentle}{more}"
            )
    return SeedScores(results, by, at_least or {})


def _least(result: EvaluationResult, before: str) -> str:
    """The group that a policy helps least, in words; empty if there is none."""
    least = result.least_helped
    return "" if least is None else f"{before}{least.name}, {least.success:.1%}"


def _outcome(result: EvaluationResult, before: str) -> str:
    """How a policy's episodes end in the task's own measures, in words; empty if it has none."""
    end = result.outcome and result.outcome.in_words()
    return f"{before}{end}" if end else ""
