"""Tables of trainings with restarts, beside those without, and of the default, with restarts or without."""

from __future__ import annotations

from pathlib import Path

from agym_jax.registry import parse
from benchmarks import markdown, memory_tables
from benchmarks.markdown import RESULTS, Line
from benchmarks.memory_tables import times
from benchmarks.policy_tables import seeds_and_steps, seeds_in_percent, worst_and_mean
from benchmarks.trained import trained_among
from train.configs import CoopConfig, PPOConfig, config_for


def trainings(folder: Path = RESULTS) -> str:
    """What seeds with restarts achieve, beside others with the same memory or, if they have none, the settings of the id."""
    memory = [x for x in memory_tables.runs(folder) if not x["started_from"] and "code" not in x]
    lines = [x for x in memory if x.get("restart_share")]
    lines += markdown.read_results("restarts", ("env", "time"), folder)
    lines += [x for x in memory_tables.newest_choices(folder) if x["restart_share"]]
    usual = memory_tables.without_memory(folder)

    def without(line: Line) -> list[Line]:
        changes = line.get("changes")
        same = [x for x in memory if (x["env"], x["changes"]) == (line["env"], changes)]
        same = same if changes else usual.get(line["env"], [])
        return [x for x in same if not x.get("restart_share")]

    sign = markdown.mark([*lines, *(y for x in lines for y in without(x))])
    columns = {
        "environment": lambda x: x["env"],
        "memory [s]": lambda x: times(x) if x.get("changes") else "",
        "seeds x steps": lambda x: seeds_and_steps(x) + trained_among(x),
        "success of each seed [%]": lambda x: seeds_in_percent(x["success_of_seeds"]),
        "worst, interquartile mean": worst_and_mean,
        "without restarts: seeds x steps, worst, interquartile mean": lambda x: "; ".join(
            f"{seeds_and_steps(y)}{sign(y)}: {worst_and_mean(y)}" for y in without(x)
        ),
    }
    episodes = markdown.several(f"{x['episodes']:,}" for x in lines)
    note = f"{episodes} episodes of each seed, mode; {markdown.EARLIER} measured before the present physics;"
    return markdown.table(lines, columns, lambda x: (x["env"], x["time"]), note)


def usual_restarts(name: str) -> float:
    """The share of restarts with which an environment is trained on a GPU, where nothing else is said."""
    if parse(name).active:
        return config_for(name, CoopConfig).restart_share
    return config_for(name, PPOConfig).restart_share


def at_a_glance(folder: Path = RESULTS) -> str:
    """The worst seed and the interquartile mean of what is trained by default, by task and robot."""
    found: dict[str, Line] = {}
    lines = [
        *memory_tables.newest_choices(folder),
        *markdown.read_results("restarts", ("env", "time"), folder),
    ]
    for line in sorted(lines, key=lambda x: x["time"]):
        if parse(line["env"]).active or line.get("trained_with"):
            continue
        if (line["restart_share"] or 0.0) == usual_restarts(line["env"]):
            found[line["env"]] = line
    counts = markdown.several(len(x["seeds"]) for x in found.values())
    note = f"Worst and interquartile mean of {counts} seeds;"
    return markdown.matrix(list(found.values()), worst_and_mean, note)
