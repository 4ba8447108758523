# ruff: noqa: D103
"""The same episodes on several implementations: differences are found where there are some, and only there."""

import json

import numpy as np
import pytest

from benchmarks import implementations, physics_tables
from benchmarks.implementations import ImplementationsConfig, Played, compare, play


def played(success: list[bool], shift: float = 0.0) -> Played:
    """Two episodes of three joints at four times; the second's last joint is shifted at the last time."""
    angles = np.zeros((4, 2, 3))
    angles[3, 1, 2] = shift
    return Played(np.array(success), np.array([1.0, 2.0]), angles)


def test_the_joint_that_is_farthest_off_counts():
    same = compare(played([True, False]), played([True, False]))
    assert same["same_outcome"] == 2 and same["success"] == 1 and max(same["off_largest"]) == 0.0
    other = compare(played([True, False]), played([False, False], shift=-0.3))
    assert other["same_outcome"] == 1 and other["success"] == 0
    assert other["off_largest"] == pytest.approx([0.0, 0.0, 0.0, 0.3])
    assert other["off_median"] == pytest.approx([0.0, 0.0, 0.0, 0.15])


@pytest.mark.slow
def test_c_mujoco_does_the_same_twice():
    config = ImplementationsConfig(num_episodes=2)
    first, again = (play("ReachingSawyer-v0", "native", config) for _ in range(2))
    found = compare(first, again)
    assert first.success.all() and found["same_outcome"] == 2 and max(found["off_largest"]) == 0.0
    assert first.angles.shape[:2] == (len(physics_tables.STEPS_COMPARED), 2)
    assert np.ptp(first.angles, axis=0).max() > 0.1  # it moves


def test_the_table_has_a_row_for_each_that_is_compared(tmp_path):
    found = compare(played([True, False]), played([False, False], shift=0.25))
    line = {
        "env": "A-v0", "impl": "native", "episodes": 2, "success": 1, "others": {"jax": found, "warp": found},
        "commit": "x", "device": {"kind": "CPU"}, "time": "2026-12-01T00:00:00",
    }  # fmt: skip
    (tmp_path / "implementations.jsonl").write_text(json.dumps(line) + "\n")
    rows = physics_tables.implementations(tmp_path).splitlines()[2:4]
    same = " 2 | 1, 0 | 1 | 0 (0) | 0 (0) | 0 (0) | 0.1 (0.2) |"
    assert rows == [f"| A-v0 | C MuJoCo, {other} |{same}" for other in ("MJX", "Warp")]


def test_one_implementation_cannot_be_compared(capsys: pytest.CaptureFixture):
    assert implementations.main(["--only", "ReachingSawyer-v0", "--impls", "native"]) == 2
    assert "at least two implementations" in capsys.readouterr().err
