"""One run per folder at a time: a lock of the operating system, which ends with the process that holds it.

The lock is on an open file beside the run's folder (``.<environment>.lock``), so that ``--fresh`` can move the folder
aside while it is held. The file itself stays, and means nothing: a process that is killed, or a machine that loses
power, leaves no lock behind.

On NFS the lock is the server's and holds between machines, unless the folder is mounted with ``nolock`` or
``local_lock``; then it holds between the processes of each machine. A file system without locks is told, and the run
goes on without one. Of several machines that train together, only the first one locks and writes.
"""

from __future__ import annotations

import datetime
import errno
import json
import os
import socket
import sys
import warnings
from pathlib import Path
from typing import IO, Any

from agym_jax.errors import SaveFolderError

from ..errors import CheckpointWarning, RunInUseError

NO_LOCKS = (errno.ENOLCK, errno.ENOSYS, errno.EOPNOTSUPP, errno.EINVAL)
"""What a file system without locks answers."""


def try_lock(file: IO[Any]) -> bool:
    """Lock an open file for this process and those that inherit it; it is theirs until all have closed it.

    Args:
        file: open file.

    Returns:
        Whether it is ours; False if another process has it. On Windows always true, without a lock.

    Raises:
        OSError: the file system has no locks.
    """
    if sys.platform == "win32":
        return True
    import fcntl

    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except (BlockingIOError, PermissionError):  # either is allowed to say that somebody has it
        return False
    return True


class RunLock:
    """Holds the folder of a run while the ``with`` block runs.

    Args:
        folder: of the run; it need not exist, the one that it lies in must.

    Raises:
        RunInUseError: on entering; another run has it. Names the folder, and process, host and start of the other.
        SaveFolderError: on entering; the file of the lock cannot be opened.
    """

    def __init__(self, folder: Path) -> None:
        self.folder, self.path = folder, folder.with_name(f".{folder.name}.lock")
        self._file: IO[str] | None = None

    def __enter__(self) -> RunLock:
        try:
            file = self.path.open("a+")
        except OSError as error:
            raise SaveFolderError(
                f"Cannot open {str(self.path)!r}, which keeps other runs out of {self.folder.name}: "
                f"{error.strerror or error}. Choose another folder with --save-dir."
            ) from error
        try:
            if not try_lock(file):
                raise RunInUseError(self._in_use(file))
            self._sign(file)
        except OSError as error:
            if error.errno not in NO_LOCKS:
                file.close()
                raise
            warnings.warn(
                f"The file system of {self.folder} has no locks ({error.strerror}): nothing would keep a second run "
                f"out of this folder.",
                CheckpointWarning,
                stacklevel=2,
            )
        except BaseException:
            file.close()
            raise
        self._file = file
        return self

    def __exit__(self, *_: object) -> None:
        if self._file:
            self._file.close()
            self._file = None

    def _sign(self, file: IO[str]) -> None:
        """Write down who has the lock, for the error of the others; on a full disk, do without."""
        now = datetime.datetime.now(datetime.UTC).isoformat(sep=" ", timespec="seconds")
        text = json.dumps({"pid": os.getpid(), "host": socket.gethostname(), "started": now})
        try:
            file.truncate(0)
            file.write(text)
            file.flush()
        except OSError as error:
            if error.errno not in (errno.ENOSPC, errno.EDQUOT):
                raise

    def _in_use(self, file: IO[str]) -> str:
        """What is said to the second run."""
        file.seek(0)
        try:
            about = json.loads(file.read())
            here = about["host"] == socket.gethostname()
            where = "" if here else f" on {about['host']}"
            who = f"process {about['pid']} on {about['host']}, started {about['started']}"
            stop = f"stop it (kill {about['pid']}{where}; it saves its state first)"
        except (json.JSONDecodeError, KeyError, TypeError):  # it is just being written
            who, stop = "another process", "stop it"
        return (
            f"Another run is training in {str(self.folder)!r}: {who}. Two runs in one folder would overwrite each other. "
            f"Wait for it, {stop}, or choose another folder with --save-dir."
        )
