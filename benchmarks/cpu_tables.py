"""Tables of what was measured on CPUs, see ``benchmarks.tables``."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from operator import itemgetter
from pathlib import Path

from agym_jax.tasks import TASKS
from benchmarks.markdown import (
    NOTHING,
    RESULTS,
    THEIRS,
    Line,
    grid,
    mark,
    read_results,
    several,
    table,
)
from train.evaluation.statistics import iqm

NATIVE, MJX = "native", "jax"
NAMES = {NATIVE: "C MuJoCo", MJX: "MJX", THEIRS: "Assistive Gym"}
ON_CORES = "Control steps per second on {} cores."
Speeds = dict[tuple[str, str, int], Line]
"""Environment, implementation, environments side by side -> line."""


def _lines(measured: str, keys: Sequence[str], folder: Path) -> list[Line]:
    lines = read_results("cpu", ("measured", "env", *keys), folder)
    return [line for line in lines if line.get("measured", "latency") == measured]


def _medians(measured: str, keys: Sequence[str], folder: Path) -> list[Line]:
    """The newest of each configuration; where it was measured several times at one commit, the (lower) median of these."""
    runs: dict[tuple, list[Line]] = {}
    for line in _lines(measured, (*keys, "commit", "time"), folder):
        runs.setdefault(tuple(line.get(key) for key in ("env", *keys)), []).append(line)
    found = []
    for lines in runs.values():
        last = max(lines, key=itemgetter("time"))
        same = sorted(
            (x for x in lines if x["commit"] == last["commit"]), key=itemgetter("steps_per_s")
        )
        found.append(same[(len(same) - 1) // 2])
    return found


def latency(folder: Path = RESULTS) -> str:
    """How soon the first step comes, and the speed of one environment."""
    lines = {x["env"]: x for x in _lines("latency", ("machine",), folder)}  # the newest
    columns = {
        "environment": lambda x: x["env"],
        "first step, cold": lambda x: f"{x['cold_step_seconds']:.1f} s",
        "first step, warm cache": lambda x: f"{x['warm_step_seconds']:.1f} s",
        "steps/s, 1 environment": lambda x: f"{x['single_steps_per_s']:,}",
    }
    cores = several(x["device"]["cpu_cores"] for x in lines.values())
    note = f"From the start of the process, C MuJoCo; {cores} cores;"
    return table(list(lines.values()), columns, itemgetter("env"), note)


def _speeds(measured: str, folder: Path) -> tuple[Speeds, Speeds, dict[str, Line]]:
    """Of ours on the machine that was measured last and on Assistive Gym's, and of Assistive Gym by environment."""
    lines = _medians(measured, ("impl", "num_envs", "machine"), folder)
    lines.sort(key=itemgetter("time"))
    ours, theirs = ([x for x in lines if (x["impl"] == THEIRS) is gym] for gym in (False, True))

    def beside(last: Sequence[Line]) -> Speeds:
        here = [x for x in ours if last and x["machine"] == last[-1]["machine"]]
        return {(x["env"], x["impl"], x["num_envs"]): x for x in here}

    return beside(ours), beside(theirs), {x["env"]: x for x in theirs}


def _values(used: Sequence[Line]) -> Callable[[Line | None], str]:
    """What a line's cell shows, with a sign if it is of an earlier physics than others of the table."""
    sign = mark(used)
    return lambda line: f"{line['steps_per_s']:,}{sign(line)}" if line else ""


def _ratio(line: Line | None, other: Line | None, form: str = "{:.1f}") -> str:
    return form.format(line["steps_per_s"] / other["steps_per_s"]) if line and other else ""


def _unit(used: Sequence[Line]) -> str:
    """Of the numbers in a table."""
    return ON_CORES.format(several(x["device"]["cpu_cores"] for x in used))


def _where(gyms: dict[str, Line]) -> str:
    """On which machine Assistive Gym was measured; its ratios are of that machine."""
    machines = several(x["machine"] for x in gyms.values())
    return f" {NAMES[THEIRS]}: {machines}, one environment on each core;" if gyms else ""


