"""Tables of ``benchmarks.tables`` about people of every size: whom policies help, how gently, how far and how fast."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from operator import itemgetter
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import spearmanr

from agym_jax.registry import parse
from benchmarks.limit_curves import limit_in_words, lines_of
from benchmarks.markdown import (
    RESULTS,
    Line,
    former,
    grid,
    mark,
    percent,
    read_results,
    several,
    table,
)
from train.evaluation.outcome import in_words, ways_in_words
from train.evaluation.people import LEAST
from train.evaluation.statistics import iqm

ORDER = itemgetter("env")
HELP = {
    "ScratchItch": "scratch an itch on the arm",
    "BedBathing": "wipe an arm in bed",
    "Feeding": "feed with a spoon",
    "Drinking": "give water from a cup",
    "Dressing": "pull a sleeve over an arm",
    "ArmManipulation": "lift a limp arm onto the body",
    "Reaching": "bring its hand to the mouth",
}
"""Tasks in words."""
GENTLE, GROUP, PAIR = 0.9, 0.8, 0.95
"""Goals: of gentle success with a passive person, of success in each group, and of a pair's success."""


def _usual(folder: Path) -> dict[str, Line]:
    """What the policies that ship achieve with Assistive Gym's two bodies, by environment."""
    lines = read_results("evaluation", ("env", "policy"), folder)
    return {x["env"]: x for x in lines if x["policy"] == "mode"}


def among_everybody(folder: Path) -> list[Line]:
    """Results among people of every size; ``former`` is what is said of a policy that does not ship any more."""
    usual = _usual(folder)

    def said(line: Line) -> str:
        now = usual.get(line["env"], {}).get("policy_commit")
        return former(now, line.get("policy_commit"))

    lines = read_results("everybody", ("env",), folder, changed=True)
    return [x | {"former": said(x)} for x in lines]


def _large_groups(line: Line) -> list[Line]:
    return [x for x in line["groups"] if x["episodes"] >= LEAST]


def worst_group(line: Line, of: str) -> str:
    """The group of people with the least of something, and how much it is."""
    found = min(_large_groups(line), key=itemgetter(of))
    return f"{found[of]:.0%} ({found['name']})"


def glance(folder: Path = RESULTS) -> str:
    """How many of 100 people of every size each robot helps, how gently, and whom least often; a row for each task."""
    lines = [x for x in among_everybody(folder) if not parse(x["env"]).active]
    sign = mark(lines)
    rows = [
        {"task": task, "lines": of}
        for task in HELP
        if (of := [x for x in lines if parse(x["env"]).task.name == task])
    ]

    def robots(row: Line) -> str:
        best_first: list[Line] = sorted(row["lines"], key=itemgetter("success"), reverse=True)
        return ", ".join(
            f"{parse(x['env']).robot.name} {100 * x['success']:.0f} ({100 * x['gentle_success']:.0f}){sign(x)}{x['former']}"
            for x in best_first
        )

    def touch(row: Line) -> str:
        peaks = sorted(round(x["peak_median"]) for x in row["lines"])
        return " to ".join(map(str, sorted({peaks[0], peaks[-1]}))) + " N"

    def least(row: Line) -> str:
        of = [(min(_large_groups(x), key=itemgetter("success")), x) for x in row["lines"]]
        group, line = min(of, key=lambda x: x[0]["success"])
        return f"{100 * group['success']:.0f} ({parse(line['env']).robot.name}; {group['name']})"

    columns = {
        "the robot is to": lambda x: f"{HELP[x['task']]} ({x['task']})",
        "helps, of 100 people (gently)": robots,
        "strongest touch, median": touch,
        "helps least, of 100 people": least,
    }
    shown = [list(columns), *([column(row) for column in columns.values()] for row in rows)]
    return grid(shown, [x for row in rows for x in row["lines"]], "Passive people of every size;")


