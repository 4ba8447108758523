# ruff: noqa: D103
"""Which figures are of an earlier physics, and where that is explained."""

from __future__ import annotations

import pytest

from agym_jax import list_envs
from benchmarks.markdown import CHANGES, dates, former, is_earlier


def test_every_change_of_the_physics_is_explained_and_of_some_environment():
    assert len(dates().splitlines()) == 2 + len(CHANGES)
    for time, (ids, what) in CHANGES.items():
        assert what in dates() and time.replace("T", ", ") in dates()
        assert all(any(env.startswith(x) for env in list_envs()) for x in ids)


@pytest.mark.parametrize(
    ("env", "time", "earlier"),
    [
        ("FeedingBaxter-v0", "2026-11-22T23:00", True),
        ("FeedingBaxter-v0", "2026-11-23T01:00", False),
        ("ReachingPR2-v0", "2026-11-26T20:00", True),
        ("ReachingPR2-v0", "2026-11-26T21:00", False),
        ("DrinkingPR2Human-v0", "2026-11-27T00:30", True),
        ("DrinkingJaco-v0", "2026-11-27T00:30", False),
        ("ArmManipulationJaco-v0", "2026-11-23T08:00", True),
        ("ScratchItchBaxter-v0", "2026-11-23T08:00", False),
        ("ScratchItchPR2Human-v0", "2026-11-23T08:00", True),
        ("BedBathingBaxter-v0", "2026-11-24T23:00", True),
        ("BedBathingBaxter-v0", "2026-11-27T08:00", False),
        ("DressingSawyer-v0", "2026-11-25T01:00", False),
        ("DressingBaxter-v0", "2026-11-24T08:00", False),
        ("BedBathingSawyer-v0", "2026-11-24T08:00", True),
    ],
)
def test_a_result_is_of_the_physics_of_its_time(env, time, earlier):
    assert is_earlier({"env": env, "time": time}) is earlier
    theirs = {"kind": "in-assistive-gym", "env": env, "time": time}
    assert not is_earlier(theirs)  # our changes do not change Assistive Gym


def test_what_another_training_made_is_a_former_policy():
    assert former("abcdef0123", "abcdef0") == "" == former(None, "abc")
    assert former("abcdef0123", "1234567") == " (a former policy)"
