"""How long the commands of a suite took, from the journal beside its runs."""

from __future__ import annotations

from pathlib import Path

from agym_jax.errors import AgymError
from benchmarks.markdown import Line
from train.runs.overview import JOURNAL, read_rows


class JournalError(AgymError, ValueError):
    """A journal of a suite that has not ended, or none."""


def whole_suite(folder: Path) -> Line:
    """What trainings and choices of a suite took, from its journal; pauses, and its films, do not count.

    Returns:
        ``seconds`` in which at least one of them ran, ``process_seconds`` of all together, and the number of ``gpus``.

    Raises:
        JournalError: there is no journal, or something has not ended.
    """
    running: dict[tuple[str, str], Line] = {}
    times, gpus = [], set()
    for row in read_rows(folder / JOURNAL):
        command = row["env"], row["command"]
        if row["command"] == "enjoy":
            continue
        if "began" in row:
            running[command] = row
        elif begun := running.pop(command, None):
            times.append((begun["began"], begun["began"] + row["seconds"]))
            gpus.add(begun["gpu"])
    if running or not times:
        going = ", ".join(" of ".join(reversed(x)) for x in running) or "nothing"
        raise JournalError(
            f"--suite needs the journal of a suite that has ended; {folder / JOURNAL} tells of {len(times)} commands that have, "
            f"and of these that have not: {going}."
        )
    seconds, reached = 0.0, 0.0
    for begin, end in sorted(times):
        seconds += max(0.0, end - max(begin, reached))
        reached = max(reached, end)
    every = sum(end - begin for begin, end in times)
    return {"seconds": round(seconds), "process_seconds": round(every), "gpus": len(gpus)}
