"""Processes of a suite: they end with the program that started them, and save before they do."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Mapping, Sequence
from threading import RLock
from typing import IO

from ..errors import ConfigError
from ..runs.lock import try_lock

_WITH_PARENT = """
import ctypes, os, runpy, signal, sys
if sys.platform == "linux":
    ctypes.CDLL(None).prctl(1, signal.SIGTERM)
    if os.getppid() != int(sys.argv[1]):
        sys.exit(130)
module = sys.argv[2]
del sys.argv[1:3]
runpy.run_module(module, run_name="__main__", alter_sys=True)
"""


def own_program(module: str = "agym_jax") -> tuple[str, ...]:
    """How a command of agym_jax is started; on Linux it gets SIGTERM when this program dies, even by SIGKILL.

    Otherwise a training would go on unseen, and a suite that is started again would train beside it in the
    same folder.

    Args:
        module: that is run.
    """
    return (sys.executable, "-c", _WITH_PARENT, str(os.getpid()), module)


def claim(log: IO[str], patience: float = 60.0) -> bool:
    """Claim an environment by its log, for this process and those that write to the log after it.

    A process that outlives its suite still holds it, so that nobody trains beside it in the same folder.

    Args:
        log: open file.
        patience: seconds to wait for a process that is about to end.

    Returns:
        Whether it is ours; it is until the file is closed by all. On Windows, always.
    """
    deadline = time.monotonic() + patience
    while not try_lock(log):
        if time.monotonic() > deadline:
            return False
        time.sleep(0.1)
    return True


class Children:
    """Runs processes from several threads, and can end all of them.

    Attributes:
        stopping: whether they were told to end; then none is started any more.
    """

    def __init__(self) -> None:
        self.stopping = False
        self._running: set[subprocess.Popen] = set()
        self._lock = RLock()  # a signal may come while it is held

    def run(self, words: Sequence[str], output: IO[str], environment: Mapping[str, str]) -> int:
        """Start a process, wait for it, and return its exit status; 130 if there was no more time to start it.

        Args:
            words: program and arguments.
            output: file of what it prints.
            environment: variables that it gets besides those of this process.
        """
        with self._lock:
            if self.stopping:
                return 130
            process = subprocess.Popen(
                list(words), stdout=output, stderr=subprocess.STDOUT, stdin=subprocess.DEVNULL,
                env={**os.environ, **environment},
            )  # fmt: skip
            self._running.add(process)
        try:
            return process.wait()
        finally:
            with self._lock:
                self._running.discard(process)

    def stop(self) -> None:
        """Ask all that run to save and end (SIGTERM); ``run`` returns when they have."""
        with self._lock:
            self.stopping = True
            for process in self._running:
                process.send_signal(signal.SIGTERM)


def visible_gpus(wanted: int = 0) -> list[str]:
    """Names of the GPUs to use, for ``CUDA_VISIBLE_DEVICES``; none on a machine without.

    Args:
        wanted: how many; 0 = all that are visible.

    Raises:
        ConfigError: there are not so many.
    """
    named = os.environ.get("CUDA_VISIBLE_DEVICES")
    there = _all_gpus() if named is None else [x for x in named.split(",") if x.strip()]
    if wanted > len(there):
        raise ConfigError(
            f"--gpus {wanted} requested, but there are only {len(there)}. Use --gpus {len(there)} or leave it out."
        )
    return there[:wanted] if wanted else there


def _all_gpus() -> list[str]:
    command = ["nvidia-smi", "--query-gpu=index", "--format=csv,noheader"]
    try:
        listed = subprocess.run(command, capture_output=True, text=True, timeout=60)
    except (OSError, subprocess.TimeoutExpired):
        return []
    return listed.stdout.split() if listed.returncode == 0 else []
