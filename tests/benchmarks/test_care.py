# ruff: noqa: D103
"""Tables and pictures of docs/care.md, and policies measured among other people."""

from __future__ import annotations

import json
import sys
from types import SimpleNamespace

import numpy as np
import pytest

from agym_jax.human.population import Human
from benchmarks import care_tables, failures, memory_films, shipped
from train.evaluation.people import describe


def group(name, episodes, success, gentle):
    return {"name": name, "episodes": episodes, "success": success, "gentle_success": gentle}


@pytest.fixture
def folder(tmp_path):
    about = {"device": {"kind": "CPU"}, "commit": "abcdef12", "time": "2026-11-24T00:00:00"}
    line = about | {
        "env": "BedBathingPR2-v0",
        "episodes": 100,
        "success": 0.5,
        "gentle_success": 0.2,
        "task/wiped": 0.3456,
        "time_to_success": 12.34,
        "other_than_in_training": "humans.sizes",
        "groups": [
            group("men", 60, 0.7, 0.1),
            group("women", 40, 0.2, 0.3),
            group("with tremor", 5, 0.0, 0.0),  # five people are no group
        ],
    }
    (tmp_path / "everybody.jsonl").write_text(json.dumps(line) + "\n")
    usual = about | {"env": "BedBathingPR2-v0", "success": 0.6, "policy": "mode"}
    other = usual | {"policy": "random", "success": 0.0}
    (tmp_path / "evaluation.jsonl").write_text(f"{json.dumps(usual)}\n{json.dumps(other)}\n")
    return tmp_path


def test_the_group_that_fares_worst_is_named(folder):
    row = care_tables.everybody(folder).splitlines()[2]
    assert row == "| BedBathingPR2-v0 | 100 | 60.0% | 50.0% | 20% (women) | 20.0% | 10% (men) |"


def test_at_a_glance_there_is_a_row_for_each_task_with_its_robots_best_first(tmp_path):
    def line(env, success, gentle, peak, least):
        groups = [group("men", 50, success, gentle), group("women", 50, least, gentle)]
        return {
            "env": env, "episodes": 100, "success": success, "gentle_success": gentle, "peak_median": peak,
            "groups": groups, "device": {"kind": "CPU"}, "commit": "abcdef12", "time": "2030-01-01T00:00:00",
        }  # fmt: skip

    lines = [
        line("FeedingPR2-v0", 0.904, 0.5, 3.2, 0.8),
        line("FeedingJaco-v0", 0.95, 0.4, 12.0, 0.7),
        line("FeedingJacoHuman-v0", 0.1, 0.1, 99.0, 0.1),
    ]
    (tmp_path / "everybody.jsonl").write_text("\n".join(map(json.dumps, lines)) + "\n")
    _, _, row, *_, about = care_tables.glance(tmp_path).splitlines()
    assert row == (
        "| feed with a spoon (Feeding) | Jaco 95 (40), PR2 90 (50) | 3 to 12 N | 70 (Jaco; women) |"
    )
    assert about.startswith("Passive people of every size; CPU")


def test_units_of_care_are_those_of_the_task(folder):
    row = care_tables.care(folder).splitlines()[2]
    assert row == "| BedBathingPR2-v0 | 35% wiped | 12.3 s |"


def test_only_what_misses_its_goal_is_a_shortfall(tmp_path):
    about = {"device": {"kind": "CPU"}, "commit": "abcdef12", "time": "2030-01-01T00:00:00"}

    def lines(file, **envs):
        def line(env, success, gentle, least):
            return about | {
                "env": env, "policy": "mode", "human_policy": "person", "success": success,
                "gentle_success": gentle, "groups": [group("men", 50, least, gentle)],
                "other_than_in_training": "humans.sizes" if file == "everybody" else "",
                "region_over_comfort": {"hand": 0.1, "face": 1 - gentle, "neck": 0.0},
            }  # fmt: skip

        text = "".join(json.dumps(line(f"{name}-v0", *x)) + "\n" for name, x in envs.items())
        (tmp_path / f"{file}.jsonl").write_text(text)

    robots = {"FeedingPR2": (0.97, 0.95, 0.9), "FeedingJaco": (0.97, 0.89, 0.9)}
    lines("evaluation", **robots, FeedingSawyer=(0.97, 0.97, 0.9))
    lines("everybody", **robots, FeedingSawyer=(0.9, 0.9, 0.79))
    lines("crossplay", FeedingPR2Human=(0.95, 0.1, 0.9), FeedingJacoHuman=(0.94, 0.94, 0.9))
    rows = [row.split(" | ") for row in care_tables.shortfalls(tmp_path).splitlines()[2:5]]
    assert [row[0] for row in rows] == [
        "| FeedingJaco-v0",
        "| FeedingJacoHuman-v0",
        "| FeedingSawyer-v0",
    ]
    assert rows[0][1:] == ["89.0%", "3.0%", "8.0%", "90% (men)", "90% (men)", "face, 11% |"]
    assert rows[1][5] == "" and rows[2][5] == "79% (men)" and rows[2][6] == "hand, 10% |"


