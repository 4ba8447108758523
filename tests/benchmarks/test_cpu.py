# ruff: noqa: D103
"""Measuring on a CPU: what becomes of the lines, and when a training was good enough."""

from __future__ import annotations

import json
from typing import Any

import pytest

from benchmarks import cpu, cpu_tables, laptop
from benchmarks.child import ChildError

ABOUT = {"commit": "0123456789", "device": {"kind": "CPU", "cpu_cores": 2}}


def _write(folder, name: str, lines: list[dict[str, Any]]) -> None:
    (folder / f"{name}.jsonl").write_text("".join(json.dumps(ABOUT | x) + "\n" for x in lines))


def _speed(impl: str, speed: int, **more: Any) -> dict[str, Any]:
    line = {"measured": "speed", "env": "FeedingJaco-v0", "impl": impl, "num_envs": 64}
    times = {"steps_per_s": speed, "cpu_steps_per_s": 7, "time": "2126-01-01"}
    return line | times | {"machine": "slow"} | more


def _cells(text: str) -> list[list[str]]:
    return [[x.strip() for x in row.split("|")[1:-1]] for row in text.splitlines() if "|" in row]


def test_ratios_are_of_figures_from_one_machine(tmp_path):
    gym = _speed("assistive-gym", 100, num_envs=2, time="2126-01-03")
    fast = {"machine": "fast", "time": "2126-01-02"}
    lines = [
        _speed("native", 1000),
        gym,
        _speed("native", 9000, **fast),
        _speed("jax", 3000, **fast),
        _speed("native", 6000, **fast) | {"measured": "training"},
    ]
    _write(tmp_path, "cpu", lines)
    head, _, row = _cells(cpu_tables.speed(tmp_path))
    found = dict(zip(head, row, strict=True))
    assert found["C MuJoCo, 64"] == "9,000" and found["C MuJoCo / MJX"] == "3.0"
    assert found["training"] == "6,000" and found["its share of C MuJoCo"] == "67%"
    assert (
        found["Assistive Gym"] == "100" and found["C MuJoCo / Assistive Gym"] == "10.0"
    )  # to 1000, where it ran
    assert "Assistive Gym: slow" in cpu_tables.speed(tmp_path)
    assert [row[3] for row in _cells(cpu_tables.summary(tmp_path))[2:]] == ["9,000", "3,000", "100"]


def test_of_several_runs_at_one_commit_the_median_counts(tmp_path):
    runs = [_speed("native", x, time=f"2126-01-0{i}") for i, x in enumerate((500, 900, 700), 2)]
    older = _speed("native", 800, time="2126-01-01") | {"commit": "older"}
    _write(tmp_path, "cpu", [*runs, older])
    assert [row[3] for row in _cells(cpu_tables.summary(tmp_path))[2:]] == ["700"]


def test_seeds_of_a_laptop_are_one_row(tmp_path):
    run = {"what": "train", "env": "FeedingJaco-v0", "minutes": 15.0, "episodes": 500}
    run |= {"seconds": 900.0, "env_steps": 4_000_000, "steps_per_s": 5000, "success": 0.5}
    ends = ((0.8, None), (0.9, 300.0), (1.0, 600.0))
    lines = [
        run | {"seed": i, "success_sampled": x, "seconds_to_90": at}
        for i, (x, at) in enumerate(ends)
    ]
    _write(tmp_path, "laptop", lines)
    head, _, row = _cells(cpu_tables.laptop(tmp_path))
    found = dict(zip(head, row, strict=True))
    assert found["success, sampled"] == "90% (80% to 100%)" and found["seeds"] == "3"
    assert found["90 % while training"] == "2 of 3, after 5.0 to 10.0 min"


def test_success_counts_over_enough_episodes():
    rows = [{"episodes": 10, "success": 1.0, "seconds": 1.0}]
    rows += [{"episodes": 50, "success": 0.5 + 0.1 * i, "seconds": 10.0 + i} for i in range(6)]
    assert laptop.seconds_to(rows, 0.9) == 15.0  # the last two rows have 0.95
    assert laptop.seconds_to(rows[:-1], 0.9) is None
    assert laptop.seconds_to([{"episodes": 0, "success": None, "seconds": 1.0}], 0.9) is None


def test_a_command_that_lasts_too_long_is_asked_to_end(tmp_path, monkeypatch):
    (tmp_path / "waits.py").write_text("import time; time.sleep(60)")
    (tmp_path / "fails.py").write_text("raise SystemExit('no such robot')")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    with pytest.raises(ChildError, match="waits failed"):  # which ends it, for it does not listen
        laptop.run_command(["waits"], 0.5, "off")
    with pytest.raises(ChildError, match="no such robot"):
        laptop.run_command(["fails"], 30.0, "off")


def test_every_figure_has_a_process_and_its_machine(monkeypatch, tmp_path):
    asked = []

    def child(code, *words, **variables):
        asked.append(words)
        return {"env": words[0], "steps_per_s": 1}

    monkeypatch.setattr(cpu, "run_child", child)
    path = tmp_path / "cpu.jsonl"
    words = [
        "--env-name",
        "FeedingJaco-v0",
        "--num-envs",
        "8",
        "--machine",
        "mine",
        "--json",
        str(path),
    ]
    assert cpu.main(words) == 0
    lines = [json.loads(line) for line in path.read_text().splitlines()]
    assert [x["measured"] for x in lines] == ["speed", "speed", "training"]
    assert [words[1] for words in asked] == ["native", "jax", "native"]
    assert {x["machine"] for x in lines} == {"mine"}


def test_no_environments_are_refused(capsys):
    with pytest.raises(SystemExit):
        cpu.main(["--num-envs", "0"])
    assert "--num-envs" in capsys.readouterr().err
