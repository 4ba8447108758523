# ruff: noqa: D103
"""Files of arrays: what is refused, with the words for it; checkpoints and policies are in test_checkpoint."""

from __future__ import annotations

import ast
import io
import zipfile
from pathlib import Path

import numpy as np
import pytest
from paths import ROOT

from agym_jax.data.npz import (
    check_appendable,
    provenance_of,
    read_arrays,
    read_npz,
    write_arrays,
    write_npz,
)
from agym_jax.errors import AgymError, DamagedFileError, SaveFolderError
from agym_jax.human.limits import load_arm_limits

SHAPES = {"pos": ("rows", 3), "size": ("rows",), "scale": ()}
GOOD = {"pos": np.ones((2, 3)), "size": np.arange(2), "scale": np.float32(0.5)}


class BankError(AgymError):
    """What the tests' reader raises."""


def read(path: Path) -> dict[str, np.ndarray]:
    return read_arrays(path, "bank", SHAPES, BankError, "Build it.")


def test_what_was_written_comes_back_with_its_history(tmp_path: Path):
    path = tmp_path / "new" / "bank.npz"
    write_arrays(path, GOOD | {"more": np.ones(4)}, {"seed": 3})
    arrays = read(path)
    for name, array in GOOD.items():
        np.testing.assert_array_equal(arrays[name], array)
        assert arrays[name].dtype == np.asarray(array).dtype
    assert arrays["more"].shape == (4,) and provenance_of(arrays) == {"seed": 3}
    write_arrays(path, GOOD)
    assert provenance_of(read(path)) == {}


@pytest.mark.parametrize(
    ("changes", "why"),
    [
        ({"size": None}, "it has no size"),
        ({"pos": np.ones((2, 4))}, r"pos has the shape \(2, 4\), not \(rows, 3\)"),
        ({"pos": np.ones(3)}, r"pos has the shape \(3,\), not \(rows, 3\)"),
        ({"pos": np.ones((0, 3))}, r"pos has the shape \(0, 3\), not \(rows, 3\)"),
        ({"size": np.ones(3)}, r"size has the shape \(3,\), not \(2,\)"),
        ({"scale": np.ones(1)}, r"scale has the shape \(1,\), not \(\)"),
        ({"scale": np.float32(np.inf)}, "scale has entries that are no finite numbers"),
        ({"size": np.array(["a", "b"])}, "size has entries that are no finite numbers"),
        ({"size": np.array([{}, {}])}, "size is not an array of numbers"),
    ],
)
def test_the_array_that_is_wrong_is_named(tmp_path: Path, changes: dict, why: str):
    path = tmp_path / "bank.npz"
    np.savez(path, **{k: v for k, v in {**GOOD, **changes}.items() if v is not None})
    with pytest.raises(BankError, match=rf"The bank .*bank\.npz is damaged: {why}.*\. Build it\."):
        read(path)


def test_a_file_that_is_missing_or_none_of_ours_is_named(tmp_path: Path):
    with pytest.raises(BankError, match=r"There is no bank .*x\.npz\. Build it\."):
        read(tmp_path / "x.npz")
    for content in (b"", b"PK not a zip", b"\x93NUMPY"):
        (tmp_path / "x.npz").write_bytes(content)
        with pytest.raises(BankError, match=r"it is not an \.npz file"):
            read(tmp_path / "x.npz")


@pytest.mark.parametrize("kind", ["compressed", "plain"])
def test_no_damage_escapes_as_another_error(tmp_path: Path, kind: str):
    """Every byte changed in turn: zip, zlib, NumPy and JSON fail in many ways, and we in one."""
    path = tmp_path / "x.npz"
    if kind == "compressed":
        write_arrays(path, GOOD, {"seed": 3})
    else:
        write_npz(path, {name: np.asarray(array) for name, array in GOOD.items()}, {"seed": 3})
    whole = path.read_bytes()
    refused = 0
    for i in range(len(whole)):
        path.write_bytes(whole[:i] + bytes([whole[i] ^ 0xFF]) + whole[i + 1 :])
        for reader, error in ((read, BankError), (read_npz, DamagedFileError)):
            try:
                reader(path)
            except error:
                refused += 1
    assert refused > len(whole)  # most bytes matter to both


def test_damaged_arm_limits_are_refused(tmp_path: Path):
    with pytest.raises(DamagedFileError, match=r"arm limits .* it has no center"):
        np.savez(tmp_path / "a.npz", kernel_0=np.ones((5, 1)))
        load_arm_limits(str(tmp_path / "a.npz"))


def test_a_member_that_is_no_array_is_refused(tmp_path: Path):
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        archive.writestr("pos.npy", b"no array")
    (tmp_path / "x.npz").write_bytes(buffer.getvalue())
    with pytest.raises(BankError, match="damaged: pos is not an array"):
        read(tmp_path / "x.npz")


def test_whether_a_file_can_be_added_to_shows_without_touching_it(tmp_path: Path):
    new, old = tmp_path / "results" / "new.jsonl", tmp_path / "old.jsonl"
    old.write_text("a line")
    for file in (new, old, str(old)):
        check_appendable(file)
    assert not new.exists() and old.read_text() == "a line"
    with pytest.raises(SaveFolderError, match=r"it is a folder.*Choose another file with --json"):
        check_appendable(tmp_path)


def test_one_module_reads_and_writes_arrays():
    """``np.load`` and ``np.savez`` stand in ``agym_jax/data/npz.py`` and nowhere else."""
    places, calls = set(), {"np.load", "np.savez", "np.savez_compressed"}
    for path in [*(ROOT / "agym_jax").rglob("*.py"), *(ROOT / "train").rglob("*.py")]:
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Attribute) and ast.unparse(node) in calls:
                places.add(path.relative_to(ROOT).as_posix())
    assert places == {"agym_jax/data/npz.py"}
