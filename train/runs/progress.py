"""Progress reports during training: a progress bar in a terminal, otherwise occasional lines."""

from __future__ import annotations

import sys
import time
from collections.abc import Mapping
from typing import Any, Protocol

LINE_PERIOD = 10.0  # seconds between lines when there is no terminal


class Progress(Protocol):
    """Receiver of the training loop's progress reports."""

    def start(self, done: int, total: int) -> None:
        """Called when training starts (or continues) at ``done`` of ``total`` environment steps."""

    def say(self, text: str) -> None:
        """Called with a message to print."""

    def update(self, row: Mapping[str, Any]) -> None:
        """Called with each row of the learning curve."""

    def stop(self) -> None:
        """Called when training ends, for any reason."""


class Silent:
    """Shows nothing."""

    def start(self, done: int, total: int) -> None:
        """Nothing."""

    def say(self, text: str) -> None:
        """Nothing."""

    def update(self, row: Mapping[str, Any]) -> None:
        """Nothing."""

    def stop(self) -> None:
        """Nothing."""


def duration(seconds: float) -> str:
    """Format seconds: ``75`` -> ``1:15``; hours are shown only if needed."""
    minutes, seconds = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02d}:{seconds:02d}" if hours else f"{minutes}:{seconds:02d}"


class _Latest:
    """The most recent values, because rows without finished episodes have none of their own; and the time left."""

    def __init__(self) -> None:
        self.total = 0
        self.known: dict[str, float] = {}
        self._first: Mapping[str, Any] | None = None

    def begin(self, total: int) -> None:
        self.total, self._first = total, None

    def words(self, row: Mapping[str, Any]) -> str:
        self.known |= {k: v for k, v in row.items() if v is not None}
        parts = [f"{row['steps_per_second']:,.0f} steps/s"]
        if "return" in self.known:
            parts.append(f"return {self.known['return']:.1f}")
            spread = ""
            if "success_min" in self.known:
                spread = f" ({self.known['success_min']:.0%} to {self.known['success_max']:.0%})"
            parts.append(f"success {self.known['success']:.0%}{spread}")
            if "gentle" in self.known:
                parts.append(f"gentle {self.known['gentle']:.0%}")
        if "cost" in row:
            parts.append(f"cost {row['cost']:.2g}  multiplier {row['multiplier']:.2g}")
        if row["nan_total"]:
            parts.append(f"NaN {row['nan_total']:.0f}")
        left = self._left(row)
        parts += [] if left is None else [f"left {duration(left)}"]
        return "  ".join(parts)

    def _left(self, row: Mapping[str, Any]) -> float | None:
        """Seconds left at the speed since the session's first row, whose time includes compilation; None in that row."""
        if self._first is None:
            self._first = row
            return None
        done = row["env_steps"] - self._first["env_steps"]
        return (self.total - row["env_steps"]) * (row["seconds"] - self._first["seconds"]) / done


class Lines:
    """Plain lines, for logs: the first, the last, and at most one every ten seconds in between."""

    def __init__(self, period: float = LINE_PERIOD) -> None:
        self._latest = _Latest()
        self._period, self._next = period, 0.0
        self._trouble: OSError | None = None  # why the last line was not written

    def start(self, done: int, total: int) -> None:
        """See ``Progress``."""
        self._latest.begin(total)

    def say(self, text: str) -> None:
        """See ``Progress``. Where the log lies on a disk that is full, the next line that finds room says so."""
        reason = (
            f"Lines may be missing before this one: {self._trouble}.\n" if self._trouble else ""
        )
        try:
            print(f"{reason}{text}", flush=True)
            self._trouble = None
        except BrokenPipeError:  # nobody reads any more
            raise
        except OSError as error:
            self._trouble = error

    def update(self, row: Mapping[str, Any]) -> None:
        """See ``Progress``."""
        words, total = self._latest.words(row), self._latest.total
        now = time.monotonic()
        if now < self._next and row["env_steps"] < total:
            return
        self._next = now + self._period
        self.say(f"{row['env_steps']:>11,} steps {row['env_steps'] / total:4.0%}  {words}")

    def stop(self) -> None:
        """See ``Progress``."""


class Bar:
    """A progress bar with speed, return, success and time left, for terminals."""

    def __init__(self) -> None:
        from rich.console import Console
        from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn

        self._latest = _Latest()
        self._console = Console(highlight=False)
        columns = (
            BarColumn(bar_width=30),
            TaskProgressColumn(),
            TextColumn("{task.fields[words]}"),
        )
        self._progress = Progress(*columns, console=self._console)
        self._task: Any = None

    def start(self, done: int, total: int) -> None:
        """See ``Progress``."""
        self._latest.begin(total)
        self._progress.start()
        self._task = self._progress.add_task("train", total=total, completed=done, words="")

    def say(self, text: str) -> None:
        """See ``Progress``."""
        self._console.print(text, markup=False)

    def update(self, row: Mapping[str, Any]) -> None:
        """See ``Progress``."""
        self._progress.update(self._task, completed=row["env_steps"], words=self._latest.words(row))

    def stop(self) -> None:
        """See ``Progress``."""
        self._progress.stop()


def for_terminal() -> Progress:
    """Return a progress bar if standard output is a terminal, otherwise lines."""
    return Bar() if sys.stdout.isatty() else Lines()
