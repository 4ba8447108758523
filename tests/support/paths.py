"""Folders that tests read."""

from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
"""The checkout."""
DATA = Path(__file__).resolve().parent / "data"
"""Recorded tables and the toy robot."""
SUPPORT = Path(__file__).resolve().parent
"""Helpers that tests import; on the Python path."""

PROCESS_SECONDS = 900
"""After which a process that a test has started hangs: ten times what the slowest takes on two cores."""
