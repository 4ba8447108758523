"""Tables of trainings that begin with a policy or have a limit of forces."""

from __future__ import annotations

from collections.abc import Callable
from operator import itemgetter
from pathlib import Path

from agym_jax.registry import parse
from benchmarks.markdown import RESULTS, Line, read_results, several, table
from benchmarks.policy_tables import seeds_and_steps, seeds_in_percent
from benchmarks.suite_tables import newest_suite
from benchmarks.trained import trained_among


def gentle(folder: Path = RESULTS) -> str:
    """What trainings under a cost limit achieve, beside the policy that shipped before.

    Those that lost something as their statistics drifted are left out, where there are others of the same environment.
    """

    def figures(x: Line | None) -> str:
        if x is None:  # it did not lie beside the run
            return "not measured"
        return f"{x['gentle_success']:.1%}, {x['success']:.1%}, {x['peak_median']:.0f} N"

    columns = {
        "environment": lambda x: x["env"],
        "limit": lambda x: f"{x['cost_limit']:g}",
        "largest multiplier": lambda x: f"{x.get('cost_multiplier_max', 2.0):g}",
        "margin": lambda x: f"{x.get('cost_margin') or 0:g}",
        "begins with": _begun,
        "seeds x steps": lambda x: seeds_and_steps(x) + trained_among(x),
        "gentle success of each seed [%]": lambda x: seeds_in_percent(x["gentle_success_of_seeds"]),
        "success of each seed [%]": lambda x: seeds_in_percent(x["success_of_seeds"]),
        "chosen seed, over other people: gentle, success, median peak": lambda x: (
            f"{x['chosen']}: {figures(x['reported'])}"
        ),
        "the policy before": lambda x: figures(x["shipped"]),
    }
    by = (
        "env", "cost_limit", "cost_multiplier_max", "cost_margin", "started_from", "person_started_from", "statistics", "num_env_steps",
    )  # fmt: skip
    lines = read_results("gentle", by, folder)
    kept = {x["env"] for x in lines if x["statistics"] == "kept"}
    kept |= {x["env"] for x in newest_suite(folder, active=False, limited=True)}
    drifted = [x for x in lines if x["statistics"] == "drift" and x["env"] in kept]
    return _of_runs([x for x in lines if x not in drifted], columns)


def _begun(line: Line) -> str:
    """What a training began with, by the policy that its robot was given."""
    policy, active = line.get("started_from"), parse(line["env"]).active
    if policy is None:
        return "a new policy"
    of_pair = (
        policy == f"assets/policies/{line['env']}.npz"
        or line.get("person_started_from") == "shipped"
    )
    if active and of_pair:
        return "the pair before"
    if policy != "shipped":
        return "one that did not ship"
    return "the robot's policy" if active else "the policy before"


def continued(folder: Path = RESULTS) -> str:
    """What trainings that go on with a policy achieve, beside that policy: those with statistics kept, and the newest with drift of each environment."""
    columns = {
        "environment": lambda x: x["env"],
        "seeds x steps": lambda x: seeds_and_steps(x) + trained_among(x),
        "statistics": lambda x: x["statistics"] or "",
        "success of each seed [%]": lambda x: seeds_in_percent(x["success_of_seeds"]),
        "worst": lambda x: f"{min(x['success_of_seeds']):.1%}",
        "chosen seed, over other people": lambda x: f"{x['chosen']}: {x['chosen_success']:.1%}",
        "the policy before": lambda x: f"{x['shipped']['success']:.1%}",
    }
    newest = read_results("continued", ("env", "statistics"), folder)
    kept = read_results("continued", ("env", "statistics", "num_env_steps"), folder)
    lines = [x for x in newest if x["statistics"] != "kept"]
    return _of_runs([*lines, *(x for x in kept if x["statistics"] == "kept")], columns)


def _of_runs(lines: list[Line], columns: dict[str, Callable[..., str]]) -> str:
    episodes = several(f"{x['episodes']:,}" for x in lines)
    return table(lines, columns, itemgetter("env"), f"{episodes} episodes of each seed, mode;")
