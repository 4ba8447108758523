# ruff: noqa: D103
"""Success by the family of poses in which the arm begins."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from benchmarks import starts


def test_families_are_poses_around_the_one_that_most_are_like():
    angles = np.array([[0.3], [0.0], [-0.4], [0.7], [3.1], [3.2 - 2 * np.pi], [1.7]])
    middles = starts.families(angles)
    # 0.3 has two like it, 3.1 one, and then one is left of each
    assert middles.tolist() == [0, 4, 2, 6]


def test_successes_are_counted_by_family(monkeypatch: pytest.MonkeyPatch):
    bank = np.zeros((8, 2), np.float32)
    bank[6:] = 2.0
    begun = np.array([[0.1, 0.0], [2.1, 2.0], [0.0, 0.2], [1.9, 2.0]])
    done = np.array([True, False, True, True])
    env = SimpleNamespace(episode_length=2, impl="native", task=None, robot=None)

    class Evaluator:
        def __init__(self, env: Any, num_episodes: int, at_once: int) -> None:
            self.count = num_episodes

        def __call__(self, policy: Any, key: Any, watch: Any) -> SimpleNamespace:
            # two batches of two, each with a first state and two steps
            for part in np.split(begun, 2):
                for step in range(3):
                    angles = part + step  # only where they begin counts
                    placement = SimpleNamespace(arm_angles=angles)
                    watch(SimpleNamespace(episode=SimpleNamespace(placement=placement)))
            gentle = done & [True, True, False, True]
            return SimpleNamespace(successes=done, gentle_successes=gentle, success=done.mean())

    monkeypatch.setattr(starts, "Evaluator", Evaluator)
    monkeypatch.setattr(starts, "make_env", lambda *_: env)
    monkeypatch.setattr(starts, "find_policies", lambda name: name)
    monkeypatch.setattr(starts, "load_policies", lambda *_: None)
    monkeypatch.setattr(starts, "load_bank", lambda *_: SimpleNamespace(arm_angles=bank))
    found = starts.measure("DrinkingBaxter-v0", starts.StartsConfig(num_episodes=4))["families"]
    assert [x["episodes"] for x in found] == [2, 2]
    assert [x["successes"] for x in found] == [2, 1]
    assert [x["gentle_successes"] for x in found] == [1, 1]


def test_an_unknown_name_is_answered_before_long_work(capsys: pytest.CaptureFixture[str]):
    assert starts.main(["--only", "DrinkingBakster"]) == 2
    assert "DrinkingBaxter" in capsys.readouterr().err
