"""Named arrays and a JSON record in one ``.npz``: no pickle, checksummed, written atomically."""

from __future__ import annotations

import contextlib
import hashlib
import io
import json
import os
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from train.errors import DamagedFileError, SaveFolderError

META = "__meta__"
DIGEST = "__sha256__"


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
    handle, temporary = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
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
    folder = os.open(path.parent, os.O_RDONLY)
    try:
        os.fsync(folder)
    finally:
        os.close(folder)


def write_npz(path: Path, arrays: Mapping[str, np.ndarray], meta: Mapping[str, Any]) -> None:
    """Save arrays and a record.

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
    try:
        with np.load(io.BytesIO(path.read_bytes()), allow_pickle=False) as archive:
            content = {name: archive[name] for name in archive.files}
        digest = content.pop(DIGEST)
        if not np.array_equal(digest, _digest(content)):
            raise DamagedFileError(f"{path} is damaged: its checksum does not match its content.")
        return content, json.loads(content.pop(META).tobytes())
    except (FileNotFoundError, PermissionError, DamagedFileError):
        raise
    except Exception as error:  # broken bytes can make zip, NumPy and JSON fail in any way
        raise DamagedFileError(
            f"{path} is damaged, or not a file of this project ({type(error).__name__}: {error})."
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
        handle, probe = tempfile.mkstemp(dir=folder, prefix=".probe.")
        os.close(handle)
        os.unlink(probe)
    except OSError as error:
        raise SaveFolderError(
            f"Cannot write to the folder {str(folder)!r}: {error.strerror or error}. Nothing has "
            f"been computed yet. {advice}"
        ) from error
