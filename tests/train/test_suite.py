# ruff: noqa: D103 (a test's name says what it shows)
"""The suite starts the right commands, on the right GPU, keeps what is finished and tells what failed."""

from __future__ import annotations

import dataclasses
import json
import os
import signal
import sys
import time

import pytest
from paths import PROCESS_SECONDS, ROOT, SUPPORT
from train_runs import start_python

from agym_jax import list_envs
from agym_jax.errors import AgymError, UnknownNameError
from agym_jax.policy.files import load_policy
from agym_jax.policy.policy import save_policy
from train.errors import ConfigError
from train.runs.checkpoint import checkpoint_files
from train.runs.overview import read_rows, wall_seconds
from train.suite import describe, main
from train.suites import children
from train.suites import runner as runners
from train.suites.plan import SuiteConfig, check_entries, flags_for, named, steps_for
from train.suites.runner import Runner
from train.suites.whole import Whole

# Stands for agym-jax: writes down how it was called, and makes a selection where one is asked for.
STUB = """
import json, os, pathlib, sys
words = sys.argv[1:]
folder = pathlib.Path(words[1]).parent
for flag in ("--save-dir", "--load-dir"):
    folder = pathlib.Path(words[words.index(flag) + 1]) if flag in words else folder
with (folder / "calls.jsonl").open("a") as file:
    file.write(json.dumps([words, os.environ.get("CUDA_VISIBLE_DEVICES")]) + "\\n")
if words[0] == "select":
    run = pathlib.Path(words[1])
    run.mkdir(exist_ok=True)
    line = dict(env=run.name, chosen=1, chosen_success=0.95, seeds=[1, 2], success_iqm=0.9,
                success_iqm_low=0.8, success_iqm_high=1.0, success_of_seeds=[0.95, 0.85])
    (run / "selection.jsonl").write_text(json.dumps(line))
elif words[0] == "enjoy":
    pathlib.Path(words[words.index("--clip") + 1]).write_text("a film")
elif "Dressing" in words[2]:
    print("no gown here")
    sys.exit(3)
else:
    run = folder / words[2]
    run.mkdir(exist_ok=True)
    row = dict(success=0.91, success_low=0.9, success_high=0.92, success_min=0.8, success_max=1.0)
    row |= dict(env_steps=1000, seconds=7.5, num_seeds=2, nan_total=0)
    (run / "curve.jsonl").write_text(json.dumps(row))
"""


@pytest.fixture
def program(tmp_path):
    (tmp_path / "stub.py").write_text(STUB)
    return (sys.executable, str(tmp_path / "stub.py"))


def calls(folder):
    return [json.loads(line) for line in (folder / "calls.jsonl").read_text().splitlines()]


def test_commands_of_robots_alone_and_of_pairs(tmp_path, program):
    config = SuiteConfig(
        num_seeds=2, num_episodes=50, save_dir=str(tmp_path), steps=("Feeding=3e6",),
        flags="--impl jax",
    )  # fmt: skip
    ids = ["FeedingJaco-v0", "ReachingJacoHuman-v0"]
    runner = Runner(config, program, ["0", "1"])
    outcomes = sorted(runner.all(ids), key=lambda x: x.env_name)
    assert runner.finish() == {} and (tmp_path / ids[0] / "clip.gif").read_text() == "a film"
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
    again = sorted(Runner(config, program).all(ids), key=lambda x: x.env_name)
    assert [x.line for x in again] == [x.line for x in outcomes]  # what is finished is kept
    assert describe(again[0]).endswith("finished before")
    assert len(calls(tmp_path)) == before
    (changed,) = Runner(dataclasses.replace(config, flags="--lr 1"), program).all(ids[:1])
    assert "finished before, with other arguments" in describe(changed)
    assert f"{ids[0]}.log" in describe(changed) and len(calls(tmp_path)) == before


def test_a_film_has_the_settings_of_the_training(tmp_path, program):
    changes = {"task.settled_gown": 0.5, "memory": [0.3, 4.0]}
    (tmp_path / "FeedingJaco-v0").mkdir()
    policy = load_policy("FeedingJaco-v0")
    info = {**policy.info, "changes": changes, "meant_for": changes}
    save_policy(tmp_path / "FeedingJaco-v0" / "policy.npz", dataclasses.replace(policy, info=info))
    runner = Runner(SuiteConfig(num_seeds=1, save_dir=str(tmp_path)), program, [])
    assert runner._film("FeedingJaco-v0") == ""
    ((words, _),) = calls(tmp_path)
    assert words[words.index("--task.settled-gown") + 1] == "0.5" and "--memory" not in words


