"""Tables of ``benchmarks.tables`` about policies with a memory (``agym_jax.memory``)."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from operator import itemgetter
from pathlib import Path
from typing import Any

from agym_jax.data.assets import asset_root
from agym_jax.data.npz import read_npz
from agym_jax.policy.policy import shipped, shipped_folder
from benchmarks import markdown
from benchmarks.care_tables import among_everybody, worst_group
from benchmarks.markdown import EARLIER, NOTHING, RESULTS, Line
from benchmarks.policy_tables import COMMIT, seeds_and_steps, seeds_in_percent, worst_and_mean
from benchmarks.suite_tables import newest_suite
from benchmarks.trained import trained_among


def runs(folder: Path = RESULTS) -> list[Line]:
    """Choices among the seeds of trainings with a memory."""
    return markdown.read_results("memory", ("env", "time"), folder, changed=True)


def run_of(name: str, info: Mapping[str, Any], folder: Path = RESULTS) -> Line | None:
    """The run that a policy comes from; None if there is no line of it.

    Args:
        name: its environment.
        info: from its file.
        folder: where results lie.
    """

    def training(commit: str, seed: int) -> tuple[str, int]:
        return commit[:COMMIT], seed

    wanted = training(str(info.get("commit")), info.get("seed", 0))
    of = [x for x in runs(folder) if x["env"] == name]
    return next((x for x in of if training(x["policy_commit"], x["chosen"]) == wanted), None)


def times(line: Line) -> str:
    """Time constants of a memory [s]."""
    return ", ".join(f"{x:g}" for x in line["changes"]["memory"])


def trainings(folder: Path = RESULTS) -> str:
    """What seeds with a memory achieve, beside those without one."""
    lines = [x for x in runs(folder) if not x["started_from"]]
    without = without_memory(folder)
    sign = markdown.mark([*lines, *(y for of in without.values() for y in of)])
    columns = {
        "environment": lambda x: x["env"] + (" ‡" if "code" in x else ""),
        "memory [s]": times,
        "seeds x steps": lambda x: seeds_and_steps(x) + trained_among(x),
        "success of each seed [%]": lambda x: seeds_in_percent(x["success_of_seeds"]),
        "worst, interquartile mean": worst_and_mean,
        "chosen seed, over other people": lambda x: f"{x['chosen']}: {_success(x['reported'])}",
        "without memory: seeds x steps, worst, interquartile mean": lambda x: "; ".join(
            f"{seeds_and_steps(y)}{sign(y)}: {worst_and_mean(y)}" for y in without.get(x["env"], ())
        ),
    }
    episodes = markdown.several(f"{x['episodes']:,}" for x in lines)
    note = (
        f"{episodes} episodes of each seed, mode; ‡ by a prototype with the same averages; {EARLIER} measured before the present "
        f"physics;"
    )
    return markdown.table(lines, columns, lambda x: (x["env"], -len(x["seeds"]), x["time"]), note)


def without_memory(folder: Path) -> dict[str, list[Line]]:
    """Environment -> the newest choices without a memory and with the settings of the id, of the suite and of trainings of its own (with restarts and without)."""
    found: dict[str, list[Line]] = {}
    alone = newest_suite(folder, active=False, limited=False)
    for line in (*alone, *newest_choices(folder)):
        if not line.get("trained_with"):
            found.setdefault(line["env"], []).append(line)
    return {env: sorted(lines, key=itemgetter("num_env_steps")) for env, lines in found.items()}


def newest_choices(folder: Path) -> list[Line]:
    """The newest choice of each environment with restarts, and the newest without, with what its training says of both and of candidates."""
    trainings = {
        (x["env"], x["time"]): x
        for x in markdown.read_results("seed_training", ("env", "time"), folder)
    }
    newest: dict[tuple[str, bool], Line] = {}
    for line in markdown.read_results("selection", ("env", "time"), folder):
        training = trainings.get((line["env"], line.get("training_time")), {})
        told = {name: training.get(name) for name in ("candidates", "restart_share")}
        newest[line["env"], bool(told["restart_share"])] = line | told
    return list(newest.values())


def policies(folder: Path = RESULTS) -> str:
    """What policies with a memory achieve that ship, beside those without one."""
    usual = [
        x
        for x in markdown.read_results("evaluation", ("env", "policy"), folder)
        if x["policy"] == "mode"
    ]
    here, everybody = _by_env(usual), _by_env(among_everybody(folder))
    there = _by_env(markdown.read_results("in_assistive_gym", ("env",), folder))
    everybody_now, there_now = (
        markdown.read_results(f"memory_{name}", ("env", "time"), folder, changed=True)
        for name in ("everybody", "in_assistive_gym")
    )
    rows, used = [], []
    for name in shipped(memory=True):
        file = asset_root() / shipped_folder(memory=True) / f"{name}.npz"
        run = run_of(name, read_npz(file)[1], folder)
        if run is None:
            continue
        of_it = [_of_policy(lines, run) for lines in (everybody_now, there_now)]
        used += [run, *filter(None, of_it)]
        rows.append(
            [
                name,
                times(run),
                _both(_success, here.get(name), run["reported"]),
                _both(_success, everybody.get(name), of_it[0]),
                _both(_least, everybody.get(name), of_it[0]),
                _both(_peak, here.get(name), run["reported"]),
                _both(_count, there.get(name), of_it[1]),
            ]
        )
    heads = (
        "environment", "memory [s]", "success", "every size", "worst group of them",
        "median peak", "in Assistive Gym",
    )  # fmt: skip
    return (
        markdown.grid([heads, *rows], used, "Without memory -> with memory; mode;")
        if rows
        else NOTHING
    )


def _by_env(lines: list[Line]) -> dict[str, Line]:
    return {x["env"]: x for x in lines}


def _of_policy(lines: list[Line], run: Line) -> Line | None:
    """The newest result line of the policy that a run chose; None if there are only others."""
    of = [x for x in lines if x["env"] == run["env"]]
    commits = [x.get("policy_commit", x["commit"])[:COMMIT] for x in of]
    same = [x for x, y in zip(of, commits, strict=True) if y == run["policy_commit"][:COMMIT]]
    return same[-1] if same else None


def _both(told: Callable[[Line], str], before: Line | None, after: Line | None) -> str:
    """A figure without and with a memory; empty where one is missing."""
    return f"{told(before)} -> {told(after)}" if before and after else ""


def _success(line: Line) -> str:
    return f"{line['success']:.1%}, gently {line['gentle_success']:.1%}"


def _least(line: Line) -> str:
    return worst_group(line, "success")


def _peak(line: Line) -> str:
    return f"{line['peak_median']:.0f} N"


def _count(line: Line) -> str:
    return f"{line['successes']} of {line['episodes']}"
