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
CHANGES: dict[str, tuple[tuple[str, ...], str]] = {
    "2026-11-23T00:15": (("",), "starts, motors, muscles, friction, the bed, heads and what a robot may touch, as in Assistive Gym"),
    "2026-11-23T07:40": (("ArmManipulation", "Dressing"), "what one-armed robots observe in ArmManipulation; the start and the gown of Dressing"),
    "2026-11-23T11:10": (("ArmManipulationJaco",), "Jaco's third link and the front of its nightstand"),
    "2026-11-24T02:15": (
        ("BedBathingJaco", "BedBathingPR2", "BedBathingSawyerHuman", "DressingJaco", "DressingSawyer", "ReachingBaxterHuman",
         "ReachingJaco", "ReachingSawyer", "ScratchItchJaco", "ScratchItchPR2Human"),
        "every link of a robot's arm meets every limb of the task; of these, episodes of the shipped policies changed",
    ),
    "2026-11-24T16:50": (
        ("ArmManipulation", "BedBathingPR2", "BedBathingSawyer", "BedBathingBaxterHuman", "BedBathingJacoHuman"),
        "the robot's wrist and forearm meet the bed; episodes of BedBathingBaxter and BedBathingJaco did not change",
    ),
    "2026-11-24T19:10": (
        tuple(f"{task}Sawyer" for task in TASKS),
        "Sawyer's arm meets its pedestal and the base of its arm; the last link is a sphere 4 mm inside the rims of Assistive Gym's (before, half as thick)",
    ),
    "2026-11-25T00:30": (
        ("BedBathing", "ArmManipulation"),
        "robots, tools and people's free arms resist rolling and spinning on the bed, as in Assistive Gym",
    ),
    "2026-11-25T04:50": (
        ("ArmManipulationSawyer",),
        "where the base stands; at most 3 % of the starts of other pairs changed",
    ),
    "2026-11-26T09:22": (
        ("ArmManipulation",),
        "a limp arm on the edge of the bed withstands pushes of up to 20 N, as in Assistive Gym",
    ),
    "2026-11-26T16:25": (
        ("ArmManipulation",),
        "the rolling friction of scoopers and robots on the bed is 0.6 m instead of 0.15, with which they move more like those of Assistive Gym",
    ),
    "2026-11-26T20:40": (
        tuple(f"{task}PR2" for task in ("ScratchItch", "BedBathing", "Feeding", "Drinking", "Dressing", "ArmManipulation", "Reaching")),
        "PR2's forearm and hand have the outline of Assistive Gym's within 5 mm on average",
    ),
    "2026-11-27T01:00": (
        ("DrinkingPR2",),
        "PR2's base is one that was chosen for a mouth where the person's is, as in Assistive Gym",
    ),
    "2026-11-27T07:25": (
        ("BedBathing",),
        "the wiper and robots meet the pillow beside the person, as in Assistive Gym",
    ),
    "2026-11-28T21:34": (
        ("ScratchItchSawyer",),
        "contacts of the scratcher's handle do not scratch, as in Assistive Gym; the other robots' policies and pairs succeed in as many of 400 episodes each as before",
    ),
}  # fmt: skip
"""Changes of the physics that made earlier figures wrong: when (UTC, as in results) -> what the ids begin with, and what changed. Tables
mark what was measured before. Add a line with a change that makes older figures wrong."""
DATES = "benchmarks.md#changes-of-the-physics"
"""Where ``dates`` is, from other pages of the documentation."""
EARLIER = "†"
THEIRS = "assistive-gym"
"""The implementation that lines of Assistive Gym's own speed name."""
THERE = "in-assistive-gym"
"""The kind of lines of policies in Assistive Gym itself."""
Line = dict[str, Any]


def read_results(
    name: str, keys: Sequence[str], folder: Path = RESULTS, changed: bool = False
) -> list[Line]:
    """Result lines of one kind, the newest of each configuration. Those of other settings than the ids' are left out.

    Args:
        name: file without suffix.
        keys: fields that make a configuration.
        folder: where results lie.
        changed: keep those of other settings.
    """
    path = folder / f"{name}.jsonl"
    other = ("overflow",) if changed else ("overflow", "changes", "other_than_in_training")
    text = path.read_text() if path.is_file() else ""
    newest: dict[tuple, Line] = {}
    for line in (json.loads(row) for row in text.splitlines() if row.strip()):
        if not any(line.get(x) for x in other):
            configuration = tuple(line.get(key) for key in keys)
            newest.pop(configuration, None)
            newest[configuration] = line
    return list(newest.values())


def is_earlier(line: Line) -> bool:
    """Whether a result is of an earlier physics than the present one; Assistive Gym's has not changed."""
    if line.get("impl") == THEIRS or line.get("kind") == THERE:
        return False
    env = str(line.get("env", "Dressing" if line.get("kind") == "pulls" else ""))
    return "time" in line and line["time"] < max(
        time for time, (ids, _) in CHANGES.items() if env.startswith(ids)
    )


def former(now: str | None, then: str | None) -> str:
    """What is said of a result whose policy (trained at ``then``) is not the one that ships (``now``); empty if it is, or unknown."""
    return "" if not (now and then) or now.startswith(then[:7]) else " (a former policy)"


def about(lines: Sequence[Line]) -> str:
    """On what, with which commits and when the lines were measured, and whether the physics was the present one."""
    kinds = list(dict.fromkeys(line["device"]["kind"] for line in lines))
    commits = list(dict.fromkeys(str(line["commit"])[:8] for line in lines))
    days = sorted({line["time"][:10] for line in lines if "time" in line})
    when = f"; {' to '.join(dict.fromkeys([days[0], days[-1]]))}" if days else ""
    earlier = [is_earlier(line) for line in lines]
    before, present = "", f"before the present physics** ([dates]({DATES}))."
    if all(earlier) and earlier:
        before = f" **Measured {present}"
    elif any(earlier):
        before = f" {EARLIER} **measured {present}"
    return f"{', '.join(kinds)}; commit {', '.join(commits)}{when}.{before}"


def dates(folder: Path = RESULTS) -> str:
    """A Markdown table of ``CHANGES``."""
    rows = [
        f"| {time.replace('T', ', ')} | {', '.join(ids) or 'all'} | {what} |"
        for time, (ids, what) in CHANGES.items()
    ]
    return "\n".join(["| since (UTC) | environments | what changed |", "|---|---|---|", *rows])


def mark(lines: Sequence[Line]) -> Callable[[Line], str]:
    """What is put behind a line's name or figure: a sign for those of an earlier physics, if others are not."""
    mixed = len({is_earlier(line) for line in lines}) == 2
    return lambda line: f" {EARLIER}" if mixed and is_earlier(line) else ""


def percent(field: str) -> Callable[[Line], str]:
    """A column that shows a share as whole percent."""
    return lambda line: f"{line[field]:.0%}"


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
    sign = mark(lines)
    rows = [[cell(x) for cell in columns.values()] for x in sorted(lines, key=order)]
    for row, line in zip(rows, sorted(lines, key=order), strict=True):
        row[0] = f"{row[0]}{sign(line)}"
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
    used = [line for line in lines if line["env"] in pairs.values()]
    if not used:
        return NOTHING
    sign = mark(used)
    of = {line["env"]: cell(line) + sign(line) for line in used}
    rows = [["", *ROBOTS], *([t, *(of.get(pairs[t, r], "") for r in ROBOTS)] for t in TASKS)]
    return grid([row for row in rows if any(row[1:])], used, note)


def several(values: Iterable[Any]) -> str:
    """Each value once."""
    return ", ".join(map(str, sorted(set(values))))
