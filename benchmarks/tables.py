"""The README's tables, made from ``benchmarks/results``: ``python -m benchmarks.tables [--check]``.

A table stands between ``<!-- table:NAME -->`` and ``<!-- /table:NAME -->``. Of several results of the
same configuration the last line of the file counts. Results with lost contacts are left out.
"""

from __future__ import annotations

import json
import re
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent
README = ROOT / "README.md"
RESULTS = ROOT / "benchmarks" / "results"
NOTHING = "*No results yet.*"
Line = dict[str, Any]


class TableError(ValueError):
    """A table that the README names and nobody makes, or a broken marker."""


def read_results(name: str, keys: Sequence[str], folder: Path = RESULTS) -> list[Line]:
    """Result lines of one kind, the newest of each configuration.

    Args:
        name: file without suffix.
        keys: fields that make a configuration.
        folder: where results lie.
    """
    path = folder / f"{name}.jsonl"
    text = path.read_text() if path.is_file() else ""
    newest: dict[tuple, Line] = {}
    for line in (json.loads(row) for row in text.splitlines() if row.strip()):
        if not line.get("overflow"):
            configuration = tuple(line.get(key) for key in keys)
            newest.pop(configuration, None)
            newest[configuration] = line
    return list(newest.values())


def about(lines: Sequence[Line]) -> str:
    """On what, and with which commits, the lines were measured."""
    kinds = list(dict.fromkeys(line["device"]["kind"] for line in lines))
    commits = list(dict.fromkeys(str(line["commit"])[:8] for line in lines))
    return f"{', '.join(kinds)}; commit {', '.join(commits)}."


def rows(head: str, body: Sequence[str]) -> str:
    """A Markdown table."""
    return "\n".join([head, "|" + "---|" * (head.count("|") - 1), *body])


def throughput(folder: Path = RESULTS) -> str:
    """Steps per second of the whole environment."""
    lines = read_results("throughput", ("env", "impl", "num_envs"), folder)
    if not lines:
        return NOTHING
    body = [
        f"| {x['env']} | {x['impl']} | {x['num_envs']:,} | **{x['steps_per_s']:,}** "
        f"({x['steps_per_s_min']:,} to {x['steps_per_s_max']:,}) "
        f"| {x['compile_seconds'] + x['first_call_seconds']:.0f} s | {x['nan']} |"
        for x in sorted(lines, key=lambda x: (x["env"], x["impl"], x["num_envs"]))
    ]
    head = "| environment | physics | worlds | control steps/s, median (range) | start-up | NaN |"
    return rows(head, body) + f"\n\nRandom actions, resets included. {about(lines)}"


def cpu(folder: Path = RESULTS) -> str:
    """Latency and speed on a CPU."""
    lines = read_results("cpu", ("env",), folder)
    if not lines:
        return NOTHING
    body = [
        f"| {x['env']} | {x['cold_step_seconds']:.0f} s | {x['warm_step_seconds']:.0f} s "
        f"| {x['single_steps_per_s']:,} | {x['steps_per_s']:,} |"
        for x in sorted(lines, key=lambda x: x["env"])
    ]
    worlds = ", ".join(str(n) for n in sorted({x["num_envs"] for x in lines}))
    head = "| environment | first step, cold | first step, warm cache | steps/s, 1 world "
    cores = ", ".join(str(n) for n in sorted({x["device"]["cpu_cores"] for x in lines}))
    table = rows(head + f"| steps/s, {worlds} worlds |", body)
    return table + f"\n\nFrom the start of the process; {cores} cores. {about(lines)}"


def nan(folder: Path = RESULTS) -> str:
    """The search for NaN."""
    lines = read_results("nan", ("env", "impl"), folder)
    if not lines:
        return NOTHING
    body = [
        f"| {x['env']} | {x['impl']} | {x['total_steps']:,} | {x['nan']} "
        f"| {x['force/on_person/p99.99']:.1f} N | {x['force/on_person/max']:.1f} N |"
        for x in sorted(lines, key=lambda x: (x["env"], x["impl"]))
    ]
    head = "| environment | physics | random steps | NaN | force on the person, 99.99 % | maximum |"
    return rows(head, body) + f"\n\n{about(lines)}"


def policies(folder: Path = RESULTS) -> str:
    """What shipped policies achieve."""
    lines = read_results("evaluation", ("env", "policy"), folder)
    if not lines:
        return NOTHING
    body = [
        f"| {x['env']} | {Path(x['policy']).stem if '/' in x['policy'] else x['policy']} "
        f"| {x.get('seed', '')} | {x['episodes']} | {x['return_mean']:.1f} ± {x['return_std']:.1f} "
        f"| {x['force_mean']:.2f} N "
        f"| {x['success']:.0%} ({x['success_low']:.0%} to {x['success_high']:.0%}) |"
        for x in sorted(lines, key=lambda x: (x["env"], x.get("seed", 0), -x["success"]))
    ]
    head = "| environment | policy | seed | episodes | return | mean force on the person "
    return rows(head + "| success (95 % interval) |", body) + f"\n\n{about(lines)}"


def training(folder: Path = RESULTS) -> str:
    """What training costs."""
    lines = read_results("training", ("env", "impl"), folder)
    if not lines:
        return NOTHING
    body = [
        f"| {x['env']} | {x['impl']} | {x['num_envs']:,} | {x['steps']:,} | {x['start']} "
        f"| {x['wall_s']:.0f} s{', 4 on one GPU' if 'sharing' in x else ''} | {x['success']:.0%} |"
        for x in sorted(lines, key=lambda x: (x["env"], x["impl"], x["seed"]))
    ]
    head = "| environment | physics | worlds | steps | start | wall time, all in | success at the end |"
    return rows(head, body) + f"\n\n{about(lines)}"


TABLES: dict[str, Callable[..., str]] = {
    "training": training,
    "throughput": throughput,
    "policies": policies,
    "nan": nan,
    "cpu": cpu,
}


def fill(text: str, folder: Path = RESULTS) -> str:
    """The text with every table made anew.

    Raises:
        TableError: a marker names an unknown table, or is not closed.
    """
    for name in re.findall(r"<!-- table:(\S+) -->", text):
        if name not in TABLES:
            raise TableError(f"Unknown table {name!r}; there are: {', '.join(TABLES)}.")
        begin, end = f"<!-- table:{name} -->", f"<!-- /table:{name} -->"
        before, _, rest = text.partition(begin)
        _, closed, after = rest.partition(end)
        if not closed:
            raise TableError(f"{begin} is not followed by {end}.")
        text = f"{before}{begin}\n{TABLES[name](folder)}\n{end}{after}"
    return text


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; returns the exit status, 1 if ``--check`` finds the README out of date."""
    arguments = sys.argv[1:] if arguments is None else list(arguments)
    text = README.read_text()
    wanted = fill(text)
    if "--check" in arguments:
        if text == wanted:
            return 0
        print("README.md is out of date: python -m benchmarks.tables", file=sys.stderr)
        return 1
    README.write_text(wanted)
    return 0


if __name__ == "__main__":
    sys.exit(main())
