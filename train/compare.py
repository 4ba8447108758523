"""Test whether one setting is better than another: ``agym-jax compare runs_a/FeedingSawyer-v0 runs_b/FeedingSawyer-v0``.

Evaluates the policies of all seeds of two runs (``--num-seeds``) on the same episodes, and prints interquartile means
and the probability that a seed of the first run is better than one of the second.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import jax
import numpy as np
import tyro

from agym_jax.data.npz import check_appendable
from agym_jax.errors import checked_count
from agym_jax.flags import Count, plain
from agym_jax.policy.check import trained_otherwise

from .envs import changed, make_env
from .errors import ConfigError, reports_errors
from .evaluation.evaluator import Evaluator
from .evaluation.seed_scores import SeedScores, score_seeds
from .evaluation.statistics import improvement_interval, probability_of_improvement
from .runs.record import append_record, record
from .select import load_seeds, say

MORE = {"successes": "more successes", "returns": "a higher return"}
SAME = {"successes": "the same number of successes", "returns": "the same return"}


@dataclass(frozen=True)
class CompareConfig:
    """Flags of ``agym-jax compare``."""

    runs: Annotated[tuple[str, str], tyro.conf.Positional, tyro.conf.arg(metavar="RUN RUN")]
    """Folders of two runs with several seeds, of the same environment."""
    num_episodes: Count = 1000
    """Number of episodes per policy, all run in parallel."""
    seed: int = 1001
    """Seed of the episodes, the same for all policies."""
    impl: str = "auto"
    """Physics: "jax", "warp", "native" or "auto"."""
    json: str | None = None
    """File to which the result is appended as a JSON line."""

    def __post_init__(self) -> None:
        """Reject invalid settings before anything is built."""
        checked_count("--num-episodes", self.num_episodes)


def improvement(ours: SeedScores, theirs: SeedScores) -> dict[str, dict[str, Any]]:
    """Return the probability that a seed of the first setting is better than one of the second, by success and by return."""
    found = {}
    for name in ("successes", "returns"):
        a, b = getattr(ours, name).mean(1), getattr(theirs, name).mean(1)
        low, high = improvement_interval(a, b)
        found[name] = {"probability": probability_of_improvement(a, b), "low": low, "high": high}
    return found


@reports_errors
def main(
    arguments: Sequence[str] | None = None,
    make: Callable[..., Any] = make_env,
    prog: str = f"python -m {__package__}.compare",
) -> int:
    """Run the command line and return the exit status."""
    config = tyro.cli(CompareConfig, prog=prog, args=arguments, description=plain(__doc__))
    runs = [Path(run).resolve() for run in config.runs]
    if config.json:
        check_appendable(config.json)
    env, first = load_seeds(runs[0], make, config.impl)

    def same(name: str, *_: Any, **__: Any) -> Any:
        if name != env.name:
            raise ConfigError(
                f"{env.name} and {name} are different environments; compare two runs of the same one."
            )
        return env

    _, second = load_seeds(runs[1], same, config.impl)
    evaluator, key = Evaluator(env, config.num_episodes), jax.random.PRNGKey(config.seed)
    scores = []
    for run, policies in zip(config.runs, (first, second), strict=True):
        say(f"{run}: {config.num_episodes} episodes of each seed")
        otherwise = trained_otherwise(next(iter(policies.values())), env)
        if otherwise:
            say(f"{run} was trained otherwise: {otherwise}.")
        scores.append(score_seeds(evaluator, policies, key, report=say))
    for run, found in zip(config.runs, scores, strict=True):
        print(f"{run}\n{found.table()}")
    better = improvement(*scores)
    for name, x in better.items():
        if np.ptp(np.concatenate([getattr(found, name).mean(1) for found in scores])) == 0:
            print(f"All seeds of both runs have {SAME[name]}.")
            continue
        print(
            f"A seed of the first run has {MORE[name]} than one of the second with probability "
            f"{x['probability']:.0%} (95 % interval {x['low']:.0%} to {x['high']:.0%})"
        )
    if config.json:
        sides = [found.summary() for found in scores]
        line = record(
            "comparison", runs=list(config.runs), seed=config.seed,
            impl=str(getattr(env, "impl", config.impl)), **changed(env),
            first=sides[0], second=sides[1], **better,
        )  # fmt: skip
        append_record(config.json, line)
    return 0


if __name__ == "__main__":
    sys.exit(main())
