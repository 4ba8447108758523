"""Learning curves of all trainings with several seeds as one picture: ``python -m benchmarks.seed_curves [--check]``.

Reads ``benchmarks/results/seed_training.jsonl`` and draws ``docs/images/seed_curves.png``.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

from agym_jax.registry import list_envs
from benchmarks.markdown import RESULTS, Line, mark, read_results
from benchmarks.picture import command
from train.runs.plots import plot_runs

OUTPUT = RESULTS.parent.parent / "docs" / "images" / "seed_curves.png"


def trainings(folder: Path = RESULTS) -> list[Line]:
    """The newest training of each environment, in the order of the environments, with a ``mark`` as in tables."""
    order = {name: number for number, name in enumerate(list_envs())}
    lines = read_results("seed_training", ("env",), folder)
    sign = mark(lines)
    return sorted((x | {"mark": sign(x)} for x in lines), key=lambda x: order[x["env"]])


def main(
    arguments: Sequence[str] | None = None, folder: Path = RESULTS, output: Path = OUTPUT
) -> int:
    """The command line; returns the exit status, 1 if ``--check`` finds the picture out of date."""
    return command(arguments, output, trainings(folder), plot_runs, "benchmarks.seed_curves")


if __name__ == "__main__":
    sys.exit(main())
