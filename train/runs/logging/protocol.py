"""What a logger is, and what it is told."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from ..curve import Row

Curves = Mapping[str, Sequence[Row]]
"""Name -> rows. The name of the run itself, or of the statistics over its seeds, is empty."""
Number = bool | int | float | str


@dataclass(frozen=True)
class LoggedRun:
    """A run.

    Attributes:
        name: for people: its environment.
        folder: where its files are.
        settings: hyper-parameters, and what else it was made with.
    """

    name: str
    folder: Path
    settings: Mapping[str, Number]


class Logger(Protocol):
    """One place that curves go to."""

    def begin(self, curves: Curves) -> None:
        """Open the log, or open it anew, so that it has these rows once and no others.

        Raises:
            ConfigError: a service refuses.
            OSError: it cannot be written.
        """

    def add(self, curves: Curves) -> None:
        """Log further rows.

        Raises:
            OSError: they cannot be written.
        """

    def close(self) -> None:
        """Write what is left; the run may go on in another process."""


def values(row: Row) -> dict[str, float]:
    """The numbers of a row by their names in a log; those without a group are in ``train``."""
    return {
        name if "/" in name else f"train/{name}": float(value)
        for name, value in row.items()
        if name != "env_steps" and value is not None
    }