def test_a_page_without_results_says_so(tmp_path):
    assert "|" not in care_tables.everybody(tmp_path) and "|" not in care_tables.care(tmp_path)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({}, "a man without impairment"),
        ({"sex": 1.0, "tremor": np.array([0.0, -0.1])}, "a woman with tremor"),
        ({"strength": 0.5, "limit_scale": 0.7}, "a man with limited joints and with weakness"),
    ],
)
def test_a_person_in_words(changes, words):
    usual = dict.fromkeys(("stature", "girth", "strength", "limit_scale"), 1.0)
    usual |= {"sex": 0.0, "tremor": np.zeros(2)}
    assert describe(Human(**usual | changes)) == words


def test_strips_of_failures_are_filled_into_the_page(tmp_path, monkeypatch):
    monkeypatch.setattr(failures, "FAILURES", tmp_path)
    (tmp_path / "FeedingPR2-v0.jpg").write_bytes(b"")
    page = "before\n<!-- failures -->\nold\n<!-- /failures -->\nafter"
    found = failures.fill(page)
    assert found.startswith("before\n<!-- failures -->\n**FeedingPR2-v0**") and "old" not in found
    assert "(images/failures/FeedingPR2-v0.jpg)" in found and found.endswith("\nafter")
    assert failures.fill(found) == found
    assert failures.main(["FeedingPR3-v0"]) == 2


def test_films_of_policies_with_a_memory_are_shown_on_their_page(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(memory_films, "FOLDER", tmp_path)
    for name in ("A.webp", "B.webp", "B.jpg"):
        (tmp_path / name).touch()
    found = memory_films.fill("before\n<!-- films -->\nold\n<!-- /films -->\nafter")
    assert "| A | B |\n|---|---|\n| ![A](images/memory/A.webp) | ![B]" in found
    assert "![B fails](images/memory/B.jpg)" in found and "old" not in found
    assert memory_films.fill(found) == found
    assert memory_films.main(["BedBathingPR3-v0"]) == 2
    assert "BedBathingPR2-v0" in capsys.readouterr().err


def test_policies_can_be_measured_with_other_flags(monkeypatch, capsys, tmp_path):
    commands = []

    def run(command, **_):
        commands.append(command)
        file = command[command.index("--json") + 1]
        with open(file, "w") as out:
            json.dump({"success": 0.5, "return_mean": 1.0, "policy": file}, out)
        return SimpleNamespace(returncode=0)

    monkeypatch.setattr(shipped.subprocess, "run", run)
    out = tmp_path / "lines.jsonl"
    words = ["--only", "FeedingPR2-v0", "--seed", "3", "--flags=--humans.sizes continuous"]
    words += ["--json", str(out)]
    assert shipped.main(words) == 0  # what is recorded is of other people: nothing differs from it
    assert commands[0][0] == sys.executable and commands[0][-2:] == ["--humans.sizes", "continuous"]
    assert json.loads(out.read_text())["policy"] == "mode"  # no path of this machine
    assert "DIFFERS" not in capsys.readouterr().out


def test_lines_of_pairs_are_told_as_the_results_have_them():
    pair = {"env": "FeedingPR2Human-v0", "kind": "evaluation", "policy": "/a", "human_policy": "/b"}
    told = shipped.as_recorded(pair)
    assert (told["kind"], told["robot_policy"], told["human_policy"]) == (
        "crossplay",
        "robot",
        "person",
    )
    assert shipped.as_recorded({"kind": "evaluation", "policy": "/a"})["kind"] == "evaluation"
