# ruff: noqa: D103 (a test's name says what it shows)
"""What choosing among candidates is worth is computed from the curves of trainings without them."""

from __future__ import annotations

import json

import pytest

from benchmarks import best_of
from benchmarks.best_of import SHARES


def curve(returns, successes):
    return [
        {"return_per_step": x, "success": y, "episodes": 9, "env_steps": 100 * (i + 1)}
        for i, (x, y) in enumerate(zip(returns, successes, strict=True))
    ]


# each of 20 rows: one is good at first and stays there; one is poor, succeeds from the middle on; two do nothing
PARKED = curve([5.0] * 20, [0.0] * 20)
LEARNS = curve([-5.0] * 20, [0.0] * 6 + [0.5] * 6 + [1.0] * 8)
NOTHING = curve([-9.0] * 20, [0.0] * 20)
CURVES = [PARKED, LEARNS, NOTHING, NOTHING]


def test_of_two_the_one_that_succeeds_is_taken_as_soon_as_it_does():
    found = best_of.best_of(CURVES, candidates=2)
    assert found["ends"] == [0.0, 1.0, 0.0, 0.0]
    # of the six pairs, three have the one that learns; by its return, it is better than nothing alone
    assert found["by_success"] == pytest.approx([2 / 6, 2 / 6, 3 / 6, 3 / 6, 3 / 6])
    assert found["by_return"] == pytest.approx([2 / 6] * len(SHARES))


def test_all_as_candidates_of_one_are_the_best():
    assert best_of.best_of(CURVES, candidates=4)["by_success"][-1] == 1.0


def write_run(folder, curves):
    for i, rows in enumerate(curves):
        path = folder / f"seed_{i + 1}" / "curve.jsonl"
        path.parent.mkdir(parents=True)
        path.write_text("".join(json.dumps(row) + "\n" for row in rows))
    about = {"commit": "abc", "device": {"kind": "GPU"}, "versions": {}, "time": "2026-11-27T00:00"}
    (folder / "config.json").write_text(json.dumps(about | {"config": {"memory": [0.3]}}))


def test_a_line_for_each_run_without_seeds_that_were_stopped(tmp_path, capsys):
    write_run(tmp_path / "ReachingJaco-v0", [*CURVES, LEARNS[:5]])
    lines = tmp_path / "lines.jsonl"
    assert best_of.main([str(tmp_path / "ReachingJaco-v0"), "--json", str(lines)]) == 0
    assert "ReachingJaco-v0" in capsys.readouterr().out
    line = json.loads(lines.read_text())
    assert (line["num_seeds"], line["num_env_steps"], line["memory"]) == (4, 2000, [0.3])
    assert line["candidates"] == 4 and line["by_success"] == [0.0, 0.0, 1.0, 1.0, 1.0]


def test_runs_with_candidates_and_no_candidates_are_refused(tmp_path, capsys):
    run = tmp_path / "ReachingJaco-v0"
    write_run(run, CURVES)
    assert best_of.main([str(run), "--candidates", "0"]) == 2
    about = json.loads((run / "config.json").read_text())
    about["config"]["num_candidates"] = 4
    (run / "config.json").write_text(json.dumps(about))
    assert best_of.main([str(run)]) == 2
    assert "was trained with candidates" in capsys.readouterr().err


def test_too_few_seeds_are_refused(tmp_path, capsys):
    write_run(tmp_path / "ReachingJaco-v0", CURVES[:3])
    assert best_of.main([str(tmp_path / "ReachingJaco-v0")]) == 2
    assert "curves of 3 seeds" in capsys.readouterr().err
