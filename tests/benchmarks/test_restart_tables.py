# ruff: noqa: D103 (a test's name says what it shows)
"""The table of trainings with restarts stands them beside those that differ in nothing else."""

import json

from benchmarks import restart_tables
from train.runs.overview import seeds_and_steps


def line(success, steps, **more):
    """A choice between two seeds."""
    return {
        "kind": "seed-selection", "env": "DressingPR2-v0", "seeds": [1, 2], "success_of_seeds": success,
        "success_iqm": sum(success) / 2, "num_env_steps": steps, "episodes": 1000, "overflow": 0, "started_from": None,
        "candidates": None, "restart_share": 0.0, "time": f"2026-12-01T00:00:{steps // 1_000_000:02}+00:00",
        "commit": "0" * 40, "device": {"kind": "NVIDIA H200", "platform": "gpu"}, "chosen": 1, **more,
    }  # fmt: skip


def test_a_training_with_restarts_stands_beside_those_without(tmp_path):
    memory = {"changes": {"memory": [0.3, 4.0]}}
    candidates = {"count": 4, "until": 0.4, "rule": "success"}
    both = {"restart_share": 0.5, "candidates": candidates}
    rows = {
        "memory": [line([0.1, 0.3], 2_000_000, **memory), line([0.6, 0.8], 3_000_000, **memory, **both),
                   line([0.9, 0.9], 4_000_000, **memory, restart_share=0.5, started_from="shipped")],
        "restarts": [line([0.2, 0.4], 5_000_000, restart_share=0.25, trained_with={"humans.sizes": "both", "robot.strength": [0.5, 1.0]})],
        "selection": [line([0.0, 0.5], 6_000_000, training_time="06"), line([0.5, 0.7], 7_000_000, training_time="07")],
        "seed_training": [{"env": "DressingPR2-v0", "candidates": candidates, "restart_share": 0.0, "time": "06"},
                          {"env": "DressingPR2-v0", **both, "time": "07"}],
    }  # fmt: skip
    for name, each in rows.items():
        (tmp_path / f"{name}.jsonl").write_text("".join(json.dumps(x) + "\n" for x in each))
    found = [x for x in restart_tables.trainings(tmp_path).splitlines() if "DressingPR2" in x]
    cells = [[cell.strip() for cell in x.strip("|").split("|")] for x in found]
    assert [x[1:3] for x in cells] == [
        ["0.3, 4", "2 x 3 M, restarts 0.5, of 4 candidates after 40% by success"],
        ["", "2 x 5 M, restarts 0.25, people of both kinds of size, `--robot.strength 0.5 1.0`"],
        ["", "2 x 7 M, restarts 0.5, of 4 candidates after 40% by success"],
    ]
    assert [x[4] for x in cells] == ["60.0%, 70.0%", "20.0%, 30.0%", "50.0%, 60.0%"]
    alone = "2 x 6 M, of 4 candidates after 40% by success: 0.0%, 25.0%"
    assert [x[5] for x in cells] == ["2 x 2 M: 10.0%, 20.0%", alone, alone]


def test_how_seeds_were_trained_is_told_in_few_words():
    assert seeds_and_steps(8, 4_014_080) == "8 x 4.01 M"
    assert seeds_and_steps(8, 4_000_000, restart_share=0.5) == "8 x 4 M, restarts 0.5"


def test_the_restarts_with_which_an_environment_is_trained_by_default():
    assert restart_tables.usual_restarts("DressingJaco-v0") == 0.5
    assert restart_tables.usual_restarts("DressingJacoHuman-v0") == 0.0
    assert restart_tables.usual_restarts("FeedingJaco-v0") == 0.0


def test_at_a_glance_stands_what_is_trained_by_default(tmp_path):
    restarts = [
        line([0.6, 0.8], 3_000_000, restart_share=0.5),
        line([0.7, 0.9], 4_000_000, restart_share=0.5, env="FeedingPR2-v0"),
    ]
    selection = [
        line([0.1, 0.3], 6_000_000),
        line([0.5, 0.7], 2_000_000, env="FeedingPR2-v0"),
        line([0.0, 0.0], 7_000_000, env="FeedingPR2Human-v0"),
    ]
    for name, each in {"restarts": restarts, "selection": selection}.items():
        (tmp_path / f"{name}.jsonl").write_text("".join(json.dumps(x) + "\n" for x in each))
    rows = [x.strip("| ") for x in restart_tables.at_a_glance(tmp_path).splitlines()]
    assert rows[2:4] == ["Feeding | 50.0%, 60.0%", "Dressing | 60.0%, 70.0%"]
