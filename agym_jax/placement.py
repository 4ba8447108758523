"""Banks of start placements: where the robot stands and how its arms are bent when an episode begins.

Assistive Gym searches at every reset; here ``search.py`` does so offline, once for each task-robot
pair, and a reset draws a row.

    python -m agym_jax.placement build ScratchItchJaco-v0 BedBathingPR2-v0
    python -m agym_jax.placement report
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import sys
from functools import cache
from importlib.metadata import version
from pathlib import Path

import numpy as np

from agym_jax.assets import asset_root
from agym_jax.errors import AgymError, MissingPlacementError
from agym_jax.spec import RobotSpec, Task
from agym_jax.state import Placement


def bank_path(task: Task, robot: RobotSpec) -> Path:
    """Where a pair's bank is kept."""
    return asset_root() / "placements" / f"{task.name}{robot.name}.npz"


@cache
def load_bank(task: Task, robot: RobotSpec) -> Placement:
    """The pair's placements, K rows.

    Raises:
        MissingPlacementError: nobody has built them; the message has the command that does.
    """
    path = bank_path(task, robot)
    if not path.is_file():
        raise MissingPlacementError(
            f"{task.name} with {robot.name} has no placement bank. Build it with: "
            f"python -m agym_jax.placement build {task.name}{robot.name}-v0"
        )
    with np.load(path, allow_pickle=False) as z:
        return Placement(z["base_pos"], z["base_quat"], z["arm_angles"])


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
    for path in sorted((asset_root() / "placements").glob("*.npz")):
        with np.load(path, allow_pickle=False) as z:
            p = json.loads(str(z["provenance"]))
        share = lambda n, of: f"{100 * n / max(of, 1):.0f} %"  # noqa: E731
        goals = ", ".join(
            f"{k} {share(v, p['start_reached'])}" for k, v in p["goals_reached"].items()
        )
        lines.append(
            f"| {path.stem} | {p['tried']} | {share(p['start_reached'], p['tried'])} "
            f"| {goals or '-'} | {p['kept']} |"
        )
    return "\n".join(lines)


def main(argv: list[str] | None = None) -> int:
    """Command line: build banks, and report on them."""
    from agym_jax.registry import parse
    from agym_jax.search import search

    parser = argparse.ArgumentParser(prog="python -m agym_jax.placement", description=__doc__)
    commands = parser.add_subparsers(required=True, dest="command")
    build = commands.add_parser("build", help="build the banks of some pairs")
    build.add_argument("ids", nargs="+", help="environment ids, such as ScratchItchJaco-v0")
    build.add_argument("--seed", type=int, default=0)
    build.add_argument("--size", type=int, default=512, help="rows to keep")
    commands.add_parser("report", help="print what the searches found")
    args = parser.parse_args(argv)
    if args.command == "report":
        print(report_banks())
        return 0
    try:
        for name in args.ids:
            recipe = parse(name)
            bank, report = search(recipe.task, recipe.robot, args.seed, args.size)
            provenance = {
                **dataclasses.asdict(report), "seed": args.seed, "size": args.size,
                "versions": {p: version(p) for p in ("mujoco", "jax")}, "command": f"build {name}",
            }  # fmt: skip
            path = bank_path(recipe.task, recipe.robot)
            save_bank(bank, path, provenance)
            print(f"{name}: {report.table()} -> {path.name}", flush=True)
    except AgymError as error:
        print(error, file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
