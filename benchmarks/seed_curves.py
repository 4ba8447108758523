"""Learning curves of all trainings with several seeds as one picture: ``python -m benchmarks.seed_curves [--check]``.

Reads ``benchmarks/results/seed_training.jsonl`` and draws ``docs/images/seed_curves.png``. The file carries a checksum of
what it shows, so that ``--check`` can tell whether it is out of date without comparing pixels, which differ
between versions of matplotlib.
"""

from __future__ import annotations

import hashlib
import json
import sys
from collections.abc import Sequence
from pathlib import Path

from PIL import Image

from agym_jax.registry import list_envs
from benchmarks.markdown import RESULTS, Line, mark, read_results
from train.runs.plots import plot_runs

OUTPUT = RESULTS.parent.parent / "docs" / "images" / "seed_curves.png"
MARK = "shows"
"""Key of the checksum in the file."""


def trainings(folder: Path = RESULTS) -> list[Line]:
    """The newest training of each environment, in the order of the environments, with a ``mark`` as in tables."""
    order = {name: number for number, name in enumerate(list_envs())}
    lines = read_results("seed_training", ("env",), folder)
    sign = mark(lines)
    return sorted((x | {"mark": sign(x)} for x in lines), key=lambda x: order[x["env"]])


def checksum(runs: Sequence[Line]) -> str:
    """Of what a picture shows."""
    return hashlib.sha256(json.dumps(runs, sort_keys=True).encode()).hexdigest()


def is_current(output: Path, runs: Sequence[Line]) -> bool:
    """Whether the picture shows these trainings."""
    if not output.is_file():
        return not runs
    with Image.open(output) as picture:
        return picture.info.get(MARK) == checksum(runs)


def main(
    arguments: Sequence[str] | None = None, folder: Path = RESULTS, output: Path = OUTPUT
) -> int:
    """The command line; returns the exit status, 1 if ``--check`` finds the picture out of date."""
    arguments = sys.argv[1:] if arguments is None else list(arguments)
    runs = trainings(folder)
    if is_current(output, runs):
        return 0
    if "--check" in arguments:
        print(f"{output.name} is out of date: python -m benchmarks.seed_curves", file=sys.stderr)
        return 1
    plot_runs(output, runs, {MARK: checksum(runs)})
    print(output)
    return 0


if __name__ == "__main__":
    sys.exit(main())
