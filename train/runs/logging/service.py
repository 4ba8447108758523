"""What the loggers that only ever append have in common: which rows they have, and all seeds in one row."""

from __future__ import annotations

import json
import secrets
from collections.abc import Callable
from pathlib import Path
from typing import Any

from agym_jax.data.npz import write_file

from .protocol import Curves, values


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