def test_what_fails_is_told_and_the_others_go_on(tmp_path, program):
    config = SuiteConfig(num_seeds=2, save_dir=str(tmp_path))
    bad, good = Runner(config, program).all(["DressingJaco-v0", "ReachingJaco-v0"])
    assert bad.line is None and "no gown here" in describe(bad)
    assert good.line is not None


def test_names_and_steps():
    everything = list_envs()
    assert named(["ReachingJaco"], everything) == ["ReachingJaco-v0", "ReachingJacoHuman-v0"]
    assert named(["SawyerHuman", "DressingSawyer"], everything)[-1] == "DressingSawyer-v0"
    assert len(named([], everything)) == 56
    with pytest.raises(UnknownNameError, match="ReachingJacko"):
        named(["ReachingJacko"], everything)
    config = SuiteConfig(steps=("DressingPR2=8e6", "Dressing=6e6"))
    assert steps_for(config, "DressingPR2-v0") == "8e6"  # the longest name, wherever it stands
    assert steps_for(config, "DressingJaco-v0") == "6e6"
    assert steps_for(config, "ReachingJaco-v0") is None
    with pytest.raises(ConfigError, match="--steps takes NAME=STEPS"):
        check_entries(SuiteConfig(steps=("Dressing",)), everything)
    with pytest.raises(ConfigError, match="--steps Dressing=6M: '6M' is not a number, such as"):
        check_entries(SuiteConfig(steps=("Dressing=6M",)), everything)
    with pytest.raises(AgymError, match="--steps Dressing must be"):
        check_entries(SuiteConfig(steps=("Dressing=0",)), everything)
    with pytest.raises(UnknownNameError, match="Dresing"):
        check_entries(SuiteConfig(steps=("Dresing=6e6",)), everything)
    with pytest.raises(ConfigError, match="--num-seeds 1 leaves none"):
        SuiteConfig(num_seeds=1, default_settings=True)


def test_flags_of_some_environments(tmp_path, program):
    flags_of = ("Reaching=--lr 1e-4", "ReachingPR2=--lr 2e-4 --humans.sizes both")
    config = SuiteConfig(
        num_seeds=2, save_dir=str(tmp_path), flags="--impl jax", flags_of=flags_of, clips=False,
        default_settings=True,
    )  # fmt: skip
    assert flags_for(config, "FeedingPR2-v0") == ["--impl", "jax"]
    path = dataclasses.replace(config, flags=r"--robot-policy 'C:\my runs\p.npz' --lr=1e-4")
    assert flags_for(path, "FeedingPR2-v0") == ["--robot-policy", r"C:\my runs\p.npz", "--lr=1e-4"]
    more = ["--impl", "jax", "--lr", "2e-4", "--humans.sizes", "both"]
    assert flags_for(config, "ReachingPR2-v0") == more
    (outcome,) = Runner(config, program).all(["ReachingJaco-v0"])
    train, select = (words for words, _ in calls(tmp_path))
    assert outcome.line and train[-4:] == ["--impl", "jax", "--lr", "1e-4"]
    assert "--default-settings" in select and "--default-settings" not in train
    check_entries(config, list_envs())
    typo = dataclasses.replace(config, flags_of=("Reachng=--lr 1",), save_dir=str(tmp_path / "no"))
    with pytest.raises(UnknownNameError, match="Reaching"):
        check_entries(typo, list_envs())
    for wrong, why in (
        ("Reaching", "NAME=FLAGS"),
        ("Reaching=--lr '1", "--flags-of cannot be read"),
        ("=--lr 1", "NAME=FLAGS"),
    ):
        with pytest.raises(ConfigError, match=why):
            check_entries(dataclasses.replace(config, flags_of=(wrong,)), list_envs())


def test_how_seeds_are_chosen(tmp_path, program):
    config = SuiteConfig(
        num_seeds=2, save_dir=str(tmp_path), clips=False, by="both", at_least=("held=0.9",)
    )
    check_entries(config, list_envs())
    assert [x.problem for x in Runner(config, program).all(["ReachingJaco-v0"])] == [""]
    select = calls(tmp_path)[-1][0]
    assert select[select.index("--by") + 1] == "both" and "--at-least" not in select
    commands = Runner(config, program)._commands("DressingJaco-v0")
    assert commands[-1][-2:] == ["--at-least", "held=0.9"]
    with pytest.raises(UnknownNameError, match=r"'hold'.*held"):
        check_entries(dataclasses.replace(config, at_least=("hold=0.9",)), list_envs())
    with pytest.raises(ConfigError, match=r"NAME=VALUE.*'held=much'"):
        check_entries(dataclasses.replace(config, at_least=("held=much",)), list_envs())
    with pytest.raises(ConfigError, match="--by is about the choice among seeds"):
        SuiteConfig(num_seeds=1, by="both")


