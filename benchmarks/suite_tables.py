"""Tables of ``benchmarks.tables`` about suites: what all seeds of all environments achieve that one command trained."""

from __future__ import annotations

from collections.abc import Sequence
from operator import itemgetter
from pathlib import Path

from agym_jax.registry import parse
from benchmarks.markdown import NOTHING, RESULTS, Line, grid, read_results, several
from benchmarks.policy_tables import (
    rows_of_seeds,
    seeds_and_steps,
    seeds_in_percent,
    signed,
    worst_and_mean,
)
from benchmarks.trained import trained_among
from train.runs import overview
from train.runs.progress import duration


def suite(folder: Path = RESULTS) -> str:
    """What the seeds of the newest suite of robots without a cost limit achieve, all trained by one command, and how long the whole took."""
    found = newest_suite(folder, active=False, limited=False)
    return _suite(found, _of_seeds(found))


def suite_gentle(folder: Path = RESULTS) -> str:
    """The same of the newest suite of robots under a cost limit, beside the policies that they began with."""

    def figures(x: Line) -> str:
        return f"{x['success']:.1%}, {x['gentle_success']:.1%}"

    def limit(x: Line) -> str:
        return ", ".join(f"{x[name] or 0:g}" for name in ("cost_limit", "cost_multiplier_max", "cost_margin"))  # fmt: skip

    columns = {
        "environment": lambda x: x["env"],
        "seeds x steps": lambda x: seeds_and_steps(x) + trained_among(x),
        "limit, largest multiplier, margin": lambda x: limit(x["training"]),
        "success of each seed [%]": lambda x: seeds_in_percent(x["success_of_seeds"]),
        "worst, interquartile mean": worst_and_mean,
        "gentle success of each seed [%]": lambda x: seeds_in_percent(x["gentle_success_of_seeds"]),
        "chosen seed, over other people: success, gentle success": lambda x: (
            f"{x['chosen']}: {figures(x['reported'])}"
        ),
        "the policy before": lambda x: figures(x["shipped"]),
    }
    found = newest_suite(folder, active=False, limited=True)
    rows = [[column(x) for column in columns.values()] for x in found]
    return _suite(found, [tuple(columns), *signed(rows, found)])


def suite_pairs(folder: Path = RESULTS) -> str:
    """What the seeds of the newest suite of pairs achieve."""
    found = newest_suite(folder, active=True)
    return _suite(found, _of_seeds(found))


def newest_suite(folder: Path, active: bool, limited: bool | None = None) -> list[Line]:
    """The results of the newest suite of its kind, by environment.

    Args:
        folder: of the results.
        active: whether the person acts.
        limited: whether it was trained under a cost limit; None: either.
    """
    lines = read_results("suite", ("env", "time"), folder)

    def fits(x: Line) -> bool:
        under = x["training"].get("cost_limit") is not None
        return parse(x["env"]).active == active and limited in (None, under)

    found = [x for x in lines if fits(x)]
    if not found:
        return []
    whole = max(found, key=itemgetter("time"))["suite"]
    return sorted((x for x in found if x["suite"] == whole), key=itemgetter("env"))


def _suite(lines: Sequence[Line], rows: Sequence[Sequence[str]]) -> str:
    """A table of a suite, with what the whole took; ``rows`` have the headings first."""
    if not lines:
        return NOTHING
    whole = lines[0]["suite"]
    steps = sum(len(x["seeds"]) * x["num_env_steps"] for x in lines)
    episodes = several(f"{x['episodes']:,}" for x in lines)
    note = (
        f"{len(lines)} environments, {steps / 1e9:.2f} billion steps in all, trained and evaluated in {duration(whole['seconds'])} on "
        f"{whole['gpus']} GPU{'s' * (whole['gpus'] > 1)}, by processes that took {duration(whole['process_seconds'])} in all; "
        f"{episodes} episodes of each seed, mode;"
    )
    return grid(rows, lines, note)


def _of_seeds(lines: Sequence[Line]) -> list[Sequence[str]]:
    return [overview.HEADINGS, *rows_of_seeds(lines, [x["training"] for x in lines])]
