# ruff: noqa: D103
"""Which figures are of an earlier physics, and where that is explained."""

from __future__ import annotations

from benchmarks.markdown import CHANGES, PHYSICS_SINCE, TASK_SINCE, dates


def test_every_change_of_the_physics_is_explained():
    assert set(CHANGES) == {PHYSICS_SINCE, *TASK_SINCE.values()}
    text = dates()
    assert all(name in text for name in TASK_SINCE)
    assert len(text.splitlines()) == 2 + len(CHANGES)
