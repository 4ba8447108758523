"""What gentleness costs as a picture: ``python -m benchmarks.limit_curves [--check]``.

Reads ``benchmarks/results/limits.jsonl``, which ``benchmarks.limits`` has measured, and draws ``docs/images/limits.png``.
"""

from __future__ import annotations

import io
import sys
from collections.abc import Mapping, Sequence
from operator import itemgetter
from pathlib import Path

import numpy as np

from agym_jax.data.npz import write_file
from benchmarks.markdown import RESULTS, Line, mark, read_results
from benchmarks.picture import command
from train.evaluation.statistics import iqm

OUTPUT = RESULTS.parent.parent / "docs" / "images" / "limits.png"
NONE = 1e6
"""Limits from here on are none."""
SUCCESS, GENTLE = "#0072b2", "#d55e00"  # of Okabe and Ito: told apart by all eyes


def lines_of(folder: Path = RESULTS) -> list[Line]:
    """The newest line of each limit of each environment, with a ``mark`` as in tables."""
    lines = read_results("limits", ("env", "cost_limit"), folder)
    sign = mark(lines)
    return sorted((x | {"mark": sign(x)} for x in lines), key=itemgetter("env", "cost_limit"))


def limit_in_words(limit: float) -> str:
    """A limit, or that there is none."""
    return "none" if limit >= NONE else f"{limit:g}"


def draw(path: Path, lines: Sequence[Line], about: Mapping[str, str]) -> None:
    """Success and gentle success against the limit, a panel for each environment.

    Lines: interquartile means of the seeds; points: seeds.

    Args:
        path: PNG file to write.
        lines: from ``lines_of``.
        about: text to keep in the file, key -> value.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    names = list(dict.fromkeys(x["env"] for x in lines))
    figure = Figure(figsize=(0.5 + 3.6 * len(names), 3.2), layout="constrained")
    FigureCanvasAgg(figure)
    for panel, name in zip(figure.subplots(1, len(names), squeeze=False, sharey=True)[0], names, strict=True):  # fmt: skip
        shown = [x for x in lines if x["env"] == name][::-1]  # the strictest to the right
        places = np.arange(len(shown))
        for key, label, colour in (
            ("success_of_seeds", "success", SUCCESS),
            ("gentle_success_of_seeds", "gentle success", GENTLE),
        ):
            seeds = [100 * np.asarray(x[key]) for x in shown]
            panel.plot(places, [iqm(x) for x in seeds], color=colour, label=label)
            for place, values in zip(places, seeds, strict=True):
                panel.plot(np.full(len(values), place), values, ".", color=colour, alpha=0.5)
        panel.set_xticks(places, [limit_in_words(x["cost_limit"]) for x in shown])
        panel.set(ylim=(-3, 103), xlabel="cost limit")
        panel.set_title(f"{name.removesuffix('-v0')}{shown[0]['mark']}", fontsize=10)
        panel.grid(alpha=0.3)
        if name == names[0]:
            panel.set_ylabel("share of episodes [%]")
            figure.legend(fontsize=8, loc="outside lower center", ncols=2)
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=120, metadata=dict(about))
    write_file(path, buffer.getvalue())


def main(
    arguments: Sequence[str] | None = None, folder: Path = RESULTS, output: Path = OUTPUT
) -> int:
    """The command line; returns the exit status, 1 if ``--check`` finds the picture out of date."""
    return command(arguments, output, lines_of(folder), draw, "benchmarks.limit_curves")


if __name__ == "__main__":
    sys.exit(main())
