"""Learning curves as pictures: one run against steps and time, or many runs side by side."""

from __future__ import annotations

import io
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from agym_jax.data.npz import write_file

PANELS = (
    ("return", "return of an episode"),
    ("success", "success rate"),
    ("force", "mean force on the person [N]"),
)
AXES = (("env_steps", "environment steps"), ("seconds", "seconds of training"))


def plot_curve(path: Path, curve: Sequence[Mapping[str, Any]], title: str) -> None:
    """Draw a learning curve.

    Args:
        path: PNG file to write.
        curve: rows with ``env_steps, seconds`` and the names in ``PANELS`` (None = no data). Rows of several
            seeds have bands: the 95 % interval of the interquartile mean, and the range.
        title: shown above.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(10, 9), layout="constrained")
    FigureCanvasAgg(figure)
    panels = figure.subplots(len(PANELS), len(AXES), sharex="col", sharey="row", squeeze=False)
    for line, (name, label) in zip(panels, PANELS, strict=True):
        rows = [row for row in curve if row.get(name) is not None]
        values = [row[name] for row in rows]
        for panel, (axis, axis_label) in zip(line, AXES, strict=True):
            steps = [row[axis] for row in rows]
            panel.plot(steps, values, color="tab:blue", marker=".", markersize=3, linewidth=1.2)
            for low, high in _bands(name, rows):
                panel.fill_between(steps, low, high, color="tab:blue", alpha=0.15, linewidth=0)
            if name == "success":
                panel.set_ylim(-0.03, 1.03)
            panel.grid(alpha=0.3)
            if name == PANELS[-1][0]:
                panel.set_xlabel(axis_label)
        line[0].set_ylabel(label)
    figure.suptitle(title + _LEGEND if curve and "num_seeds" in curve[-1] else title)
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=120)
    write_file(path, buffer.getvalue())


_LEGEND = "\ninterquartile mean over the seeds, its 95 % interval, and the range"


def _bands(name: str, rows: Sequence[Mapping[str, Any]]) -> list[tuple[list[float], list[float]]]:
    """Lower and upper ends of what is drawn around a column: over episodes, or over seeds."""
    if rows and f"{name}_low" in rows[0]:
        ends = ((f"{name}_low", f"{name}_high"), (f"{name}_min", f"{name}_max"))
        return [([row[low] for row in rows], [row[high] for row in rows]) for low, high in ends]
    if name != "return":
        return []
    means, spread = [row[name] for row in rows], [row["return_std"] for row in rows]
    around = list(zip(means, spread, strict=True))
    return [([m - s for m, s in around], [m + s for m, s in around])]


LINE, BAND, RANGE = "#0072b2", "#56b4e9", "#d9d9d9"  # of Okabe and Ito: told apart by all eyes
PER_ROW = 4


def plot_runs(
    path: Path, runs: Sequence[Mapping[str, Any]], about: Mapping[str, str] | None = None
) -> None:
    """Draw the success of many runs while they trained, a panel each.

    All panels have the same axes but for the number of steps. Line: interquartile mean over the seeds; dark
    band: its 95 % interval; light band: from the worst to the best seed; mark: where the line first is 90 %.

    Args:
        path: PNG file to write.
        runs: from ``training_summary``; ``mark`` is put behind the name, where there is one. The panel of a run in
            which no episode ended stays empty.
        about: text to keep in the file, key -> value.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch
    from matplotlib.ticker import MaxNLocator

    columns = min(PER_ROW, len(runs))
    lines = math.ceil(len(runs) / columns)
    figure = Figure(figsize=(0.4 + 3.1 * columns, 0.7 + 2.35 * lines), layout="constrained")
    FigureCanvasAgg(figure)
    panels = figure.subplots(lines, columns, squeeze=False, sharey=True)
    for panel in panels.flat[len(runs) :]:
        panel.set_visible(False)
    for number, (panel, run) in enumerate(zip(panels.flat, runs, strict=False)):
        curve = run["curve"] or {"env_steps": [], "success": []}
        steps = [x / 1e6 for x in curve["env_steps"]]
        for low, high, colour, alpha in (
            ("success_min", "success_max", RANGE, 0.75), ("success_low", "success_high", BAND, 0.6),
        ):  # fmt: skip
            if low in curve:
                ends = ([100 * x for x in curve[name]] for name in (low, high))
                panel.fill_between(steps, *ends, color=colour, alpha=alpha, linewidth=0)
        panel.plot(steps, [100 * x for x in curve["success"]], color=LINE, linewidth=1.6)
        panel.axhline(90, color="0.45", linewidth=0.7, linestyle=(0, (4, 3)))
        if run["steps_to_90"] is not None:
            panel.plot(run["steps_to_90"] / 1e6, 90, "o", color=LINE, markersize=5, zorder=5)
        panel.set(xlim=(0, run["num_env_steps"] / 1e6), ylim=(-2, 102), yticks=range(0, 101, 25))
        name = run["env"].removesuffix("-v0") + run.get("mark", "")
        panel.set_title(f"{name}, {run['num_seeds']} seeds", fontsize=10)
        panel.xaxis.set_major_locator(MaxNLocator(5, steps=[1, 2, 5, 10]))
        panel.tick_params(labelsize=8, labelleft=True)
        panel.grid(alpha=0.25, linewidth=0.6)
        if number + columns >= len(runs):
            panel.set_xlabel("million steps of each seed", fontsize=9)
        if number % columns == 0:
            panel.set_ylabel("success [%]", fontsize=9)
    shown = [
        Line2D([], [], color=LINE, linewidth=1.6, label="interquartile mean over the seeds"),
        Patch(color=BAND, alpha=0.6, linewidth=0, label="its 95 % interval"),
        Patch(color=RANGE, alpha=0.75, linewidth=0, label="worst to best seed"),
        Line2D([], [], color=LINE, marker="o", linestyle="", markersize=5, label="first at 90 %"),
    ]
    figure.legend(handles=shown, loc="outside lower center", ncols=min(4, 2 * columns), fontsize=9)
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=120, metadata=dict(about or {}))
    write_file(path, buffer.getvalue())
