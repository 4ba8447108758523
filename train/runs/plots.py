"""The learning curve as a picture: return, success and force, against steps and against time."""

from __future__ import annotations

import io
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
