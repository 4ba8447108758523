"""What the loggers of services have in common: they only ever append, know which rows they have, and take all seeds in one row."""

from __future__ import annotations

import json
import secrets
from abc import ABC, abstractmethod
from collections.abc import Callable
from pathlib import Path
from typing import Any

from agym_jax.data.npz import write_file

from .protocol import Curves, LoggedRun, values


class Place:
    """Which log a run continues, and up to which step it has been logged; in a file of the run's folder.

    Args:
        path: of the file.

    Attributes:
        identity: of the log, the same in all sessions.
        steps: environment steps of the newest row that was logged; -1 if none was.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        known: dict[str, Any] = json.loads(path.read_text()) if path.is_file() else {}
        self.identity: str = known.get("id") or secrets.token_hex(4)
        self.steps: int = known.get("env_steps", -1)

    def log(self, curves: Curves, log: Callable[..., Any]) -> None:
        """Log the rows that were not logged yet; those of a seed are named ``seed_1/...``.

        Args:
            curves: rows by series.
            log: is called with numbers by name and the keyword ``step``.
        """
        merged: dict[int, dict[str, float]] = {}
        for series, rows in curves.items():
            for row in rows:
                if row["env_steps"] > self.steps:
                    named = {f"{series}/{k}" if series else k: v for k, v in values(row).items()}
                    merged.setdefault(int(row["env_steps"]), {}).update(named)
        for steps, numbers in sorted(merged.items()):
            log(numbers, step=steps)
        self.steps = max(merged, default=self.steps)
        line = json.dumps({"id": self.identity, "env_steps": self.steps})
        write_file(self._path, f"{line}\n".encode())


class Service(ABC):
    """See ``Logger``.

    Args:
        run: what is logged.
    """

    file: str
    """In the run's folder: which log it continues."""

    def __init__(self, run: LoggedRun) -> None:
        self.run, self.place = run, Place(run.folder / self.file)
        self._log: Any = None

    @abstractmethod
    def open(self) -> Any:
        """The service's log of this run, new or continued: an object with ``log`` and ``finish``.

        Raises:
            ConfigError: the service refuses.
        """

    def begin(self, curves: Curves) -> None:
        """See ``Logger``."""
        if self._log is None:
            self._log = self.open()
        self.add(curves)

    def add(self, curves: Curves) -> None:
        """See ``Logger``."""
        self.place.log(curves, self._log.log)

    def close(self) -> None:
        """See ``Logger``."""
        if self._log is not None:
            self._log.finish()
            self._log = None
