"""Build banks of start placements, and report on them: ``agym-jax placements``.

    agym-jax placements build ScratchItchJaco-v0 my_module:WavingJaco-v0
    agym-jax placements meet BedBathingJaco-v0      # in a bank that there is: which rows meet which settled people
    agym-jax placements report

Banks are written into the package's assets, or into the folder that AGYM_JAX_PLACEMENTS names.
"""

from __future__ import annotations

import argparse
import dataclasses
import sys
from collections.abc import Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from agym_jax.data.banks import (
    MEETS,
    MOUTHS,
    SHAPES,
    VARIABLE,
    Placement,
    bank_folders,
    bank_path,
    build_command,
    find_bank,
    load_bank,
)
from agym_jax.data.npz import check_writable, provenance_of, read_arrays, write_arrays
from agym_jax.errors import AgymError, MissingPlacementError, checked_count
from agym_jax.offline.base_search import search
from agym_jax.offline.met_people import meets_of
from agym_jax.registry import parse
from agym_jax.spec import RobotSpec, Task


def save_bank(
    bank: Placement, path: Path, provenance: dict[str, Any], meets: np.ndarray | None = None,
    mouths: np.ndarray | None = None,
) -> None:  # fmt: skip
    """Write a bank, with where it came from.

    Args:
        bank: K rows.
        path: file to write.
        provenance: where it came from.
        meets: which rows meet which settled people, see ``met_people``, bool (P, K).
        mouths: for which each base was chosen, world [m] (K, 3).
    """
    tables = {name: x for name, x in ((MEETS, meets), (MOUTHS, mouths)) if x is not None}
    write_arrays(path, {name: getattr(bank, name) for name in SHAPES} | tables, provenance)


def add_meets(task: Task, robot: RobotSpec) -> tuple[np.ndarray, Path]:
    """Write into a pair's bank which of its rows meet which settled people; the rest stays as it is.

    Returns:
        the table, bool (P, K), and the file.
    """
    bank, source, path = load_bank(task, robot), find_bank(task, robot), bank_path(task, robot)
    if task.human.postures:  # otherwise, meets_of says that there is nothing to write
        _check_folder(path)
    remedy = f"Build it again with: {build_command(task, robot)}"
    arrays = read_arrays(source, "placement bank", SHAPES, MissingPlacementError, remedy)
    meets = meets_of(task, robot, bank)
    write_arrays(path, arrays | {MEETS: meets})
    return meets, path


def report_banks() -> str:
    """What every bank's search found, as a Markdown table."""
    lines = [
        "| bank | tried | start reached | further goals reached | kept |",
        "|---|---|---|---|---|",
    ]
    paths = {p.name: p for folder in reversed(bank_folders()) for p in folder.glob("*.npz")}
    for _, path in sorted(paths.items()):
        try:
            arrays = read_arrays(path, "placement bank", SHAPES, MissingPlacementError, "")
        except MissingPlacementError:
            lines.append(f"| {path.stem} | damaged: build it again | - | - | - |")
            continue
        lines.append(f"| {path.stem} | {' | '.join(_cells(provenance_of(arrays)))} |")
    return "\n".join(lines)


def _cells(found: dict[str, Any]) -> list[str]:
    """A bank's row of the report; dashes if it does not say where it came from."""
    if not {"tried", "start_reached", "goals_reached", "kept"} <= set(found):
        return ["-"] * 4
    share = lambda n, of: f"{100 * n / max(of, 1):.0f} %"  # noqa: E731
    reached = found["start_reached"]
    goals = ", ".join(f"{k} {share(v, reached)}" for k, v in found["goals_reached"].items())
    return [str(found["tried"]), share(reached, found["tried"]), goals or "-", str(found["kept"])]


def _build(name: str, seed: int, size: int) -> None:
    """Build the bank of one id."""
    recipe = parse(name)
    path = bank_path(recipe.task, recipe.robot)
    _check_folder(path)
    bank, report, mouths = search(recipe.task, recipe.robot, seed, size)
    provenance = {
        **dataclasses.asdict(report), "seed": seed, "size": size,
        "versions": {p: version(p) for p in ("mujoco", "jax")}, "command": f"build {name}",
    }  # fmt: skip
    lying = bool(recipe.task.human.postures)
    meets = meets_of(recipe.task, recipe.robot, bank) if lying else None
    save_bank(bank, path, provenance, meets, mouths)
    told = "" if meets is None else f"; {_told(meets)}"
    print(f"{name}: {report.table()}{told} -> {path}", flush=True)


def _meet(name: str) -> None:
    """Add the table of whom they meet to the bank of one id."""
    recipe = parse(name)
    meets, path = add_meets(recipe.task, recipe.robot)
    print(f"{name}: {_told(meets)} -> {path}", flush=True)


def _told(meets: np.ndarray) -> str:
    """What a table says, in words."""
    some, none = int(meets.any(axis=1).sum()), int(meets.all(axis=1).sum())
    return (
        f"{100 * meets.mean():.3f} % of {meets.shape[0]} postures x {meets.shape[1]} placements meet; "
        f"{some} postures meet some placements, {none} all"
    )


def _check_folder(path: Path) -> None:
    """Raise SaveFolderError if a bank cannot be written, before it is made."""
    check_writable(
        path.parent,
        f"Name a folder that can be written in the environment variable {VARIABLE}: "
        f"export {VARIABLE}=$HOME/placements",
    )


def main(argv: Sequence[str] | None = None, prog: str = "agym-jax placements") -> int:
    """The command line; returns the exit status."""
    parser = argparse.ArgumentParser(
        prog=prog, description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    commands = parser.add_subparsers(required=True, dest="command")
    build = commands.add_parser("build", help="build the banks of some pairs")
    build.add_argument(
        "ids",
        nargs="+",
        help="environment ids, such as ScratchItchJaco-v0; with the module of your own: my_module:WavingJaco-v0",
    )
    build.add_argument("--seed", type=int, default=0)
    build.add_argument("--size", type=int, default=512, help="rows to keep")
    meet = commands.add_parser(
        "meet", help="add to banks which of their rows meet which of the people who lie on the bed"
    )
    meet.add_argument("ids", nargs="+", help="environment ids whose banks were built")
    commands.add_parser("report", help="print what the searches found")
    args = parser.parse_args(argv)
    try:
        if args.command == "report":
            print(report_banks())
            return 0
        for name in args.ids:
            parse(name)  # the last of them too, before the first is built
        if args.command == "meet":
            for name in args.ids:
                _meet(name)
            return 0
        checked_count("--size", args.size)
        checked_count("--seed", args.seed, at_least=0)
        for name in args.ids:
            _build(name, args.seed, args.size)
    except AgymError as error:
        print(error, file=sys.stderr)
        return 1
    return 0