def test_flags_of_several_environments_on_the_command_line(tmp_path, program):
    words = [
        "--only",
        "ReachingJaco-v0",
        "--num-seeds",
        "2",
        "--no-clips",
        "--save-dir",
        str(tmp_path),
    ]
    words += ["--flags-of", "Reaching=--lr 1e-4 --seed=7", "Feeding=--lr 2", "--flags=--impl jax"]
    assert main(words, program=program) == 0
    (train, _), _ = calls(tmp_path)
    assert train[-5:] == ["--impl", "jax", "--lr", "1e-4", "--seed=7"]


def test_a_wrong_name_is_refused_before_anything_starts(tmp_path, capsys):
    assert main(["--only", "Scratchitch", "--save-dir", str(tmp_path / "runs")]) == 2
    assert "ScratchItch" in capsys.readouterr().err and not (tmp_path / "runs").exists()


PATHS = {"PYTHONPATH": f"{ROOT}{os.pathsep}{SUPPORT}"}
IDS = ["ReachingJaco-v0", "FeedingJaco-v0"]
SUITE = """
from train.suite import main
from train.suites.children import own_program
raise SystemExit(main({words!r}, program=own_program("suite_stub")))
"""


def until(condition, what):
    deadline = time.monotonic() + PROCESS_SECONDS
    while not condition():
        assert time.monotonic() < deadline, what
        time.sleep(0.02)


def ended(folder):
    """What the journal says of the trainings of the first environment that have ended."""
    return [
        row for row in read_rows(folder / "journal.jsonl")
        if row["env"] == IDS[0] and row["command"] == "train" and "seconds" in row
    ]  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("sent", [signal.SIGKILL, signal.SIGTERM], ids=["SIGKILL", "SIGTERM"])
def test_a_suite_that_is_killed_goes_on_where_it_was(sent, tmp_path):
    flags = "--num-envs 16 --num-env-steps 19200 --log-interval 1 --save-interval 4 --policy-hidden 16 --value-hidden 16"
    words = [
        "--only",
        *IDS,
        "--num-seeds",
        "2",
        "--num-episodes",
        "32",
        "--save-dir",
        str(tmp_path),
    ]
    code = SUITE.format(words=[*words, f"--flags={flags} --impl jax --num-mini-batch 4"])
    log, checkpoints = tmp_path / f"{IDS[0]}.log", tmp_path / IDS[0] / "checkpoints"
    with start_python(code, env=PATHS, stdout=-1, stderr=-1) as process:
        try:
            until(
                lambda: len(checkpoint_files(checkpoints)) > 1 or process.poll(), "no checkpoints"
            )
            process.send_signal(sent)
            out, err = process.communicate(timeout=PROCESS_SECONDS)
        finally:
            process.kill()
    assert process.returncode == (-9 if sent == signal.SIGKILL else 130), out + err
    # the training did not stay behind: it was told, saved its state, and ended
    until(lambda: "Rerun the same command to continue." in log.read_text(), log.read_text())
    assert not (tmp_path / IDS[1]).exists()
    if sent == signal.SIGTERM:
        assert "Rerun the same command to continue." in out
        assert [row["status"] for row in ended(tmp_path)] == [130]
        return
    with start_python(code, env=PATHS, stdout=-1, stderr=-1) as process:
        out, err = process.communicate(timeout=PROCESS_SECONDS)
    assert process.returncode == 0, out + err + log.read_text()
    assert "2 of 2 environments in" in out
    assert "Continuing from step" in log.read_text()
    for name in IDS:
        steps = [row["env_steps"] for row in read_rows(tmp_path / name / "curve.jsonl")]
        assert steps == [320 * i for i in range(1, 61)]  # nothing twice, nothing missing
        line = read_rows(tmp_path / name / "selection.jsonl")[-1]
        assert line["env"] == name and line["seeds"] == [1, 2] and line["episodes"] == 32
        assert line["reported"]["success"] == line["chosen_success"]
        assert (tmp_path / name / "clip.gif").is_file() and (
            tmp_path / name / "policy.npz"
        ).is_file()
        assert name in (tmp_path / "results.md").read_text()
        assert wall_seconds(tmp_path, name) > 0
    assert [row["status"] for row in ended(tmp_path)] == [None, 0]
    assert (tmp_path / "curves.png").stat().st_size > 10_000
    before = log.read_text()
    with start_python(code, env=PATHS, stdout=-1, stderr=-1) as process:
        out, _ = process.communicate(timeout=PROCESS_SECONDS)
    assert out.count("finished before") == 2 and log.read_text() == before


