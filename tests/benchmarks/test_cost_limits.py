# ruff: noqa: D103
"""What gentleness costs, from the folder of a sweep to a table and a picture."""

from __future__ import annotations

import json
from types import SimpleNamespace
from typing import Any

import pytest
from PIL import Image

from benchmarks import care_tables, limit_curves, limits


@pytest.fixture
def lines(tmp_path):
    """Two limits, measured twice; the second measurement counts."""
    about = {"commit": "abc", "device": {"kind": "CPU"}, "episodes": 300, "seeds": [1, 2]}
    for day, success in ((1, 0.1), (2, 0.9)):
        for limit, gentle in ((0.1, 0.8), (1e6, 0.2)):
            line = {
                "kind": "limit", "env": "FeedingJaco-v0", "cost_limit": limit, "num_env_steps": 5e5,
                "success_of_seeds": [success, success + 0.1], "gentle_success_of_seeds": [gentle, gentle],
                "peak_median_of_seeds": [4.0, 6.0], "time": f"2027-01-0{day}T00:00:00", **about,
            }  # fmt: skip
            with (tmp_path / "limits.jsonl").open("a") as file:
                file.write(json.dumps(line) + "\n")
    return tmp_path


def test_the_table_begins_without_a_limit(lines):
    rows = [x for x in care_tables.limits(lines).splitlines() if x.startswith("| Feeding")]
    assert rows == [
        "| FeedingJaco-v0 | none | 2 x 0.5 M | 95.0% (90.0% to 100.0%) | 20.0% (20.0% to 20.0%) | 5.0 N |",
        "| FeedingJaco-v0 | 0.1 | 2 x 0.5 M | 95.0% (90.0% to 100.0%) | 80.0% (80.0% to 80.0%) | 5.0 N |",
    ]


def test_the_picture_is_drawn_when_results_change(lines, tmp_path, capsys):
    picture = tmp_path / "limits.png"
    assert limit_curves.main(["--check"], lines, picture) == 1
    assert "python -m benchmarks.limit_curves" in capsys.readouterr().err
    assert (
        limit_curves.main([], lines, picture) == 0 == limit_curves.main(["--check"], lines, picture)
    )
    with Image.open(picture) as drawn:
        assert len(drawn.convert("RGB").getcolors(1 << 20) or []) > 10
    (lines / "limits.jsonl").write_text(
        (lines / "limits.jsonl").read_text().replace('"cost_limit": 0.1', '"cost_limit": 0.2')
    )
    assert limit_curves.main(["--check"], lines, picture) == 1


def test_every_limit_of_a_sweep_is_measured_over_the_same_people(tmp_path, monkeypatch):
    sweep = tmp_path / "FeedingJaco-v0"
    for limit in ("1e+06", "0.1"):
        (sweep / f"cost_limit={limit}").mkdir(parents=True)
    (sweep / "config.json").write_text(json.dumps({"config": {"num_env_steps": 7, "num_envs": 3}}))
    asked: list[Any] = []

    def load_seeds(folder, make, impl):
        return make("FeedingJaco-v0", impl), {1: folder.name}

    def score_seeds(evaluator, policies, key):
        asked.append((evaluator.env.name, policies[1], key.tolist()))
        result = SimpleNamespace(summary=lambda: {"peak_median": 2.0})
        return SimpleNamespace(
            results={1: result}, summary=lambda: {"env": evaluator.env.name}, table=str
        )

    monkeypatch.setattr(limits, "load_seeds", load_seeds)
    monkeypatch.setattr(limits, "score_seeds", score_seeds)
    monkeypatch.setattr(
        limits, "make_env", lambda name, impl: SimpleNamespace(name=name, impl=impl)
    )
    monkeypatch.setattr(limits, "Evaluator", lambda env, episodes: SimpleNamespace(env=env))
    kept = tmp_path / "limits.jsonl"
    assert limits.main([str(sweep), "--impl", "native", "--json", str(kept)]) == 0
    found = [json.loads(x) for x in kept.read_text().splitlines()]
    assert [x["cost_limit"] for x in found] == [0.1, 1e6]
    assert [x[1] for x in asked] == ["cost_limit=0.1", "cost_limit=1e+06"]
    assert asked[0][2] == asked[1][2] and {x[0] for x in asked} == {"FeedingJaco-v0"}
    assert found[0]["peak_median_of_seeds"] == [2.0] and found[0]["num_env_steps"] == 7


def test_a_folder_without_limits_is_refused(tmp_path, capsys):
    assert limits.main([str(tmp_path)]) == 2
    assert "agym-jax sweep --grid cost_limit=" in capsys.readouterr().err


def test_limits_are_compared_with_everything_else_alike(tmp_path):
    for limit in ("1e+06", "0.1"):
        (tmp_path / f"lr=0.0002,cost_limit={limit}").mkdir()
    folders, others = limits.limits_of(tmp_path)
    assert sorted(folders) == [0.1, 1e6]
    assert others == {"lr": 0.0002}
    (tmp_path / "lr=0.001,cost_limit=0.5").mkdir()
    with pytest.raises(limits.SweepFolderError, match=r"lr=0\.001"):
        limits.limits_of(tmp_path)
