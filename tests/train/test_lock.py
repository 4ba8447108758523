# ruff: noqa: D103 (a test's name says what it shows)
"""One run per folder at a time, and none over results that nothing can continue."""

from __future__ import annotations

import dataclasses
import errno
import importlib
import os
import re
import signal
import socket
import subprocess

import pytest
from fake_env import FakeEnv
from train_runs import start_python

from agym_jax.errors import SaveFolderError
from train.configs import PPOConfig
from train.errors import CheckpointWarning, RunInUseError
from train.ppo import main, train
from train.runs import lock
from train.runs.checkpoint import checkpoint_files
from train.runs.folder import RunFolder
from train.runs.lock import RunLock

SMALL = PPOConfig(
    env_name="FakeReach-v0", num_env_steps=240, num_envs=4, num_mini_batch=4,
    policy_hidden=(8,), value_hidden=(8,), log_interval=1,
)  # fmt: skip
HOLDER = """
import sys, time
from pathlib import Path
from train.runs.lock import RunLock
with RunLock(Path(sys.argv[1])):
    print("locked", flush=True)
    time.sleep(600)
"""


def test_a_second_process_is_told_who_has_the_folder_and_a_kill_frees_it(tmp_path):
    folder = tmp_path / "FakeReach-v0"
    code = HOLDER.replace("sys.argv[1]", repr(str(folder)))
    with start_python(code, stdout=subprocess.PIPE) as other:
        try:
            assert other.stdout.readline() == "locked\n"
            with pytest.raises(RunInUseError) as told, RunLock(folder):
                raise AssertionError
            wanted = rf"{re.escape(str(folder))}.*process {other.pid} on {re.escape(socket.gethostname())}, started 20"
            assert re.search(wanted, str(told.value))
            assert f"kill {other.pid};" in str(told.value) and "--save-dir" in str(told.value)
        finally:
            other.send_signal(signal.SIGKILL)
    with RunLock(folder):  # nothing to remove by hand
        pass


def test_training_holds_the_folder_while_it_runs_and_only_then(tmp_path, capsys):
    config = dataclasses.replace(SMALL, save_dir=str(tmp_path))
    refused = []

    def start_another(row, policy):
        for fresh in (False, True):
            with pytest.raises(RunInUseError, match=rf"process {os.getpid()} on"):
                train(other := FakeEnv(), dataclasses.replace(config, fresh=fresh))
            refused.append(other.traces["reset"])
        words = ["--env-name", "FakeReach-v0", "--save-dir", str(tmp_path)]
        assert (
            main(
                words, make=lambda name, impl: pytest.fail("built before the folder was looked at")
            )
            == 2
        )
        raise RuntimeError("out of memory")

    with pytest.raises(RuntimeError, match="out of memory"):
        train(FakeEnv(), config, on_log=start_another)
    assert refused == [0, 0] and "RunInUseError: Another run" in capsys.readouterr().err
    # it broke before its first checkpoint: nothing had been learned, so it may begin anew, even with other settings
    folder = RunFolder(str(tmp_path), "FakeReach-v0")
    assert [x.name for x in checkpoint_files(folder.checkpoints)] == ["step_000000000000.npz"]
    again = train(FakeEnv(), dataclasses.replace(config, policy_hidden=(16,)))
    assert [row["env_steps"] for row in again.curve] == [80, 160, 240]


@pytest.mark.parametrize("name", ["policy.npz", "curve.jsonl", "seed_2/human_policy.npz"])
def test_results_without_a_checkpoint_are_not_written_over(tmp_path, name, capsys):
    path = tmp_path / "FakeReach-v0" / name
    path.parent.mkdir(parents=True)
    path.write_text("dear to somebody")
    env, config = FakeEnv(), dataclasses.replace(SMALL, save_dir=str(tmp_path))
    with pytest.raises(
        SaveFolderError, match=rf"has {name}, but no checkpoint.*--fresh.*--save-dir"
    ):
        train(env, config)
    words = ["--env-name", "FakeReach-v0", "--save-dir", str(tmp_path)]
    assert main(words, make=lambda name, impl: pytest.fail("built before")) == 2
    assert "--fresh" in capsys.readouterr().err and env.traces["reset"] == 0
    assert path.read_text() == "dear to somebody"
    with RunLock(tmp_path / "FakeReach-v0"):
        aside = RunFolder(str(tmp_path), "FakeReach-v0").prepare(fresh=True)
    assert (aside / name).read_text() == "dear to somebody"


def test_where_there_are_no_locks_a_run_says_so_and_goes_on(tmp_path, monkeypatch):
    def refuse(file):
        raise OSError(errno.ENOLCK, "No locks available")

    monkeypatch.setattr(lock, "try_lock", refuse)
    with pytest.warns(CheckpointWarning, match="has no locks"), RunLock(tmp_path / "run"):
        pass


def test_what_a_killed_write_leaves_is_removed_by_the_next_run(tmp_path):
    folder = RunFolder(str(tmp_path), "FakeReach-v0")
    (folder.path / "seed_1").mkdir(parents=True)
    for part in (".policy.npz.x1.part", "seed_1/.curve.jsonl.x2.part", ".probe.x3.part"):
        (folder.path / part).write_bytes(b"half")
    folder.prepare(fresh=False)
    assert [x for x in folder.path.rglob("*") if x.is_file()] == []


@pytest.mark.parametrize("trainer", ["ppo", "coop"])
def test_a_name_that_does_not_exist_leaves_nothing_in_the_folder(tmp_path, trainer, capsys):
    main = importlib.import_module(f"train.{trainer}").main
    words = ["--env-name", "ReachingJacco-v0", "--save-dir", str(tmp_path / "runs")]
    assert main(words) == 2
    assert "Did you mean 'ReachingJaco-v0'" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())
