"""What the tests of every section of the parity page ask of its rows."""

from __future__ import annotations

from collections.abc import Iterable

from benchmarks.deviations import collect
from benchmarks.parity.row import Row


def assert_rows_hold_or_name_a_deviation(rows: Iterable[Row]) -> None:
    """Each is within its tolerance, or the deviation that it names exists."""
    known = {note.slug for note in collect()}
    for row in rows:
        assert row.holds or row.deviation in known, row
