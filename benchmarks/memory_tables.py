"""Tables of ``benchmarks.tables`` about policies with a memory (``agym_jax.memory``)."""

from __future__ import annotations

from operator import itemgetter
from pathlib import Path

from agym_jax.data.assets import asset_root
from agym_jax.data.npz import read_npz
from agym_jax.policy.policy import shipped, shipped_folder
from benchmarks.care_tables import among_everybody, worst_group
from benchmarks.markdown import (
    EARLIER,
    NOTHING,
    RESULTS,
    Line,
    grid,
    mark,
    read_results,
    several,
    table,
)
from train.runs.overview import share


def _runs(folder: Path) -> list[Line]:
    return read_results("memory", ("env", "time"), folder, changed=True)


def _times(line: Line) -> str:
    return ", ".join(f"{x:g}" for x in line["changes"]["memory"])


def _each(line: Line) -> str:
    values = [f"{100 * x:.3g}" for x in line["success_of_seeds"]]
    return ", ".join(values)


def _steps(line: Line, count: int) -> str:
    return f"{count} x {line['num_env_steps'] / 1e6:.3g} M"


def _worst_and_mean(line: Line) -> str:
    return f"{share(min(line['success_of_seeds']))}, {share(line['success_iqm'])}"


def trainings(folder: Path = RESULTS) -> str:
    """What seeds with a memory achieve, beside those without that were trained most similarly."""
    lines = [x for x in _runs(folder) if not x["started_from"]]
    if not lines:
        return NOTHING
    without = _without(folder)
    sign = mark([*lines, *(y for of in without.values() for y in of)])
    columns = {
        "environment": lambda x: x["env"] + (" ‡" if "code" in x else ""),
        "memory [s]": _times,
        "seeds x steps": lambda x: _steps(x, len(x["seeds"])),
        "success of each seed [%]": _each,
        "worst, interquartile mean": _worst_and_mean,
        "chosen seed, over other people": lambda x: (
            f"{x['chosen']}: {share(x['reported']['success'])}, gently {share(x['reported']['gentle_success'])}"
        ),
        "without memory: seeds x steps, worst, interquartile mean": lambda x: "; ".join(
            f"{_steps(y, len(y['seeds']))}{sign(y)}: {_worst_and_mean(y)}"
            for y in without.get(x["env"], ())
        ),
    }
    episodes = several(f"{x['episodes']:,}" for x in lines)
    order = lambda x: (x["env"], -len(x["seeds"]), x["time"])  # noqa: E731
    return table(
        lines,
        columns,
        order,
        f"{episodes} episodes of each seed, mode; ‡ by a prototype with the same averages; {EARLIER} measured before the present physics;",
    )


def _without(folder: Path) -> dict[str, list[Line]]:
    """Environment -> the newest choices without a memory, of the suite and of a training of its own, with the settings of the id."""
    found: dict[str, list[Line]] = {}
    for name in ("suite", "selection"):
        for line in read_results(name, ("env",), folder):
            if not line.get("trained_with"):
                found.setdefault(line["env"], []).append(line)
    return {env: sorted(lines, key=itemgetter("num_env_steps")) for env, lines in found.items()}


def policies(folder: Path = RESULTS) -> str:
    """What policies with a memory achieve that ship, beside those without."""
    names = shipped(memory=True)
    if not names:
        return NOTHING
    results = {
        "here": _runs(folder),
        "every size": read_results("memory_everybody", ("env",), folder, changed=True),
        "there": read_results("memory_in_assistive_gym", ("env",), folder, changed=True),
    }
    plain = {
        "here": {
            x["env"]: x
            for x in read_results("evaluation", ("env", "policy"), folder)
            if x["policy"] == "mode"
        },
        "every size": {x["env"]: x for x in among_everybody(folder)},
        "there": {x["env"]: x for x in read_results("in_assistive_gym", ("env",), folder)},
    }
    rows, used = [], []
    for name in names:
        info = read_npz(asset_root() / shipped_folder(memory=True) / f"{name}.npz")[1]
        here = next(x for x in results["here"] if _is_of(x, name, info))
        every = next((x for x in results["every size"] if x["env"] == name), None)
        there = next((x for x in results["there"] if x["env"] == name), None)
        used += [x for x in (here, every, there) if x]
        rows.append([
            name, _times(here),
            _both(plain["here"][name], here["reported"]),
            _both(plain["every size"][name], every) if every else "",
            _worst(plain["every size"][name], every) if every else "",
            _forces(plain["here"][name], here["reported"]),
            f"{_of(plain['there'][name])} -> {_of(there)}" if there else "",
        ])  # fmt: skip
    heads = (
        "environment", "memory [s]", "success, gently", "every size", "worst group of them",
        "median peak", "in Assistive Gym",
    )  # fmt: skip
    return grid([heads, *rows], used, "Without memory -> with memory; mode;")


def _is_of(line: Line, name: str, info: Line) -> bool:
    same = line["policy_commit"][:7] == str(info.get("commit"))[:7]
    return line["env"] == name and same and line["chosen"] == info.get("seed")


def _both(before: Line, after: Line) -> str:
    told = [f"{share(x['success'])}, {share(x['gentle_success'])}" for x in (before, after)]
    return " -> ".join(told)


def _worst(before: Line, after: Line) -> str:
    return " -> ".join(worst_group(x, "success") for x in (before, after))


def _forces(before: Line, after: Line) -> str:
    return " -> ".join(f"{x['peak_median']:.0f} N" for x in (before, after))


def _of(line: Line) -> str:
    return f"{line['successes']} of {line['episodes']}"
