"""Banks of start placements: where the robot stands and how its arms are bent when an episode begins.

Assistive Gym searches at every reset; here ``search.py`` does so offline, once for each task-robot
pair, and a reset draws a row.

    python -m agym_jax.data.banks build ScratchItchJaco-v0 my_module:WavingJaco-v0
    python -m agym_jax.data.banks report

Banks are part of the package's assets. Where AGYM_JAX_PLACEMENTS names a folder, banks are written
there, and those in it go before the package's.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import os
import sys
import tempfile
import zipfile
import zlib
from functools import lru_cache
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from agym_jax.data.assets import asset_root
from agym_jax.errors import AgymError, MissingPlacementError, SpecError
from agym_jax.spec import RobotSpec, Task
from agym_jax.state import Placement

VARIABLE = "AGYM_JAX_PLACEMENTS"
"""The environment variable with the folder of a user's own banks."""
COLUMNS = {"base_pos": 3, "base_quat": 4, "arm_angles": None}


def bank_folders() -> tuple[Path, ...]:
    """Where banks are looked for, in order; they are written into the first."""
    own = os.environ.get(VARIABLE)
    package = asset_root() / "placements"
    return (Path(own).expanduser(), package) if own else (package,)


def bank_path(task: Task, robot: RobotSpec) -> Path:
    """Where a pair's bank is written."""
    return bank_folders()[0] / f"{task.name}{robot.name}.npz"


def find_bank(task: Task, robot: RobotSpec) -> Path:
    """The pair's bank, the user's own before the package's.

    Raises:
        MissingPlacementError: nobody has built it; the message has the command that does.
    """
    folders = bank_folders()
    for folder in folders:
        path = folder / bank_path(task, robot).name
        if path.is_file():
            return path
    raise MissingPlacementError(
        f"{task.name} with {robot.name} has no placement bank (looked in "
        f"{', '.join(map(str, folders))}). Build it with: {build_command(task, robot)}"
    )


def build_command(task: Task, robot: RobotSpec) -> str:
    """What to type to build a pair's bank; a task from outside of the package is found by its module."""
    module = type(task).__module__
    if module == "__main__":
        module = Path(getattr(sys.modules[module], "__file__", "")).stem
    ours = not module or module.split(".")[0] == "agym_jax"
    command = f"python -m agym_jax.data.banks build {'' if ours else f'{module}:'}{task.name}{robot.name}-v0"
    own = ours and Path(robot.model).is_absolute()
    return (
        f"{command} (with my_module: before the id, if my_module registers {robot.name})"
        if own
        else command
    )


def load_bank(task: Task, robot: RobotSpec) -> Placement:
    """The pair's placements, K rows.

    Raises:
        MissingPlacementError: nobody has built them, or the file is damaged; the message has the command
            that builds them.
        SpecError: they are of an arm with another number of joints.
    """
    path, command = find_bank(task, robot), build_command(task, robot)
    try:
        bank = _read(path, path.stat().st_mtime_ns)
    except MissingPlacementError as error:
        raise MissingPlacementError(f"{error} Build it again with: {command}") from None
    joints = [name for arm in robot.arms_for(task) for name in arm.joints]
    if bank.arm_angles.shape[1] != len(joints):
        raise SpecError(
            f"The placement bank {path} is of {bank.arm_angles.shape[1]} joints, but {robot.name} uses "
            f"{len(joints)} in {task.name} ({', '.join(joints)}). Build it again with: {command}"
        )
    return bank


