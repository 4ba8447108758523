# ruff: noqa: D103 (a test's name says what it shows)
"""Tables of trainings that begin with a policy."""

from __future__ import annotations

import json

import pytest

from benchmarks import continued_tables
from benchmarks.trained import KEPT_SINCE, statistics, trained_among

SCORES = {"gentle_success": 0.5, "success": 0.75, "peak_median": 4.0}


def line(started_from, person_started_from=None, **more):
    """A choice between two seeds of a pair under a force limit."""
    return {
        "kind": "seed-selection", "env": "DrinkingPR2Human-v0", "seeds": [1, 2], "success_of_seeds": [0.5, 0.7],
        "gentle_success_of_seeds": [0.4, 0.6], "num_env_steps": 1_000_000, "episodes": 1000, "overflow": 0, "chosen": 2,
        "cost_limit": 0.1, "started_from": started_from, "person_started_from": person_started_from, "statistics": "kept",
        "reported": SCORES, "shipped": SCORES, "time": "2026-12-01T00:00:00+00:00", "commit": "0" * 40,
        "device": {"kind": "NVIDIA H200", "platform": "gpu"}, **more,
    }  # fmt: skip


def test_what_a_training_under_a_limit_began_with(tmp_path):
    pair = "assets/policies/DrinkingPR2Human-v0.npz"
    began = {
        "the pair before": line("shipped", "shipped"),
        "the robot's policy": line("shipped"),
        "a new policy": line(None, statistics=None),
        "one that did not ship": line("runs/policy.npz"),
    }
    rows = [*began.values(), line(pair, statistics="drift"), line(pair, num_env_steps=2_000_000)]
    rows.append(line("shipped", statistics="drift", env="ReachingPR2Human-v0"))
    (tmp_path / "gentle.jsonl").write_text("".join(json.dumps(x) + "\n" for x in rows))
    table = continued_tables.gentle(tmp_path).splitlines()
    cells = [[x.strip() for x in row.strip("|").split("|")] for row in table[2:] if "Human" in row]
    drinking, reaching = "DrinkingPR2Human-v0", "ReachingPR2Human-v0"
    assert sorted((x[0], x[4], x[5]) for x in cells) == sorted([
        (drinking, "the pair before", "2 x 1 M"), (drinking, "the pair before", "2 x 2 M"), (drinking, "the robot's policy", "2 x 1 M"),
        (drinking, "one that did not ship", "2 x 1 M"), (drinking, "a new policy", "2 x 1 M"),
        (reaching, "the robot's policy", "2 x 1 M"),  # statistics drifted; there is no other of this environment
    ])  # fmt: skip


def test_continued_trainings_with_drift_give_way_to_newer_ones_and_the_others_stay(tmp_path):
    steps = {"drift": (1_000_000, 2_000_000, 3_000_000), "kept": (4_000_000, 5_000_000, 5_000_000)}
    rows = [
        line(
            "shipped",
            statistics=statistics_,
            num_env_steps=count,
            chosen=number,
            chosen_success=0.7,
        )
        for statistics_, counts in steps.items()
        for number, count in enumerate(counts)
    ]
    (tmp_path / "continued.jsonl").write_text("".join(json.dumps(x) + "\n" for x in rows))
    shown = [row for row in continued_tables.continued(tmp_path).splitlines() if "Human" in row]
    assert [row.split("|")[2].strip() for row in shown] == ["2 x 3 M", "2 x 4 M", "2 x 5 M"]
    assert "| 2: 70.0% |" in shown[-1]  # the newer one of those with as many steps


@pytest.mark.parametrize(
    ("robot", "person", "time", "told"),
    [("shipped", None, "2026-11-29T05:04", "drift"), (None, "h.npz", KEPT_SINCE, "kept"), (None, None, KEPT_SINCE, None)],
)  # fmt: skip
def test_statistics_are_kept_since_a_day(robot, person, time, told):
    training = {"started_from": robot, "person_started_from": person, "time": time}
    assert statistics(training) == {"statistics": told}


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({}, ""),
        ({"humans.sizes": "both", "robot.rare_starts": 1.0}, ", people of both kinds of size, `--robot.rare-starts 1.0`"),
        ({"humans.sizes": "continuous"}, ", people of every size"),
    ],
)  # fmt: skip
def test_among_whom_a_policy_was_trained(changes, told):
    assert trained_among({"trained_with": changes}) == told
