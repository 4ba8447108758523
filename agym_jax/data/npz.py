"""Named arrays in ``.npz`` files without pickle: the only place that reads and writes them.

Banks and weights among the assets are checked array by array (``read_arrays``). Policies and
checkpoints, which are written while training, carry a record in JSON and a checksum (``write_npz``,
``read_npz``), and are replaced in one step.
"""

from __future__ import annotations

import contextlib
import hashlib
import io
import json
import os
import struct
import sys
import tempfile
import tokenize
import zipfile
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from agym_jax.errors import AgymError, DamagedFileError, SaveFolderError

META = "__meta__"
DIGEST = "__sha256__"
PART = ".part"
"""End of the name of a file that is being written."""
PROVENANCE = "provenance"
Shape = tuple[int | str, ...]
"""Of an array; a word stands for a length of at least 1, the same wherever the word is used."""
BROKEN = (
    ArithmeticError, AttributeError, LookupError, MemoryError, OSError, EOFError, RuntimeError,
    SyntaxError, TypeError, ValueError, struct.error, tokenize.TokenError, zipfile.BadZipFile,
    zlib.error,
)  # fmt: skip
"""What zip, NumPy and JSON raise when they are given broken bytes."""


def _unpack(content: bytes) -> dict[str, np.ndarray]:
    """The arrays in a file's bytes; raises one of ``BROKEN`` if they are no ``.npz``."""
    if not content.startswith(b"PK") or not zipfile.is_zipfile(io.BytesIO(content)):
        raise ValueError("it is not an .npz file")
    with np.load(io.BytesIO(content), allow_pickle=False) as archive:
        arrays = {name: _entry(archive, name) for name in archive.files}
    for name, array in arrays.items():
        if not isinstance(array, np.ndarray):  # NumPy hands out the bytes of what is no array
            raise ValueError(f"{name} is not an array")
    return arrays


def _entry(archive: Any, name: str) -> np.ndarray:
    """One array of an archive; Python's objects in it are never loaded, whatever NumPy advises."""
    try:
        return archive[name]
    except ValueError as error:
        if "pickle" not in str(error):
            raise
        raise ValueError(f"{name} is not an array of numbers") from None


# -- assets ------------------------------------------------------------------------------------


def read_arrays(
    path: Path,
    what: str,
    shapes: Mapping[str, Shape],
    error: type[AgymError],
    remedy: str,
) -> dict[str, Any]:
    """All arrays of an asset, those that are needed checked.

    Args:
        path: of the file.
        what: it is, such as ``"placement bank"``.
        shapes: name -> shape of the arrays of finite numbers that must be there.
        error: what to raise.
        remedy: how to get a file that is right.

    Raises:
        error: the file is missing, or damaged; says which array is wrong and has the remedy.
    """
    if not path.is_file():
        raise error(f"There is no {what} {path}. {remedy}")
    try:
        arrays = _unpack(path.read_bytes())
    except BROKEN as fault:
        raise error(f"The {what} {path} is damaged: {fault}. {remedy}") from fault
    lengths: dict[str, int] = {}
    for name, shape in shapes.items():
        fault = _fault(name, arrays.get(name), shape, lengths)
        if fault:
            raise error(f"The {what} {path} is damaged: {fault}. {remedy}")
    return arrays


def _fault(
    name: str, array: np.ndarray | None, shape: Shape, lengths: dict[str, int]
) -> str | None:
    """What is wrong with an array, in words; ``lengths`` remembers what words stand for."""
    if array is None:
        return f"it has no {name}"
    wanted = tuple(lengths.get(n, n) if isinstance(n, str) else n for n in shape)
    pairs = list(zip(array.shape, wanted, strict=False))
    if array.ndim != len(wanted) or any(
        have != want if isinstance(want, int) else not have for have, want in pairs
    ):
        listed = ", ".join(map(str, wanted)) + ("," if len(wanted) == 1 else "")
        return f"{name} has the shape {array.shape}, not ({listed})"
    lengths |= {want: have for have, want in pairs if isinstance(want, str)}
    if array.dtype.kind not in "biuf" or not np.isfinite(array).all():
        return f"{name} has entries that are no finite numbers"
    return None