def test_the_share_of_the_whole(tmp_path):
    config = SuiteConfig(save_dir=str(tmp_path), steps=("Reaching=1000", "Feeding=3000"))
    whole = Whole(config, IDS)
    assert whole.share() == 0.0 and "0 of 2 finished" in whole.words()
    run = tmp_path / IDS[1]
    candidates = run / "candidates"
    candidates.mkdir(parents=True)
    for folder in (candidates, run):
        (folder / "config.json").write_text(json.dumps({"config": {"num_env_steps": 3000}}))
    (candidates / "curve.jsonl").write_text(json.dumps({"env_steps": 1000}) + "\n")
    assert whole.share() == pytest.approx(0.225)
    (run / "curve.jsonl").write_text(json.dumps({"env_steps": 2000}) + "\n" + '{"env_st')
    assert whole.share() == pytest.approx(0.45)
    assert "(FeedingJaco-v0 60%)" in whole.words() and "left" in whole.words()
    (run / "selection.jsonl").write_text(json.dumps({"env": IDS[1]}))
    assert whole.share() == pytest.approx(0.75) and "1 of 2 finished" in whole.words()


def test_one_seed_is_finished_when_it_is_trained(tmp_path):
    config = SuiteConfig(save_dir=str(tmp_path), steps=("Reaching=1000",), num_seeds=1)
    run = tmp_path / "ReachingJaco-v0"
    run.mkdir()
    (run / "config.json").write_text(json.dumps({"config": {"num_env_steps": 1000}}))
    (run / "curve.jsonl").write_text(json.dumps({"env_steps": 1000}) + "\n")
    assert "1 of 1 finished" in Whole(config, [run.name]).words()


def test_a_full_disk_ends_one_environment_and_not_the_others(tmp_path, monkeypatch):
    def one(self, env_name, gpu, start):
        if env_name == "A-v0":
            raise OSError(28, "No space left on device")
        return runners.Outcome(env_name, None, 0.0)

    monkeypatch.setattr(Runner, "_one", one)
    runner = Runner(SuiteConfig(save_dir=str(tmp_path)), ())
    problems = {x.env_name: x.problem for x in runner.all(["A-v0", "B-v0"])}
    assert "No space left on device" in problems["A-v0"] and not problems["B-v0"]


def test_gpus(monkeypatch):
    monkeypatch.setenv("CUDA_VISIBLE_DEVICES", "4,6,7")
    assert children.visible_gpus() == ["4", "6", "7"] and children.visible_gpus(2) == ["4", "6"]
    with pytest.raises(ConfigError, match="--gpus 4 requested, but there are only 3"):
        children.visible_gpus(4)
    monkeypatch.delenv("CUDA_VISIBLE_DEVICES")
    monkeypatch.setattr(children, "_all_gpus", lambda: ["0", "1"])
    assert children.visible_gpus() == ["0", "1"]
    runner = Runner(SuiteConfig(parallel=2), (), ["0", "1"])
    assert sorted(runner.slots.get() for _ in range(runner.slots.qsize())) == ["0", "0", "1", "1"]


def test_two_suites_do_not_work_on_one_environment(tmp_path, program, monkeypatch):
    config = SuiteConfig(num_seeds=2, save_dir=str(tmp_path), clips=False)
    monkeypatch.setattr(runners, "PATIENCE", 0.0)
    with (tmp_path / f"{IDS[0]}.log").open("a") as file:
        assert children.claim(file)
        busy, free = Runner(config, program).all(IDS)
        assert busy.line is None and "Another process is working on it" in busy.problem
        assert free.line is not None
    (again,) = Runner(config, program).all(IDS[:1])
    assert again.line is not None


def test_nothing_is_started_once_the_suite_stops(tmp_path, program):
    config = dataclasses.replace(SuiteConfig(num_seeds=2), save_dir=str(tmp_path))
    runner = Runner(config, program)
    runner.children.stop()
    (outcome,) = runner.all(["ReachingJaco-v0"])
    assert outcome.line is None and not (tmp_path / "calls.jsonl").exists()
    assert runner.finish() == {}
