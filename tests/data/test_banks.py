# ruff: noqa: D103
"""Where banks are looked for and written, and what is said of one that is missing, stale or damaged."""

from __future__ import annotations

import dataclasses
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from paths import PROCESS_SECONDS, SUPPORT

from agym_jax.data import banks
from agym_jax.data.assets import asset_root
from agym_jax.data.banks import Placement, bank_path, find_bank, load_bank
from agym_jax.errors import MissingPlacementError, SpecError
from agym_jax.offline import placements
from agym_jax.robots import ROBOTS
from agym_jax.tasks import TASKS

TASK, ROBOT = TASKS["Reaching"], ROBOTS["Jaco"]
BUILD = "agym-jax placements build ReachingJaco-v0"
ROWS = {"base_pos": np.zeros((2, 3)), "base_quat": np.eye(4)[:2], "arm_angles": np.zeros((2, 7))}


@pytest.fixture
def own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder of the user's own banks."""
    monkeypatch.setenv(banks.VARIABLE, str(tmp_path / "own"))
    return tmp_path / "own"


def write(folder: Path, **changes: np.ndarray | None) -> Path:
    """A bank of two rows; None leaves an array out."""
    folder.mkdir(exist_ok=True)
    path = folder / "ReachingJaco.npz"
    np.savez(path, **{k: v for k, v in {**ROWS, **changes}.items() if v is not None})
    return path


# -- where -------------------------------------------------------------------------------------


def test_banks_are_the_packages_unless_the_user_has_their_own(own: Path):
    package = asset_root() / "placements"
    assert banks.bank_folders() == (own, package)
    assert find_bank(TASK, ROBOT) == package / "ReachingJaco.npz"
    many = len(load_bank(TASK, ROBOT).arm_angles)
    path = bank_path(TASK, ROBOT)
    assert path == own / "ReachingJaco.npz"
    placements.save_bank(Placement(*ROWS.values()), path, {})
    assert find_bank(TASK, ROBOT) == path
    assert len(load_bank(TASK, ROBOT).arm_angles) == 2 < many


def test_without_the_variable_banks_are_written_into_the_package(monkeypatch):
    monkeypatch.delenv(banks.VARIABLE, raising=False)
    assert bank_path(TASK, ROBOT) == asset_root() / "placements" / "ReachingJaco.npz"


def test_a_bank_that_was_built_again_is_read_again(own: Path):
    placements.save_bank(Placement(*ROWS.values()), bank_path(TASK, ROBOT), {})
    assert load_bank(TASK, ROBOT) is load_bank(TASK, ROBOT)
    row = Placement(*(x[:1] for x in ROWS.values()))
    placements.save_bank(row, bank_path(TASK, ROBOT), {})
    assert len(load_bank(TASK, ROBOT).arm_angles) == 1


def test_a_folder_that_cannot_be_written_is_told_before_the_search(own: Path, capsys, monkeypatch):
    own.touch()
    monkeypatch.setattr(
        "agym_jax.offline.placements.search", lambda *_: pytest.fail("searched in vain")
    )
    assert placements.main(["build", "ReachingJaco-v0"]) == 1
    said = capsys.readouterr().err
    assert f"Cannot write to the folder {str(own)!r}" in said and "AGYM_JAX_PLACEMENTS" in said


# -- missing, stale, damaged -------------------------------------------------------------------


def test_a_missing_bank_says_where_was_looked(own: Path):
    toybot = dataclasses.replace(ROBOT, name="Toybot")
    with pytest.raises(MissingPlacementError, match=rf"looked in {re.escape(str(own))}, .*\)"):
        load_bank(TASK, toybot)


def test_a_bank_of_another_arm_is_stale(own: Path):
    write(own, arm_angles=np.zeros((2, 6)))
    with pytest.raises(SpecError, match=rf"is of 6 joints, but Jaco uses 7 in Reaching.*{BUILD}"):
        load_bank(TASK, ROBOT)


@pytest.mark.parametrize(
    ("content", "why"),
    [
        (b"", "not an .npz file"),
        (b"not a bank", "not an .npz file"),
        (b"\x93NUMPY", "not an .npz file"),
    ],
)
def test_a_file_that_is_no_bank_is_damaged(own: Path, content: bytes, why: str):
    write(own).write_bytes(content)
    with pytest.raises(MissingPlacementError, match=rf"damaged: it is {why}.*again with: {BUILD}"):
        load_bank(TASK, ROBOT)


def test_a_file_that_was_cut_or_changed_is_damaged(own: Path):
    path = write(own)
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) // 2])
    with pytest.raises(MissingPlacementError, match=rf"damaged.*{BUILD}"):
        load_bank(TASK, ROBOT)
    where = whole.index(np.eye(4)[:2].tobytes())
    path.write_bytes(whole[:where] + b"\xff" * 8 + whole[where + 8 :])
    with pytest.raises(MissingPlacementError, match=rf"damaged.*{BUILD}"):
        load_bank(TASK, ROBOT)


@pytest.mark.parametrize(
    ("changes", "why"),
    [
        ({"base_quat": None}, "it has no base_quat"),
        ({"base_pos": np.zeros((2, 2))}, r"base_pos has the shape \(2, 2\), not \(rows, 3\)"),
        ({"arm_angles": np.zeros((3, 7))}, r"arm_angles has the shape \(3, 7\), not \(2, joints\)"),
        ({"arm_angles": np.zeros(7)}, r"arm_angles has the shape \(7,\)"),
        (
            {"arm_angles": np.full((2, 7), np.nan)},
            "arm_angles has entries that are no finite numbers",
        ),
        (
            {"base_pos": np.array([["a", "b", "c"]] * 2)},
            "base_pos has entries that are no finite numbers",
        ),
        ({k: x[:0] for k, x in ROWS.items()}, r"base_pos has the shape \(0, 3\)"),
    ],
)
def test_arrays_that_are_missing_or_misshapen_are_named(own: Path, changes: dict, why: str):
    write(own, **changes)
    with pytest.raises(MissingPlacementError, match=rf"damaged: {why}.*again with: {BUILD}"):
        load_bank(TASK, ROBOT)


def test_the_report_shows_damaged_banks_and_those_without_a_history(own: Path, capsys):
    write(own)
    (own / "Broken.npz").write_bytes(b"not a bank")
    assert placements.main(["report"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert "| ReachingJaco | - | - | - | - |" in lines
    assert "| Broken | damaged: build it again | - | - | - |" in lines
    assert len([x for x in lines if x.startswith("| ScratchItch")]) == len(ROBOTS)


# -- commands ----------------------------------------------------------------------------------


def test_ids_of_a_module_outside_work_on_every_command_line(own: Path):
    """In a program of its own, which knows nothing of the module before it reads the id."""
    folder = SUPPORT
    command = [
        sys.executable,
        "-W",
        "error::RuntimeWarning",
        "-m",
        "agym_jax",
        "observe",
        "toy_plug_in:WavingJaco-v0",
    ]
    found = subprocess.run(
        command, cwd=folder, capture_output=True, text=True, check=False, timeout=PROCESS_SECONDS,
        env={"PYTHONPATH": str(folder.parent), "PATH": "", "JAX_PLATFORMS": "cpu"},
    )  # fmt: skip
    assert found.returncode == 0, found.stderr
    assert "Robot: 10 columns" in found.stdout and "`hand_pos_goal`" in found.stdout
