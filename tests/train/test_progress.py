# ruff: noqa: D103 (a test's name says what it shows)
"""What is printed during training."""

from __future__ import annotations

import pytest

from train.runs import progress
from train.runs.progress import Bar, Lines

ROWS = [
    {"env_steps": 2_000, "seconds": 110.0, "steps_per_second": 100.0},  # 10 s, with compilation
    {"env_steps": 3_000, "seconds": 111.0, "steps_per_second": 1_000.0},
    {"env_steps": 5_000, "seconds": 115.0, "steps_per_second": 500.0},
    {"env_steps": 11_000, "seconds": 127.0, "steps_per_second": 500.0},
]
"""Of a session that continues from step 1,000, after 100 s of training."""
LEFT = [None, "0:08", "0:10", "0:00"]
"""At 1,000 and at 600 steps/s, and at the end."""


def shown(shows, capsys: pytest.CaptureFixture) -> list[str]:
    found = []
    shows.start(1_000, 11_000)
    for row in ROWS:
        shows.update(row | {"nan_total": 0, "num_seeds": 4})
        found.append(capsys.readouterr().out)
    shows.stop()
    return found


def test_the_time_left_leaves_out_the_first_row_of_a_session(capsys):
    lines = Lines(period=0.0)
    for _ in range(2):  # each session compiles
        for text, left in zip(shown(lines, capsys), LEFT, strict=True):
            assert ("left" not in text) if left is None else text.endswith(f"  left {left}\n")


def test_lines_are_at_least_a_period_apart(capsys, monkeypatch):
    now = iter([0.0, 1.0, 5.0, 17.0])
    monkeypatch.setattr(progress.time, "monotonic", lambda: next(now))
    texts = shown(Lines(period=4.0), capsys)
    assert "left" not in texts[0] and texts[1] == "" and "left 0:10" in texts[2]


def test_the_bar_shows_the_same_time_left():
    bar = Bar()
    bar.start(1_000, 11_000)
    for row, left in zip(ROWS, LEFT, strict=True):
        bar.update(row | {"nan_total": 0})
        words = bar._progress.tasks[0].fields["words"]
        assert ("left" not in words) if left is None else words.endswith(f"  left {left}")
    bar.stop()
