"""What finished runs with several seeds come to, read from their folders: one summary a run, a table and a picture.

A run's folder holds ``config.json``, ``curve.jsonl`` and, once its seeds were measured, ``selection.jsonl``.
"""

from __future__ import annotations

import contextlib
import json
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from .curve import Row
from .progress import duration

ENOUGH = 0.9
"""Success whose first time is told."""
COLUMNS = (
    "env_steps", "seconds", "success", "success_low", "success_high", "success_min", "success_max",
    "return", "return_low", "return_high", "gentle", "cost", "multiplier",
)  # fmt: skip
"""Of the curve, that a summary keeps."""
DIGITS = 4
JOURNAL = "journal.jsonl"
"""Beside the runs of a suite: when which command began and how long it took."""
SELECTION = "selection.jsonl"
"""In the folder of a run: what ``select`` measured, a line each time."""
CANDIDATES = "candidates"
"""In the folder of a run: curves, policies and checkpoints of the candidates of its seeds."""


def read_rows(path: Path) -> list[Row]:
    """The rows of a file of JSON lines; none if it is not there, and without those that are half written."""
    if not path.is_file():
        return []
    rows = []
    for line in path.read_text().splitlines():
        with contextlib.suppress(json.JSONDecodeError):
            rows.append(json.loads(line))
    return rows


def reduced_curve(rows: Iterable[Row]) -> dict[str, list[float]]:
    """The columns of a curve that a picture needs, of the rows in which episodes ended.

    Args:
        rows: of ``curve.jsonl``, of one seed or combined.

    Returns:
        Column -> values, rounded to ``DIGITS`` digits (steps are exact).
    """
    kept = [row for row in rows if row.get("success") is not None]
    names = [name for name in COLUMNS if kept and name in kept[0]]
    return {
        name: [row[name] if name == "env_steps" else _rounded(row[name]) for row in kept]
        for name in names
    }


def _rounded(value: float) -> float:
    return float(f"{value:.{DIGITS}g}")


def first_time(
    curve: Mapping[str, Sequence[float]], share: float = ENOUGH
) -> tuple[int, float] | None:
    """Steps (of each seed) and seconds of training after which the success first is ``share``, if it ever is."""
    success = curve.get("success", ())
    place = next((i for i, x in enumerate(success) if x >= share), None)
    return None if place is None else (int(curve["env_steps"][place]), curve["seconds"][place])


def wall_seconds(folder: Path, env_name: str) -> float | None:
    """Seconds from start to end of an environment's training processes, as a suite's journal has them."""
    found = [
        row["seconds"]
        for row in read_rows(folder / JOURNAL)
        if row["env"] == env_name and row["command"] in ("train", "coop") and "seconds" in row
    ]
    return sum(found) if found else None


def training_summary(run: Path) -> dict[str, Any] | None:
    """What training the seeds of a run was and cost; None if the folder holds no run that has begun.

    Args:
        run: folder of the run, ``<save-dir>/<environment>``.

    Returns:
        ``env, num_seeds, seeds_at_end`` (without those that diverged), ``num_env_steps`` (of each seed),
        ``num_envs, impl``, seconds of training (``train_seconds``, building excluded) and of the whole
        processes (``wall_seconds``, where a suite has kept them), when the interquartile mean of success first
        was ``ENOUGH`` (``steps_to_90, seconds_to_90``), the ``curve``, ``cost_limit``, ``cost_multiplier_max`` and ``cost_margin``,
        ``started_from`` and ``person_started_from`` (policies of robot and person, None if they were new), ``candidates``
        (see ``CheckpointManager``; None without), ``restart_share``, and commit, device, versions, time.
    """
    rows, path = read_rows(run / "curve.jsonl"), run / "config.json"
    if not rows:
        return None
    about = json.loads(path.read_text()) if path.is_file() else {}
    config, curve, last = about.get("config", {}), reduced_curve(rows), rows[-1]
    steps, seconds = first_time(curve) or (None, None)
    return {
        "kind": "seed-training",
        "env": run.name,
        "num_seeds": config.get("num_seeds", last.get("num_seeds", 1)),
        "seeds_at_end": last.get("num_seeds", 1),
        "num_env_steps": last["env_steps"],
        "num_envs": config.get("num_envs"),
        "impl": about.get("impl"),
        "train_seconds": round(last["seconds"], 1),
        "wall_seconds": wall_seconds(run.parent, run.name),
        "nan": last.get("nan_total", 0),
        "steps_to_90": steps,
        "seconds_to_90": seconds,
        "curve": curve,
        "cost_limit": config.get("cost_limit"),
        "cost_multiplier_max": config.get("cost_multiplier_max"),
        "cost_margin": config.get("cost_margin", 0.0),
        "started_from": config.get("robot_policy"),
        "person_started_from": config.get("human_policy"),
        "candidates": about.get("candidates"),
        "restart_share": config.get("restart_share", 0.0),
        **{name: about.get(name) for name in ("commit", "device", "versions", "time")},
    }


