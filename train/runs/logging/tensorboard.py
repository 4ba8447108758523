"""Event files for TensorBoard, by tensorboardX, which needs neither TensorFlow nor PyTorch.

In ``<run>/tensorboard``, and ``<run>/tensorboard/seed_1`` and so on for each of several seeds: TensorBoard shows them
as runs of their own, one over the other. Events are written here and now, not by a thread that dies with the process.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from pathlib import Path

from tensorboardX.event_file_writer import EventsWriter
from tensorboardX.proto.event_pb2 import Event, SessionLog
from tensorboardX.summary import hparams, scalar

from ..curve import Row
from .protocol import Curves, LoggedRun, values

SHOWN = ("train/success", "train/return")
"""Beside the hyper-parameters."""


class TensorBoard:
    """See ``Logger``.

    A session writes the whole curve anew, into files of its own, and removes the older ones.

    Args:
        run: what is logged.
    """

    def __init__(self, run: LoggedRun) -> None:
        self._run, self._folder = run, run.folder / "tensorboard"
        self._writers: dict[str, EventsWriter] = {}

    def begin(self, curves: Curves) -> None:
        """See ``Logger``."""
        self.close()
        for name, curve in curves.items():
            self._begin(self._folder / name, name, curve)

    def _begin(self, folder: Path, name: str, curve: Sequence[Row]) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        old = list(folder.glob("events.*"))
        writer = EventsWriter(str(folder / "events"), f".{time.time_ns()}")
        # a TensorBoard that is watching forgets what it has read before
        restart = SessionLog(status=SessionLog.START)
        writer.write_event(Event(wall_time=time.time(), step=0, session_log=restart))
        if not name:
            for summary in hparams(dict(self._run.settings), dict.fromkeys(SHOWN, 0.0)):
                writer.write_event(Event(wall_time=time.time(), summary=summary))
        began = time.time() - (curve[-1]["seconds"] if curve else 0.0)
        for row in curve:
            _write(writer, row, began + row["seconds"])
        writer.flush()
        self._writers[name] = writer
        for path in old:
            path.unlink(missing_ok=True)

    def add(self, curves: Curves) -> None:
        """See ``Logger``."""
        for name, rows in curves.items():
            for row in rows:
                _write(self._writers[name], row, time.time())
            self._writers[name].flush()

    def close(self) -> None:
        """See ``Logger``."""
        while self._writers:
            _, writer = self._writers.popitem()
            writer.close()


def _write(writer: EventsWriter, row: Row, when: float) -> None:
    """A row at a time (Unix time [s]): one event with all its numbers."""
    event = Event(wall_time=when, step=int(row["env_steps"]))
    for name, value in values(row).items():
        event.summary.value.extend(scalar(name, value).value)
    writer.write_event(event)
