"""The table of trials: trainings in which one thing is not what the others of the environment have, beside those."""

from __future__ import annotations

from pathlib import Path

from benchmarks import markdown, memory_tables
from benchmarks.markdown import RESULTS
from benchmarks.policy_tables import seeds_and_steps, seeds_in_percent, worst_and_mean
from benchmarks.trained import trained_among


def trials(folder: Path = RESULTS) -> str:
    """What was tried, and what seeds achieve with it and without."""
    lines = markdown.read_results("trials", ("env", "time"), folder)
    usual = memory_tables.without_memory(folder)
    sign = markdown.mark([*lines, *(y for x in lines for y in usual.get(x["env"], ()))])
    columns = {
        "environment": lambda x: x["env"],
        "tried": lambda x: x["trial"],
        "seeds x steps": lambda x: seeds_and_steps(x) + trained_among(x),
        "success of each seed [%]": lambda x: seeds_in_percent(x["success_of_seeds"]),
        "worst, interquartile mean": worst_and_mean,
        "before: seeds x steps, worst, interquartile mean": lambda x: "; ".join(
            f"{seeds_and_steps(y)}{sign(y)}: {worst_and_mean(y)}" for y in usual.get(x["env"], ())
        ),
    }
    episodes = markdown.several(f"{x['episodes']:,}" for x in lines)
    note = f"{episodes} episodes of each seed, mode; {markdown.EARLIER} measured before the present physics;"
    return markdown.table(lines, columns, lambda x: (x["trial"], x["env"], x["time"]), note)