def speed(folder: Path = RESULTS) -> str:
    """Steps per second of batches on each implementation, and of training."""
    here, there, gyms = _speeds("speed", folder)
    training = {env: x for (env, *_), x in _speeds("training", folder)[0].items()}
    measured = {*gyms, *(env for env, *_ in here)}
    names = [x for x in (f"{task}Jaco-v0" for task in TASKS) if x in measured]
    if not names:
        return NOTHING
    counts = sorted({count for _, impl, count in here if impl == NATIVE})
    first = counts[0]
    head = ["environment", *(f"C MuJoCo, {count}" for count in counts), f"MJX, {first}"]
    head += [NAMES[THEIRS], "C MuJoCo / MJX", f"C MuJoCo / {NAMES[THEIRS]}"]
    head += ["training", "its share of C MuJoCo"] if training else []
    used = [*here.values(), *training.values(), *gyms.values()]
    value = _values(used)
    rows = [head]
    for env in names:
        ours, mjx, gym = here.get((env, NATIVE, first)), here.get((env, MJX, first)), gyms.get(env)
        row = [env, *(value(here.get((env, NATIVE, count))) for count in counts), value(mjx)]
        row += [value(gym), _ratio(ours, mjx), _ratio(there.get((env, NATIVE, first)), gym)]
        if training:
            learning = training.get(env)
            row += [value(learning), _ratio(learning, ours, "{:.0%}")]
        rows.append(row)
    told = f"{_unit(used)} Random actions, resets included; batches of {several(counts)}."
    return grid(rows, used, f"{told}{_where(gyms)}")


def summary(folder: Path = RESULTS) -> str:
    """The same for README: tasks beside each other, the smallest batch."""
    here, _, gyms = _speeds("speed", folder)
    counts = sorted({count for _, _, count in here})
    if not counts:
        return NOTHING
    names = [f"{task}Jaco-v0" for task in TASKS]
    of = {impl: [here.get((env, impl, counts[0])) for env in names] for impl in (NATIVE, MJX)}
    of[THEIRS] = [gyms.get(env) for env in names]
    used = [x for lines in of.values() for x in lines if x]
    value = _values(used)
    rows = [[NAMES[impl], *map(value, lines)] for impl, lines in of.items() if any(lines)]
    return grid([["", *TASKS], *rows], used, f"{_unit(used)} Jaco, {counts[0]} environments;")


def laptop(folder: Path = RESULTS) -> str:
    """What the demo and trainings of at most a quarter of an hour come to, over their seeds."""
    lines = read_results("laptop", ("what", "env", "minutes", "seed"), folder)
    groups: dict[tuple, list[Line]] = {}
    for line in lines:
        groups.setdefault((line["what"], line["env"], line["minutes"]), []).append(line)
    if not groups:
        return NOTHING

    def share(lines: Sequence[Line], name: str) -> str:
        found = [x[name] for x in lines]
        return f"{iqm(found):.0%} ({min(found):.0%} to {max(found):.0%})"

    def until(lines: Sequence[Line]) -> str:
        times = [x["seconds_to_90"] for x in lines]
        reached = sorted(x for x in times if x is not None)
        if not reached:
            return "none"
        span = f"{reached[0] / 60:.1f} to {reached[-1] / 60:.1f} min"
        return f"{len(reached)} of {len(times)}, after {span}"

    columns: dict[str, Callable[[Sequence[Line]], str]] = {
        "run": lambda x: "demo" if x[0]["what"] == "demo" else "training",
        "environment": lambda x: x[0]["env"],
        "seeds": lambda x: str(len(x)),
        "all in": lambda x: f"{max(line['seconds'] for line in x) / 60:.1f} min",
        "steps": lambda x: f"{iqm([line['env_steps'] for line in x]) / 1e6:.1f} M",
        "steps/s": lambda x: f"{iqm([line['steps_per_s'] for line in x]):,.0f}",
        "success, sampled": lambda x: share(x, "success_sampled"),
        "success, mode": lambda x: share(x, "success"),
        "90 % while training": until,
    }
    body = [[cell(x) for cell in columns.values()] for x in groups.values()]
    cores = several(x["device"]["cpu_cores"] for x in lines)
    note = f"Interquartile mean (range) over the seeds, of {several(x['episodes'] for x in lines)} episodes each; {cores} cores;"
    return grid([list(columns), *body], lines, note)
