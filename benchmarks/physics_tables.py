"""Tables of ``benchmarks.tables`` about the simulation itself: NaN, what robots reach, how a gown is pulled."""

from __future__ import annotations

from collections.abc import Callable
from operator import itemgetter
from pathlib import Path

from benchmarks.markdown import RESULTS, Line, percent, read_results, table

ORDER = itemgetter("env")
STEPS_COMPARED = 1, 10, 50, 199
"""Control steps after which ``benchmarks.implementations`` compares joint angles; after the last one of an episode (200), a new one has begun."""


def nan(folder: Path = RESULTS) -> str:
    """The search for NaN."""
    columns = {
        "environment": lambda x: x["env"],
        "physics": lambda x: x["impl"],
        "actions": _actions,
        "steps": lambda x: f"{x['total_steps']:,}",
        "NaN": lambda x: x["nan"],
        "force on the person, 99.99th percentile": lambda x: f"{x['force/on_human/p99.99']:.1f} N",
        "maximum": lambda x: f"{x['force/on_human/max']:.1f} N",
        "largest peak on a region": _peak,
    }
    lines = read_results("nan", ("env", "impl", "policy", "memory"), folder)
    return table(lines, columns, lambda x: (x["env"], x["impl"], _actions(x)))


def _peak(line: Line) -> str:
    peak = line.get("force/peak_on_human/max")
    return "" if peak is None else f"{peak:.1f} N"


def _actions(line: Line) -> str:
    words = {"random": "random", "shipped": "the shipped policy's"}[line.get("policy", "random")]
    return words + ", with a memory" * bool(line.get("memory"))


def met_starts(folder: Path = RESULTS) -> str:
    """Episodes whose placement, as first drawn, begins inside the person."""

    def found(when: str, name: str) -> Callable[[Line], object]:
        return lambda x: x[f"{when}/{name}"]

    def peak(when: str) -> Callable[[Line], str]:
        return lambda x: f"{x[f'{when}/peak']:,.0f} N"

    columns = {
        "environment": ORDER,
        "physics": lambda x: x["impl"],
        "such episodes": lambda x: f"{x['starts']:,} of {x['draws']:,}",
        "steps of each": lambda x: x["num_steps"],
        "NaN, before": found("before", "nan"),
        "more than 300 N, before": found("before", "rough"),
        "largest force, before": peak("before"),
        "NaN, now": found("now", "nan"),
        "more than 300 N, now": found("now", "rough"),
        "largest force, now": peak("now"),
    }
    lines = read_results("met_starts", ("env", "impl", "num_steps"), folder)
    return table(lines, columns, lambda x: (x["env"], x["impl"]))


def reach(folder: Path = RESULTS) -> str:
    """How many itches a robot can touch at all."""
    columns = {
        "environment": ORDER,
        "reachable itches": percent("reachable"),
        "reachable itches on the quarter of the limb facing the trunk": percent("reachable_inner"),
    }
    return table([x for x in _reach(folder) if "reachable_inner" in x], columns, ORDER)


def reach_mouth(folder: Path = RESULTS) -> str:
    """How many mouths a hand can come near at all."""
    return _mouths("Reaching", folder)


def reach_pour(folder: Path = RESULTS) -> str:
    """At how many mouths a cup can be held where water is poured."""
    return _mouths("Drinking", folder)


def _mouths(task: str, folder: Path) -> str:
    columns = {
        "environment": ORDER,
        "mouths": lambda x: f"{x['targets']:,}",
        "reachable": percent("reachable"),
        "of men": percent("reachable_men"),
        "of women": percent("reachable_women"),
    }
    return table([x for x in _reach(folder) if x["env"].startswith(task)], columns, ORDER)


def inside(folder: Path = RESULTS) -> str:
    """Which parts pass through the person under shipped policies."""

    def worst(line: Line) -> str:
        part, limb, depth = line["parts"][0]
        return f"{part.split('/', 1)[1].removesuffix('_collision')} in {limb.removeprefix('human/')}, {1000 * depth:.0f} mm"

    lines = read_results("inside", ("env",), folder)
    columns = {
        "environment": ORDER,
        "episodes": lambda x: x["episodes"],
        "control steps with a part inside": percent("share"),
        "deepest": worst,
    }
    return table([x for x in lines if x["parts"]], columns, ORDER)


