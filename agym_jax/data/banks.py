"""Banks of start placements: where the robot stands and how its arms are bent when an episode begins.

Assistive Gym searches at every reset; here ``agym_jax.offline.placements`` does so once for each
task-robot pair, and a reset draws a row.

Banks are part of the package's assets. Where AGYM_JAX_PLACEMENTS names a folder, banks are written
there, and those in it go before the package's.
"""

from __future__ import annotations

import os
import sys
from dataclasses import dataclass, fields
from functools import lru_cache
from pathlib import Path

import jax
import numpy as np

from agym_jax.data.assets import asset_root
from agym_jax.data.npz import Shape, read_arrays
from agym_jax.errors import MissingPlacementError, SpecError
from agym_jax.spec import RobotSpec, Task

VARIABLE = "AGYM_JAX_PLACEMENTS"
"""The environment variable with the folder of a user's own banks."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Placement:
    """Where the robot starts: one row of a placement bank; or K of them, a bank."""

    base_pos: jax.Array  # world [m]                                         (3,)
    base_quat: jax.Array  # wxyz                                             (4,)
    arm_angles: jax.Array  # of the arms in use [rad]                        (n_arm,)


SHAPES: dict[str, Shape] = {
    "base_pos": ("rows", 3), "base_quat": ("rows", 4), "arm_angles": ("rows", "joints"),
}  # fmt: skip
MEETS, MOUTHS = "meets", "mouths"
"""Names of a bank's optional arrays, see ``load_meets`` and ``load_mouths``."""


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


def build_command(task: Task, robot: RobotSpec, command: str = "build") -> str:
    """What to type to build a pair's bank; a task from outside of the package is found by its module.

    Args:
        task: of the pair.
        robot: of the pair.
        command: of ``agym-jax placements``: ``"build"``, or ``"meet"`` for what ``load_meets`` reads.
    """
    module = type(task).__module__
    if module == "__main__":
        module = Path(getattr(sys.modules[module], "__file__", "")).stem
    ours = not module or module.split(".")[0] == "agym_jax"
    command = (
        f"agym-jax placements {command} {'' if ours else f'{module}:'}{task.name}{robot.name}-v0"
    )
    own = ours and Path(robot.model).is_absolute()
    return (
        f"{command} (with my_module: before the id, if my_module registers {robot.name})"
        if own
        else command
    )


def load_bank(task: Task, robot: RobotSpec) -> Placement:
    """The pair's placements, K rows, as NumPy arrays.

    Raises:
        MissingPlacementError: nobody has built them, or the file is damaged; the message has the command
            that builds them.
        SpecError: they are of an arm with another number of joints.
    """
    path, remedy = find_bank(task, robot), f"Build it again with: {build_command(task, robot)}"
    bank = _read(path, path.stat().st_mtime_ns, remedy)[0]
    joints = [name for arm in robot.arms_for(task) for name in arm.joints]
    if bank.arm_angles.shape[1] != len(joints):
        raise SpecError(
            f"The placement bank {path} is of {bank.arm_angles.shape[1]} joints, but {robot.name} uses "
            f"{len(joints)} in {task.name} ({', '.join(joints)}). {remedy}"
        )
    return bank


def load_meets(task: Task, robot: RobotSpec, postures: int) -> np.ndarray | None:
    """Whether the pair's placements begin inside somebody who lies in a settled posture, see ``offline.met_people``.

    Args:
        task: of the pair.
        robot: of the pair.
        postures: P, rows of the task's bank of settled postures.

    Returns:
        bool (P, K), or None if the bank does not tell.

    Raises:
        MissingPlacementError: see ``load_bank``.
        SpecError: the table is of other postures or placements; the message has the command that makes it anew.
    """
    path, remedy = find_bank(task, robot), f"Build it again with: {build_command(task, robot)}"
    bank, meets, _ = _read(path, path.stat().st_mtime_ns, remedy)
    wanted = postures, len(bank.arm_angles)
    if meets is not None and (meets.shape != wanted or meets.dtype != bool):
        raise SpecError(
            f"The placement bank {path} has a table {MEETS!r} of {meets.dtype} {meets.shape}, but {task.name} has "
            f"{postures} settled postures and the bank {len(bank.arm_angles)} placements: it should be bool {wanted}. "
            f"Make it again with: {build_command(task, robot, 'meet')}"
        )
    return meets


def load_mouths(task: Task, robot: RobotSpec) -> np.ndarray | None:
    """The mouth for which each of the pair's bases was chosen, world [m] (K, 3); None if the bank does not tell.

    Raises:
        MissingPlacementError: see ``load_bank``.
        SpecError: the array does not have a point for each placement; the message has the command that makes it anew.
    """
    path, remedy = find_bank(task, robot), f"Build it again with: {build_command(task, robot)}"
    bank, _, mouths = _read(path, path.stat().st_mtime_ns, remedy)
    wanted = len(bank.arm_angles), 3
    if mouths is None:
        return None
    if mouths.shape != wanted or mouths.dtype.kind != "f" or not np.isfinite(mouths).all():
        raise SpecError(
            f"The placement bank {path} has an array {MOUTHS!r} of {mouths.dtype} {mouths.shape}; it should be finite numbers "
            f"{wanted}. {remedy}"
        )
    return mouths


@lru_cache(maxsize=64)
def _read(
    path: Path, changed: int, remedy: str
) -> tuple[Placement, np.ndarray | None, np.ndarray | None]:
    """A bank's arrays, read once for each time that the file ``changed``."""
    arrays = read_arrays(path, "placement bank", SHAPES, MissingPlacementError, remedy)
    bank = Placement(**{f.name: arrays[f.name] for f in fields(Placement)})
    return bank, arrays.get(MEETS), arrays.get(MOUTHS)