def seeds_and_steps(
    seeds: int,
    steps: int,
    candidates: Mapping[str, Any] | None = None,
    restart_share: float | None = 0.0,
) -> str:
    """``8 x 4 M``, or ``8 x 4 M, restarts 0.5, of 4 candidates after 40% by success``."""
    text = f"{seeds} x {steps / 1e6:.3g} M"
    text += f", restarts {restart_share:g}" if restart_share else ""
    if not candidates:
        return text
    after = f"after {candidates['until']:.0%} by {candidates['rule']}"
    return f"{text}, of {candidates['count']} candidates {after}"


def selection_of(run: Path) -> dict[str, Any] | None:
    """The newest result of ``select`` in the folder of a run, if there is one."""
    rows = read_rows(run / SELECTION)
    return rows[-1] if rows else None


HEADINGS = (
    "environment", "seeds x steps", "success of each seed [%]", "worst", "interquartile mean (95 % interval)",
    "best", "chosen seed, over other people", "90 % after", "wall time (training alone)",
)  # fmt: skip


def cells(selection: Mapping[str, Any], training: Mapping[str, Any] | None) -> list[str]:
    """A row of the table of runs, under ``HEADINGS``; the success of the chosen seed is bold.

    Args:
        selection: line of ``select``.
        training: from ``training_summary``; None leaves its columns empty.
    """
    each = selection["success_of_seeds"]
    shown = [f"{100 * x:.3g}" for x in each]
    chosen = selection["seeds"].index(selection["chosen"])
    shown[chosen] = f"**{shown[chosen]}**"
    lost = training["num_seeds"] - training["seeds_at_end"] if training else 0
    low, high = selection["success_iqm_low"], selection["success_iqm_high"]
    size, reached, took, gentle = str(len(each)), "", "", ""
    if "chosen_gentle_success" in selection:
        gentle = f", gently {selection['chosen_gentle_success']:.1%}"
    if training:
        more = (training.get(name) for name in ("candidates", "restart_share"))
        size = seeds_and_steps(len(each), training["num_env_steps"], *more)
        reached = "not reached"
        if training["steps_to_90"] is not None:
            seconds = duration(training["seconds_to_90"])
            reached = f"{training['steps_to_90'] / 1e6:.2g} M, {seconds}"
        took = duration(training["train_seconds"])
        if training["wall_seconds"] is not None:
            took = f"{duration(training['wall_seconds'])} ({took})"
    return [
        selection["env"],
        size,
        ", ".join(shown) + (f" ({lost} diverged)" if lost else ""),
        f"{min(each):.1%}",
        f"{selection['success_iqm']:.1%} ({low:.1%} to {high:.1%})",
        f"{max(each):.1%}",
        f"{selection['chosen']}: {selection['chosen_success']:.1%}{gentle}",
        reached,
        took,
    ]


def markdown(runs: Sequence[tuple[Mapping[str, Any], Mapping[str, Any] | None]]) -> str:
    """The table of runs: selections, and what their training was."""
    rows = [HEADINGS, *(cells(*run) for run in runs)]
    lines = [f"| {' | '.join(row)} |" for row in rows]
    lines.insert(1, "|" + "---|" * len(HEADINGS))
    return "\n".join(lines) + "\n"