@lru_cache(maxsize=64)
def _read(path: Path, changed: int) -> Placement:
    """A bank's arrays, read once for each time that the file ``changed``."""
    arrays = _arrays(path)
    for name in COLUMNS:
        if name not in arrays:
            raise MissingPlacementError(f"The placement bank {path} is damaged: it has no {name}.")
    rows = len(arrays["base_pos"]) if arrays["base_pos"].ndim else 0
    for name, width in COLUMNS.items():
        x = arrays[name]
        if x.ndim != 2 or not rows or len(x) != rows or x.shape[1] != (width or x.shape[1]):
            raise MissingPlacementError(
                f"The placement bank {path} is damaged: {name} has the shape {x.shape}, not "
                f"({rows or 'rows'}, {width or 'joints'})."
            )
        if x.dtype.kind != "f" or not np.isfinite(x).all():
            raise MissingPlacementError(
                f"The placement bank {path} is damaged: {name} has entries that are no numbers."
            )
    return Placement(*(arrays[name] for name in COLUMNS))


def _arrays(path: Path) -> dict[str, Any]:
    """Everything in a bank's file."""
    if not zipfile.is_zipfile(path):
        raise MissingPlacementError(f"The placement bank {path} is damaged: it is no .npz file.")
    try:
        with np.load(path, allow_pickle=False) as z:
            return dict(z)
    except (OSError, ValueError, EOFError, zipfile.BadZipFile, zlib.error) as error:
        raise MissingPlacementError(f"The placement bank {path} is damaged: {error}.") from None


def _check_writable(folder: Path) -> None:
    """Refuse before a search of minutes, not after it."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        tempfile.TemporaryFile(dir=folder).close()
    except OSError as error:
        raise AgymError(
            f"Cannot write banks into {folder} ({error.strerror}). Name a folder that can be written in the "
            f"environment variable {VARIABLE}: export {VARIABLE}=$HOME/placements"
        ) from None


def save_bank(bank: Placement, path: Path, provenance: dict) -> None:
    """Write a bank without pickle, with where it came from."""
    path.parent.mkdir(parents=True, exist_ok=True)
    np.savez_compressed(
        path, base_pos=bank.base_pos, base_quat=bank.base_quat, arm_angles=bank.arm_angles,
        provenance=np.array(json.dumps(provenance)),
    )  # fmt: skip


def report_banks() -> str:
    """What every bank's search found, as a Markdown table."""
    lines = [
        "| bank | tried | start reached | further goals reached | kept |",
        "|---|---|---|---|---|",
    ]
    paths = {p.name: p for folder in reversed(bank_folders()) for p in folder.glob("*.npz")}
    for _, path in sorted(paths.items()):
        try:
            found = json.loads(str(_arrays(path).get("provenance", "{}")))
        except (MissingPlacementError, json.JSONDecodeError):
            lines.append(f"| {path.stem} | damaged: build it again | - | - | - |")
            continue
        lines.append(f"| {path.stem} | {' | '.join(_cells(found))} |")
    return "\n".join(lines)


def _cells(found: dict[str, Any]) -> list[str]:
    """A bank's row of the report; dashes if it does not say where it came from."""
    if not {"tried", "start_reached", "goals_reached", "kept"} <= set(found):
        return ["-"] * 4
    share = lambda n, of: f"{100 * n / max(of, 1):.0f} %"  # noqa: E731
    reached = found["start_reached"]
    goals = ", ".join(f"{k} {share(v, reached)}" for k, v in found["goals_reached"].items())
    return [str(found["tried"]), share(reached, found["tried"]), goals or "-", str(found["kept"])]


def main(argv: list[str] | None = None) -> int:
    """Command line: build banks, and report on them."""
    from agym_jax.offline.base_search import search
    from agym_jax.registry import parse

    parser = argparse.ArgumentParser(
        prog="python -m agym_jax.data.banks", description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )  # fmt: skip
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
        for name in args.ids:
            recipe = parse(name)
            path = bank_path(recipe.task, recipe.robot)
            _check_writable(path.parent)
            bank, report = search(recipe.task, recipe.robot, args.seed, args.size)
            provenance = {
                **dataclasses.asdict(report), "seed": args.seed, "size": args.size,
                "versions": {p: version(p) for p in ("mujoco", "jax")}, "command": f"build {name}",
            }  # fmt: skip
            save_bank(bank, path, provenance)
            print(f"{name}: {report.table()} -> {path}", flush=True)
    except AgymError as error:
        print(error, file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
