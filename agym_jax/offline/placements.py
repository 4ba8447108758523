"""Build banks of start placements, and report on them: ``agym-jax placements``.

    agym-jax placements build ScratchItchJaco-v0 my_module:WavingJaco-v0
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

from agym_jax.data.banks import SHAPES, VARIABLE, Placement, bank_folders, bank_path
from agym_jax.data.npz import check_writable, provenance_of, read_arrays, write_arrays
from agym_jax.errors import AgymError, MissingPlacementError, checked_count
from agym_jax.offline.base_search import search
from agym_jax.registry import parse


def save_bank(bank: Placement, path: Path, provenance: dict[str, Any]) -> None:
    """Write a bank, with where it came from."""
    write_arrays(path, {name: getattr(bank, name) for name in SHAPES}, provenance)


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
    check_writable(
        path.parent,
        f"Name a folder that can be written in the environment variable {VARIABLE}: "
        f"export {VARIABLE}=$HOME/placements",
    )
    bank, report = search(recipe.task, recipe.robot, seed, size)
    provenance = {
        **dataclasses.asdict(report), "seed": seed, "size": size,
        "versions": {p: version(p) for p in ("mujoco", "jax")}, "command": f"build {name}",
    }  # fmt: skip
    save_bank(bank, path, provenance)
    print(f"{name}: {report.table()} -> {path}", flush=True)


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
    commands.add_parser("report", help="print what the searches found")
    args = parser.parse_args(argv)
    try:
        if args.command == "report":
            print(report_banks())
            return 0
        checked_count("--size", args.size)
        for name in args.ids:
            parse(name)  # the last of them too, before the first is built
        for name in args.ids:
            _build(name, args.seed, args.size)
    except AgymError as error:
        print(error, file=sys.stderr)
        return 1
    return 0