def everybody(folder: Path = RESULTS) -> str:
    """Success and gentle success of shipped policies among people of every size, and of the group that fares worst."""
    known = _usual(folder)

    def usual(line: Line) -> str:
        return f"{known[line['env']]['success']:.1%}" if line["env"] in known else ""

    columns = {
        "environment": ORDER,
        "episodes": lambda x: f"{x['episodes']:,}",
        "Assistive Gym's two bodies": usual,
        "every size": lambda x: f"{x['success']:.1%}{x['former']}",
        "worst group": lambda x: worst_group(x, "success"),
        "gently": lambda x: f"{x['gentle_success']:.1%}",
        "worst group, gently": lambda x: worst_group(x, "gentle_success"),
    }
    return table(among_everybody(folder), columns, ORDER, "Mode;")


def shortfalls(folder: Path = RESULTS) -> str:
    """Environments below their goal: how often the task fails, how often it is done roughly, for whom, and where."""
    every_size = {x["env"]: x for x in among_everybody(folder)}
    robots = [x for name, x in _usual(folder).items() if name in every_size]
    pairs = [
        x
        for x in read_results("crossplay", ("env", "human_policy"), folder)
        if x["human_policy"] == "person"
    ]

    def missed(line: Line) -> bool:
        every = every_size[line["env"]]
        known = every if not every["former"] else line
        least = min(_large_groups(known), key=itemgetter("success"))
        return line["gentle_success"] < GENTLE or least["success"] < GROUP

    def elsewhere(line: Line) -> str:
        every = every_size.get(line["env"])
        return worst_group(every, "success") + every["former"] if every else ""

    def region(line: Line) -> str:
        found = line["region_over_comfort"]
        name = max(found, key=found.__getitem__, default="")
        return f"{name}, {found[name]:.0%}" if name and found[name] >= 0.005 else ""

    columns = {
        "environment": ORDER,
        "gentle success": lambda x: f"{x['gentle_success']:.1%}",
        "fails": lambda x: f"{1 - x['success']:.1%}",
        "done, but not gently": lambda x: f"{x['success'] - x['gentle_success']:.1%}",
        "helped least often": lambda x: worst_group(x, "success"),
        "helped least often, every size": elsewhere,
        "region most often above its comfort limit": region,
    }
    lines = [x for x in robots if missed(x)] + [x for x in pairs if x["success"] < PAIR]
    return table(lines, columns, ORDER, "Mode;")


def care(folder: Path = RESULTS) -> str:
    """How far the tasks got in the units of care, and how long it took."""
    columns = {
        "environment": ORDER,
        "at the end of the episode, mean": lambda x: _how_far(x) + x["former"],
        "time to success, median": lambda x: f"{x['time_to_success']:.1f} s",
    }
    return table(among_everybody(folder), columns, ORDER, "Mode;")


def starts(folder: Path = RESULTS) -> str:
    """Success by the family of poses in which the arm begins."""
    lines = read_results("starts", ("env",), folder)
    worst = {x["env"]: _worst(x) for x in lines}

    def failed(families: list[dict[str, Any]]) -> int:
        return sum(y["episodes"] - y["successes"] for y in families)

    columns = {
        "environment": ORDER,
        "episodes": lambda x: f"{x['episodes']:,}",
        "success": percent("success"),
        "the three families of start poses with the least success": lambda x: ", ".join(
            f"{y['successes'] / y['episodes']:.0%} of {y['episodes']}" for y in worst[x["env"]]
        ),
        "failures that begin there": lambda x: (
            f"{failed(worst[x['env']])} of {failed(x['families'])}"
        ),
    }
    return table(lines, columns, ORDER)


def _worst(line: Line, count: int = 3, share: float = 0.02) -> list[dict[str, Any]]:
    """Families of at least that share of the episodes with the least success."""
    many = [y for y in line["families"] if y["episodes"] >= share * line["episodes"]]
    return sorted(many, key=lambda y: y["successes"] / y["episodes"])[:count]


