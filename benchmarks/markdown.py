"""Tables in Markdown from lines of results."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from agym_jax.robots import ROBOTS
from agym_jax.tasks import TASKS

RESULTS = Path(__file__).resolve().parent / "results"
NOTHING = "*No results yet.*"
Line = dict[str, Any]


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


def table(
    lines: Sequence[Line],
    columns: Mapping[str, Callable[[Line], Any]],
    order: Callable[[Line], Any],
    note: str = "",
) -> str:
    """A Markdown table, and below it what holds for all lines.

    Args:
        lines: results.
        columns: headings, and what a line has under each.
        order: what rows are sorted by.
        note: what to say before the device and the commits.
    """
    if not lines:
        return NOTHING
    rows = [[cell(x) for cell in columns.values()] for x in sorted(lines, key=order)]
    return grid([list(columns), *rows], lines, note)


def grid(cells: Sequence[Sequence[Any]], lines: Sequence[Line], note: str = "") -> str:
    """A Markdown table, and below it what holds for all lines.

    Args:
        cells: rows, the headings first.
        lines: results that it shows.
        note: what to say before the device and the commits.
    """
    head, *body = (f"| {' | '.join(map(str, row))} |" for row in cells)
    rule = "|" + "---|" * len(cells[0])
    return "\n".join([head, rule, *body, "", f"{note} {about(lines)}".strip()])


def matrix(lines: Sequence[Line], cell: Callable[[Line], str], note: str = "") -> str:
    """A Markdown table of still people's environments: a row for each task, a column for each robot.

    Args:
        lines: results, one for each environment.
        cell: what stands in the table for a line.
        note: what to say before the device and the commits.
    """
    pairs = {(t, r): f"{t}{r}-v0" for t in TASKS for r in ROBOTS}
    of = {line["env"]: cell(line) for line in lines if line["env"] in pairs.values()}
    if not of:
        return NOTHING
    rows = [["", *ROBOTS], *([t, *(of.get(pairs[t, r], "") for r in ROBOTS)] for t in TASKS)]
    used = [line for line in lines if line["env"] in of]
    return grid([row for row in rows if any(row[1:])], used, note)


def several(values: Iterable[Any]) -> str:
    """Each value once."""
    return ", ".join(map(str, sorted(set(values))))