def implementations(folder: Path = RESULTS) -> str:
    """Whether policies that ship do the same on all implementations of the physics."""

    def off(index: int) -> Callable[[Line], str]:
        return lambda x: f"{x['off_median'][index]:.1g} ({x['off_largest'][index]:.1g})"

    of = {"native": "C MuJoCo", "jax": "MJX", "warp": "Warp"}
    lines = [
        line | {"other": other, "first": line["success"]} | found
        for line in read_results("implementations", ("env",), folder)
        for other, found in line["others"].items()
    ]
    columns = {
        "environment": ORDER,
        "implementations": lambda x: f"{of[x['impl']]}, {of[x['other']]}",
        "episodes": lambda x: x["episodes"],
        "successes of either": lambda x: f"{x['first']}, {x['success']}",
        "same outcome": lambda x: x["same_outcome"],
        **{f"after {n / 10:g} s": off(i) for i, n in enumerate(STEPS_COMPARED)},
    }
    note = "Median (largest) over the episodes of the difference of the joint that is farthest off [rad]; mode;"
    return table(lines, columns, itemgetter("env", "other"), note)


def causes(folder: Path = RESULTS) -> str:
    """Whether the largest forces on people have a cause."""

    def touched(cell: Callable[[Line], str], else_: str = "") -> Callable[[Line], str]:
        return lambda line: cell(line) if line["steps"] else else_

    columns = {
        "environment": ORDER,
        "episodes": lambda x: f"{x['episodes']:,}",
        "control steps": lambda x: x["steps"],
        "their peaks on the person": touched(
            lambda x: f"{x['least_peak']:.0f} to {x['peak']:.0f} N ({x['region']})", "none"
        ),
        "largest force on robot and tools": touched(lambda x: f"{x['force']:.0f} N"),
        "force beyond what has a cause": touched(percent("beyond")),
        "torque that the account lacks": touched(
            lambda x: f"{x['lacks']:.2f} N m ({x['lacks_of']:.0%})"
        ),
    }
    return table(read_results("causes", ("env",), folder), columns, ORDER)


def same_starts(folder: Path = RESULTS) -> str:
    """What policies do here from starts of episodes in Assistive Gym."""
    columns = {
        "environment": ORDER,
        "episodes": lambda x: x["episodes"],
        "success there": lambda x: x["there"],
        "masses": lambda x: "as here" if x["masses"] == "body" else "Assistive Gym's",
        "friction": lambda x: "as here" if x["friction"] == 1 else f"{x['friction']:g} times",
        "friction cone": lambda x: "round" if x["round_cone"] else "pyramid",
        "success here": lambda x: x["here"],
        "in both": lambda x: x["both"],
        "tool held": lambda x: x["held"],
        "of these, there": lambda x: x["held_there"],
        "of these, here": lambda x: x["held_here"],
    }  # fmt: skip
    lines = read_results("same_starts", ("env", "masses", "friction", "round_cone"), folder)
    order = itemgetter("env", "friction", "round_cone", "masses")
    return table(lines, columns, order)


def _reach(folder: Path) -> list[Line]:
    return read_results("reach", ("env",), folder)


def pulls(folder: Path = RESULTS) -> str:
    """What scripted pulls of the gown over a person's arm come to."""
    columns = {
        "edge length": lambda x: f"{1000 * x['edge_m']:.1f} mm",
        "vertices": lambda x: f"{x['vertices']:,}",
        "pulls": lambda x: f"{x['pulls']:,}",
        "limb penetrations": lambda x: f"{x['through']}",
        "pulled 0.4 m up the arm": lambda x: f"{x['beyond_0_4_m']:.1%}",
        "covers over 80 % of the arm": lambda x: f"{x['progress_above_0_8']:.1%}",
        "peak force, median (99th percentile)": lambda x: (
            f"{x['force_median_n']:.2f} N ({x['force_99_n']:.2f} N)"
        ),
        "hanging length": lambda x: f"{x['hang_m']:.3f} m",
    }
    lines = read_results("pulls", ("edge_m", "pulls"), folder)
    return table(lines, columns, lambda x: (-x["edge_m"], x["pulls"]))
