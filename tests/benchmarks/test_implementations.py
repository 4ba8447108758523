# ruff: noqa: D103
"""The same episodes on several implementations: differences are found where there are some, and only there."""

import json

import numpy as np
import pytest

from benchmarks import implementations, physics_tables
from benchmarks.implementations import ImplementationsConfig, Played, compare, measure
from train.envs import make_env


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
def test_c_mujoco_is_itself(monkeypatch: pytest.MonkeyPatch, tmp_path):
    """Played twice, the same comes out to the last bit; the table shows it."""
    monkeypatch.setattr(implementations, "make_env", lambda name, _: make_env(name, "native"))
    monkeypatch.setattr(implementations, "jax", NoJit)
    config = ImplementationsConfig(num_episodes=2, impls=("native", "jax"))
    fields = measure("ReachingSawyer-v0", config)
    found = fields["others"]["jax"]
    assert fields["success"] == found["success"] == found["same_outcome"] == 2
    assert found["return"] == fields["return"] and max(found["off_largest"]) == 0.0
    about = {"commit": "x", "device": {"kind": "CPU"}, "time": "2026-12-01T00:00:00"}
    (tmp_path / "implementations.jsonl").write_text(json.dumps(fields | about) + "\n")
    row = physics_tables.implementations(tmp_path).splitlines()[2]
    assert row == "| ReachingSawyer-v0 | C MuJoCo, MJX | 2 | 2, 2 | 2 |" + " 0 (0) |" * 4


class NoJit:
    """Of JAX what ``play`` needs."""

    import jax.random as random

    @staticmethod
    def jit(function):  # noqa: D102
        return function


def test_one_implementation_cannot_be_compared(capsys: pytest.CaptureFixture):
    assert implementations.main(["--only", "ReachingSawyer-v0", "--impls", "native"]) == 2
    assert "at least two implementations" in capsys.readouterr().err
