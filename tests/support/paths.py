"""Folders that tests read."""

from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
"""The checkout."""
DATA = Path(__file__).resolve().parent / "data"
"""Recorded tables and the toy robot."""
SUPPORT = Path(__file__).resolve().parent
"""Helpers that tests import; on the Python path."""
