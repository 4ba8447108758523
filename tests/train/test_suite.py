# ruff: noqa: D103 (a test's name says what it shows)
"""The suite starts the right commands, on the right GPU, keeps what is finished and tells what failed."""

from __future__ import annotations

import json
import sys

import pytest

from agym_jax.errors import UnknownNameError
from train.errors import ConfigError
from train.suite import Runner, SuiteConfig, describe, main, steps_of, suite_ids

# Stands for agym-jax: writes down how it was called, and makes a selection where one is asked for.
STUB = """
import json, os, pathlib, sys
words = sys.argv[1:]
folder = pathlib.Path(words[words.index("--save-dir") + 1]) if "--save-dir" in words else pathlib.Path(words[1]).parent
with (folder / "calls.jsonl").open("a") as file:
    file.write(json.dumps([words, os.environ.get("CUDA_VISIBLE_DEVICES")]) + "\\n")
if words[0] == "select":
    run = pathlib.Path(words[1])
    run.mkdir(exist_ok=True)
    line = dict(chosen_success=0.95, seeds=[1, 2], success_iqm=0.9, success_of_seeds=[0.95, 0.85])
    pathlib.Path(words[words.index("--json") + 1]).write_text(json.dumps(line))
elif "Dressing" in words[2]:
    print("no gown here")
    sys.exit(3)
"""


@pytest.fixture
def program(tmp_path):
    (tmp_path / "stub.py").write_text(STUB)
    return (sys.executable, str(tmp_path / "stub.py"))


def calls(folder):
    return [json.loads(line) for line in (folder / "calls.jsonl").read_text().splitlines()]


def test_commands_of_robots_alone_and_of_pairs(tmp_path, program):
    config = SuiteConfig(
        num_seeds=2, num_episodes=50, save_dir=str(tmp_path), gpus=2, steps=("Feeding=3e6",),
        flags="--impl jax",
    )  # fmt: skip
    ids = ["FeedingJaco-v0", "ReachingJacoHuman-v0"]
    outcomes = list(Runner(config, program).all(ids))
    assert [x.line["chosen_success"] for x in outcomes if x.line] == [0.95, 0.95]
    found = {tuple(words[:3]): (words, gpu) for words, gpu in calls(tmp_path)}
    words, gpu = found["train", "--env-name", "FeedingJaco-v0"]
    assert "--num-seeds 2" in " ".join(words) and "--num-env-steps 3e6 --impl jax" in " ".join(
        words
    )
    assert gpu in ("0", "1")
    assert "--num-env-steps" not in found["coop", "--env-name", "ReachingJacoHuman-v0"][0]
    assert "interquartile mean  90.0%, worst  85.0%" in describe(outcomes[0])
    before = len(calls(tmp_path))
    again = list(Runner(config, program).all(ids))  # what is finished is kept
    assert [x.line for x in again] == [x.line for x in outcomes]
    assert len(calls(tmp_path)) == before


def test_what_fails_is_told_and_the_others_go_on(tmp_path, program):
    config = SuiteConfig(num_seeds=2, save_dir=str(tmp_path))
    bad, good = Runner(config, program).all(["DressingJaco-v0", "ReachingJaco-v0"])
    assert bad.line is None and "no gown here" in describe(bad)
    assert good.line is not None


def test_names_and_steps():
    assert suite_ids(["ReachingJaco"]) == ["ReachingJaco-v0", "ReachingJacoHuman-v0"]
    assert suite_ids(["SawyerHuman", "DressingSawyer"])[-1] == "DressingSawyer-v0"
    assert len(suite_ids([])) == 56
    with pytest.raises(UnknownNameError, match="ReachingJacko"):
        suite_ids(["ReachingJacko"])
    steps = ["Dressing=6e6", "DressingPR2=8e6"]
    assert steps_of(steps, "DressingPR2-v0") == ["--num-env-steps", "8e6"]
    assert steps_of(steps, "DressingJaco-v0") == ["--num-env-steps", "6e6"]
    assert steps_of(steps, "ReachingJaco-v0") == []
    with pytest.raises(ConfigError, match="NAME=STEPS"):
        steps_of(["Dressing"], "DressingJaco-v0")


def test_a_wrong_name_is_refused_before_anything_starts(tmp_path, capsys):
    assert main(["--only", "Scratchitch", "--save-dir", str(tmp_path / "runs")]) == 2
    assert "ScratchItch" in capsys.readouterr().err and not (tmp_path / "runs").exists()