def endings(folder: Path = RESULTS) -> str:
    """How the episodes end that fail, in the newest evaluation of each environment that tells."""
    own = read_results("endings", ("env",), folder)
    evaluated = read_results("evaluation", ("env", "policy"), folder)
    told = [*own, *(x for x in evaluated if x["policy"] == "mode" and "failures" in x)]
    lines = list({x["env"]: x for x in sorted(told, key=itemgetter("time"))}.values())
    columns = {
        "environment": ORDER,
        "episodes": lambda x: f"{x['episodes']:,}",
        "fail": lambda x: f"{sum(x['failures'].values()):,}",
        "of these, how they end": lambda x: ways_in_words(x["failures"]),
    }
    return table([x for x in lines if x["failures"]], columns, ORDER, "Mode;")


def limits(folder: Path = RESULTS) -> str:
    """Success and gentleness of seeds that learned under several cost limits."""

    def shares(values: Sequence[float]) -> str:
        return f"{iqm(np.asarray(values)):.1%} ({min(values):.1%} to {max(values):.1%})"

    columns = {
        "environment": ORDER,
        "limit": lambda x: limit_in_words(x["cost_limit"]),
        "seeds x steps": lambda x: f"{len(x['seeds'])} x {x['num_env_steps'] / 1e6:g} M",
        "success: IQM (range)": lambda x: shares(x["success_of_seeds"]),
        "gentle success: IQM (range)": lambda x: shares(x["gentle_success_of_seeds"]),
        "median peak force, median of seeds": lambda x: (
            f"{np.median(x['peak_median_of_seeds']):.1f} N"
        ),
    }
    lines = lines_of(folder)
    people = ", ".join(str(x) for x in sorted({x["episodes"] for x in lines}))
    note = f"{people} episodes of each seed, mode;"
    return table(lines, columns, lambda x: (x["env"], -x["cost_limit"]), note)


def rough(folder: Path = RESULTS) -> str:
    """Whether robots hit or press where contact is rough."""

    def newton(name: str) -> Callable[[Line], str]:
        return lambda x: "" if x[name] is None else f"{x[name]:.0f} N"

    scale = itemgetter("action_scale")
    columns = {
        "environment": ORDER,
        "actions": lambda x: f"{scale(x):.0%}",
        "success": percent("success"),
        "gently": percent("gentle"),
        "gently, but for first touches": percent("gentle_but_first_touches"),
        "rough steps per episode": lambda x: f"{x['rough_steps']:.1f}",
        "of which first touches": percent("first_touch"),
        "median peak of these": newton("first_touch_n"),
        "of the others": newton("pressing_n"),
        "mean of the step within the limit": percent("mean_below"),
    }
    lines = read_results("rough", ("env", "action_scale"), folder)
    episodes = ", ".join(str(x) for x in sorted({x["episodes"] for x in lines}))
    by = lambda x: (x["env"], -scale(x))  # noqa: E731
    return table(lines, columns, by, f"{episodes} episodes, mode;")


def dressing_arms(folder: Path = RESULTS) -> str:
    """Whom policies dress whose arm is as AG's cloth finds it, and in AG itself."""

    def sexes(x: Line) -> str:
        rates = {group["name"]: group["success"] for group in x["groups"]}
        return f"{rates['men']:.0%} and {rates['women']:.0%}"

    columns = {
        "environment": ORDER,
        "policy": lambda x: x["trial"],
        "success": lambda x: f"{x['usual']:.0%}",
        "arm as there": lambda x: f"{x['success']:.0%}",
        "of men and women": sexes,
        "in Assistive Gym": lambda x: f"{x['there'][0]} of {x['there'][1]}",
    }
    lines = read_results("dressing_arms", ("env", "trial"), folder, changed=True)
    there = [x["there"][0] / x["there"][1] for x in lines]
    close, usual = (spearmanr([x[name] for x in lines], there)[0] for name in ("success", "usual"))
    note = (
        f"{several(str(x['episodes']) for x in lines)} episodes with such arms; mode; rank correlation with the last column: "
        f"{close:.2f} with such arms, {usual:.2f} of the usual success;"
    )
    return table(lines, columns, lambda x: (-x["there"][0] / x["there"][1], x["env"]), note)


def _how_far(line: Line) -> str:
    task: Any = parse(line["env"]).task
    values = {x: line.get(f"task/{x.name}") for x in task.measures}  # older lines lack some
    return ", ".join(in_words(x, value) for x, value in values.items() if value is not None)