def write_arrays(
    path: Path, arrays: Mapping[str, Any], provenance: Mapping[str, Any] | None = None
) -> None:
    """Write an asset, compressed, whole or not at all.

    Args:
        path: file to write; its folder is made if need be.
        arrays: name -> array of numbers.
        provenance: where it came from, for JSON.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    content = {name: np.asarray(array) for name, array in arrays.items()}
    if provenance is not None:
        content[PROVENANCE] = np.array(json.dumps(provenance))
    buffer = io.BytesIO()
    np.savez_compressed(buffer, allow_pickle=False, **content)
    write_file(path, buffer.getvalue())


def provenance_of(arrays: Mapping[str, np.ndarray]) -> dict[str, Any]:
    """Where an asset came from, as ``write_arrays`` was told; empty if it was not, or is unreadable."""
    try:
        return json.loads(str(arrays.get(PROVENANCE, "{}")))
    except json.JSONDecodeError:
        return {}


# -- policies and checkpoints --------------------------------------------------------------------


def _digest(arrays: Mapping[str, np.ndarray]) -> np.ndarray:
    """SHA-256 of names, types, shapes and contents, in the order of the names."""
    sha = hashlib.sha256()
    for name in sorted(arrays):
        array = arrays[name]
        sha.update(f"{name}|{array.dtype.str}|{array.shape}|".encode())
        sha.update(np.ascontiguousarray(array).tobytes())
    return np.frombuffer(sha.digest(), np.uint8)


def write_file(path: Path, content: bytes) -> None:
    """Write a whole file so that a reader sees the old one or the new one, never a part.

    Args:
        path: file to write; its folder exists.
        content: all of it.
    """
    handle, temporary = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.", suffix=PART)
    try:
        with os.fdopen(handle, "wb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        os.chmod(temporary, 0o644)
        os.replace(temporary, path)
    except BaseException:
        with contextlib.suppress(FileNotFoundError):
            os.unlink(temporary)
        raise
    if sys.platform == "win32":  # has no way to write out a folder
        return
    folder = os.open(path.parent, os.O_RDONLY)
    try:
        os.fsync(folder)
    finally:
        os.close(folder)


def append_line(path: Path, line: str) -> None:
    """Add a line to a file, whole or not at all; it begins behind what a killed process left half written.

    Args:
        path: file; its folder exists.
        line: without its end.

    Raises:
        OSError: it cannot be written.
    """
    size = path.stat().st_size if path.is_file() else 0
    try:
        with path.open("a+b") as file:
            if size:
                file.seek(-1, os.SEEK_END)
            begin = b"\n" if size and file.read(1) != b"\n" else b""
            file.write(begin + line.encode() + b"\n")
    except OSError:
        with contextlib.suppress(OSError):
            os.truncate(path, size)
        raise


def remove_parts(folder: Path) -> None:
    """Remove what ``write_file`` leaves in a folder, or below it, when it is killed; nobody else may be writing there."""
    for part in folder.rglob(f".*{PART}"):
        part.unlink(missing_ok=True)


def write_npz(path: Path, arrays: Mapping[str, np.ndarray], meta: Mapping[str, Any]) -> None:
    """Save arrays and a record, with a checksum.

    Args:
        path: file to write; its folder exists.
        arrays: name -> array of numbers.
        meta: anything JSON can hold.
    """
    text = json.dumps(meta, sort_keys=True).encode()
    content: dict[str, Any] = {name: np.asarray(array) for name, array in arrays.items()}
    content[META] = np.frombuffer(text, np.uint8)
    content[DIGEST] = _digest(content)
    buffer = io.BytesIO()
    np.savez(buffer, allow_pickle=False, **content)
    write_file(path, buffer.getvalue())


def read_npz(path: Path) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
    """Arrays and record of a file that ``write_npz`` made.

    Raises:
        DamagedFileError: the file is cut short, altered, or was not made by ``write_npz``.
        FileNotFoundError: there is no such file.
    """
    packed = path.read_bytes()
    try:
        content = _unpack(packed)
        digest, text = content.pop(DIGEST), content[META].tobytes()
        same = np.array_equal(digest, _digest(content))
        meta = json.loads(text) if same else {}
    except BROKEN as error:
        raise DamagedFileError(
            f"{path} is damaged, or not a file of this project ({type(error).__name__}: {error})."
        ) from error
    if not same:
        raise DamagedFileError(f"{path} is damaged: its checksum does not match its content.")
    del content[META]
    return content, meta


def check_appendable(file: Path | str, advice: str = "Choose another file with --json.") -> None:
    """Create the folder of a file and prove that the file can be written to, without changing what is in it.

    Args:
        file: the file; it need not exist.
        advice: what to do instead, for the error.

    Raises:
        SaveFolderError: it cannot; says why.
    """
    file = Path(file)
    check_writable(file.parent, advice)
    there = file.exists()
    try:
        file.open("a").close()
        if not there:
            file.unlink()
    except OSError as error:
        reason = "it is a folder" if file.is_dir() else error.strerror or error
        raise SaveFolderError(
            f"Cannot write to {str(file)!r}: {reason}. Nothing has been computed yet. {advice}"
        ) from error


def check_writable(folder: Path, advice: str = "Choose another with --save-dir.") -> None:
    """Create a folder and prove that files can be written in it.

    Args:
        folder: the folder.
        advice: what to do instead, for the error.

    Raises:
        SaveFolderError: they cannot; says which folder and why.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        handle, probe = tempfile.mkstemp(dir=folder, prefix=".probe.", suffix=PART)
        os.close(handle)
        os.unlink(probe)
    except OSError as error:
        reason = "it is a file" if folder.is_file() else error.strerror or error
        raise SaveFolderError(
            f"Cannot write to the folder {str(folder)!r}: {reason}. Nothing has "
            f"been computed yet. {advice}"
        ) from error
