# ruff: noqa: D103 (a test's name says what it shows)
"""Full disks and interrupts: what is on disk stays whole, and is brought up to date as soon as that is possible."""

from __future__ import annotations

import dataclasses
import errno
import io
import json
import os
import resource
import signal
import subprocess
import sys

import jax
import pytest
from fake_env import FakeEnv
from paths import PROCESS_SECONDS, ROOT, SUPPORT
from train_runs import listening

from agym_jax.data.npz import append_line
from agym_jax.errors import SaveFolderError
from agym_jax.interrupts import deferred
from agym_jax.policy import load_policy
from train.configs import PPOConfig
from train.ppo import main, train
from train.runs import manager
from train.runs.checkpoint import checkpoint_files, load_newest
from train.runs.folder import RunFolder
from train.runs.overview import read_rows
from train.runs.progress import Lines

SMALL = PPOConfig(
    env_name="FakeReach-v0", num_env_steps=640, num_envs=4, num_mini_batch=4,
    policy_hidden=(8,), value_hidden=(8,), log_interval=1, save_interval=2,
)  # fmt: skip


class Disk:
    """Writing whole files fails while it is full, after a part of them has been written."""

    def __init__(self, monkeypatch):
        self.full, self._fsync = False, os.fsync
        monkeypatch.setattr("agym_jax.data.npz.os.fsync", self.fsync)

    def fsync(self, handle):
        """Instead of ``os.fsync``."""
        if self.full:
            raise OSError(errno.ENOSPC, "No space left on device")
        self._fsync(handle)


def rows_of(folder):
    return [json.loads(line) for line in (folder / "curve.jsonl").read_text().splitlines()]


def parts(folder):
    return [x for x in folder.rglob(".*") if x.is_file()]


def test_training_goes_on_while_the_disk_is_full_and_saves_when_it_can(tmp_path, monkeypatch):
    disk, (progress, said), seen = Disk(monkeypatch), listening(), []
    add_row = RunFolder.add_row

    def add(folder, row):
        if disk.full:
            raise OSError(errno.ENOSPC, "No space left on device")
        add_row(folder, row)

    monkeypatch.setattr(RunFolder, "add_row", add)
    folder = tmp_path / "FakeReach-v0"

    def fill(row, policy):
        steps = row["env_steps"]
        seen.append(
            (
                steps,
                len(rows_of(folder)),
                [int(x.stem[5:]) for x in checkpoint_files(folder / "checkpoints")],
            )
        )
        disk.full = 160 <= steps < 480

    config = dataclasses.replace(SMALL, save_dir=str(tmp_path))
    result = train(FakeEnv(), config, progress, on_log=fill)
    assert result.env_steps == 640 and result.unsaved == "" and result.saved_steps == 640
    # what was there before the disk was full is still there while it is
    assert seen == [
        (80, 1, [0]), (160, 2, [0]), (240, 2, [0]), (320, 2, [0]), (400, 2, [0]), (480, 2, [0]),
        (560, 7, [480, 0]), (640, 8, [480, 0]),
    ]  # fmt: skip
    told = [text for text in said if "Cannot save" in text or "Saved again" in text]
    assert len(told) == 2 and "No space left on device" in told[0] and "of step 0" in told[0]
    assert told[1] == "Saved again, at step 480."
    assert rows_of(folder) == result.curve and parts(folder) == []
    policy = load_policy(folder / "policy.npz", FakeEnv())
    assert policy.info["env_steps"] == 640


def test_a_run_that_ends_on_a_full_disk_says_so_and_goes_on_later(
    tmp_path, monkeypatch, capsys, restored_settings
):
    disk, config = Disk(monkeypatch), dataclasses.replace(SMALL, save_dir=str(tmp_path))
    monkeypatch.setattr(manager, "PATIENCE", 0.0)

    def fill(row, policy):
        disk.full = row["env_steps"] == 320

    def stop(row, policy):
        fill(row, policy)
        return disk.full

    result = train(FakeEnv(), config, on_log=stop)
    assert result.interrupted and result.unsaved == "No space left on device"
    assert (
        result.saved_steps == 160
        and load_policy(tmp_path / "FakeReach-v0" / "policy.npz").info["env_steps"] == 160
    )
    words = "--env-name FakeReach-v0 --num-env-steps 640 --num-envs 4 --num-mini-batch 4 --log-interval 1"
    words += f" --policy-hidden 8 --value-hidden 8 --save-dir {tmp_path}"
    with pytest.raises(
        SaveFolderError, match=r"No space left on device.*Nothing has been computed"
    ):
        train(FakeEnv(), config)
    disk.full = False

    def slow_save(self, learner, seconds):
        disk.full = True
        return save(self, learner, seconds)

    save = manager.CheckpointManager.save
    monkeypatch.setattr(manager.CheckpointManager, "save", slow_save)
    assert main(words.split(), make=lambda name, impl: FakeEnv()) == 2
    said = capsys.readouterr()
    assert (
        "SaveFolderError: The end of this run is not on disk" in said.err
        and "from step 160" in said.err
    )
    monkeypatch.setattr(manager.CheckpointManager, "save", save)
    disk.full = False
    assert main(words.split(), make=lambda name, impl: FakeEnv()) == 0
    assert [row["env_steps"] for row in rows_of(tmp_path / "FakeReach-v0")] == [
        80 * i for i in range(1, 9)
    ]


def test_a_row_that_does_not_fit_is_not_left_in_half(tmp_path):
    folder = RunFolder(str(tmp_path), "run")
    folder.path.mkdir()
    folder.write_curve([{"step": 1}])
    before, limits = folder.curve.read_bytes(), resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (len(before) + 40, limits[1]))
    try:
        with pytest.raises(OSError, match="too large"):
            folder.add_row({"step": 2, "long": "x" * 100})
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert folder.curve.read_bytes() == before
    folder.add_row({"step": 2})
    assert rows_of(folder.path) == [{"step": 1}, {"step": 2}]


def test_what_a_killed_process_left_half_written_hides_nothing(tmp_path):
    file = tmp_path / "selection.jsonl"
    append_line(file, '{"a": 1}')
    with file.open("a") as half:
        half.write('{"a": 2, "succ')
    append_line(file, '{"a": 3}')
    append_line(file, '{"a": 4}')
    assert read_rows(file) == [{"a": 1}, {"a": 3}, {"a": 4}]


def test_progress_on_a_full_disk_ends_nothing_and_is_told(monkeypatch):
    class Full(io.StringIO):
        def write(self, text):
            raise OSError(errno.ENOSPC, "No space left on device")

    lines = Lines()
    for text, stream in (("1,000 steps", Full()), ("2,000 steps", io.StringIO())):
        monkeypatch.setattr("sys.stdout", stream)
        lines.say(text)
    lines.say("3,000 steps")
    told = stream.getvalue().splitlines()
    assert told[0].startswith("Lines may be missing before this one: ")
    assert "No space left on device" in told[0] and told[1:] == ["2,000 steps", "3,000 steps"]


def test_two_interrupts_at_once_save_as_one_does(tmp_path, monkeypatch):
    """A terminal's Ctrl-C and the suite's SIGTERM reach a training together: the second one, as it begins to save."""
    save, second = manager.CheckpointManager.save, [KeyboardInterrupt()]

    def interrupt(*_):
        raise KeyboardInterrupt

    def interrupted(*words):
        if second:
            raise second.pop()
        return save(*words)

    monkeypatch.setattr(manager.CheckpointManager, "save", interrupted)
    result = train(FakeEnv(), dataclasses.replace(SMALL, save_dir=str(tmp_path)), on_log=interrupt)
    assert result.interrupted and result.env_steps == result.saved_steps == 80


def test_an_interrupt_waits_for_the_end_of_what_must_be_whole():
    done = []
    with pytest.raises(KeyboardInterrupt):
        with deferred():
            os.kill(os.getpid(), signal.SIGINT)
            done.append("all of it")
        done.append("more")
    assert done == ["all of it"]
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


@pytest.mark.parametrize("moment", ["add_row", "save_policies"])
def test_an_interrupt_at_a_bad_moment_loses_nothing(tmp_path, monkeypatch, moment):
    config = dataclasses.replace(SMALL, save_dir=str(tmp_path), save_interval=1, num_env_steps=320)
    write, calls = getattr(RunFolder, moment), []

    def interrupted(folder, what):
        calls.append(what)
        if len(calls) == 2:
            os.kill(os.getpid(), signal.SIGINT)
        write(folder, what)

    monkeypatch.setattr(RunFolder, moment, interrupted)
    result = train(FakeEnv(), config)
    assert result.interrupted and result.env_steps == 160 == result.saved_steps
    monkeypatch.undo()
    template = jax.eval_shape(lambda: result.learner)
    found = load_newest(result.folder / "checkpoints", template, {})
    assert int(found.learner.env_steps) == 160 == found.meta["curve"][-1]["env_steps"]
    again = train(FakeEnv(), config)
    assert [row["env_steps"] for row in again.curve] == [80, 160, 240, 320]
    assert again.curve[:2] == result.curve


SIGNAL_AT_IMPORT = """
import os, signal, sys
class Finder:
    def find_spec(self, name, path=None, target=None):
        if name == os.environ["INTERRUPT_AT"]:
            os.kill(os.getpid(), signal.SIGINT)
sys.meta_path.insert(0, Finder())
signal.signal(signal.SIGINT, signal.default_int_handler)  # it is ignored in what runs in the background
"""


@pytest.mark.parametrize(
    "command", ["agym_jax train", "train.ppo", "train.coop", "train.suite", "agym_jax evaluate"]
)
@pytest.mark.parametrize("module", ["gymnasium", "jax"])
def test_an_interrupt_while_modules_are_imported_is_quiet(tmp_path, command, module):
    (tmp_path / "sitecustomize.py").write_text(SIGNAL_AT_IMPORT)
    paths = os.pathsep.join([str(tmp_path), str(ROOT)])
    found = subprocess.run(
        [sys.executable, "-m", *command.split(), "--env-name", "ReachingJaco-v0"], capture_output=True, text=True,
        env={**os.environ, "PYTHONPATH": paths, "INTERRUPT_AT": module}, cwd=tmp_path, timeout=PROCESS_SECONDS,
    )  # fmt: skip
    assert (found.returncode, found.stdout, found.stderr) == (130, "", "")


REFUSED = """
import resource
from pathlib import Path
from fake_env import FakeEnv
from train.ppo import train
from train.configs import PPOConfig
from train.runs.progress import Lines
limits = resource.getrlimit(resource.RLIMIT_FSIZE)
def refuse(row, policy):
    if row["env_steps"] == 400:
        resource.setrlimit(resource.RLIMIT_FSIZE, (64, limits[1]))
    if row["env_steps"] == 1200:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
result = train(FakeEnv(), PPOConfig(**{fields!r}), Lines(0.0), on_log=refuse)
run = Path({folder!r}) / "FakeReach-v0"
print("rows", len((run / "curve.jsonl").read_text().splitlines()), "steps", result.saved_steps, "unsaved", repr(result.unsaved))
print("left", sorted(x.name for x in run.rglob(".*")))
"""


@pytest.mark.slow
def test_training_goes_on_while_the_system_refuses_to_write(tmp_path):
    """By a limit of 64 bytes on files, beyond which every write ends as on a full disk, after a part."""
    fields = dataclasses.asdict(SMALL) | {"save_dir": str(tmp_path), "num_env_steps": 1600}
    found = subprocess.run(
        [sys.executable, "-c", REFUSED.format(folder=str(tmp_path), fields=fields)], capture_output=True, text=True,
        env={**os.environ, "PYTHONPATH": f"{ROOT}{os.pathsep}{SUPPORT}", "JAX_PLATFORMS": "cpu", "AGYM_JAX_CACHE": "off"},
        timeout=PROCESS_SECONDS,
    )  # fmt: skip
    said = found.stdout
    assert found.returncode == 0, said + found.stderr
    assert said.count("Cannot save in") == 1 and "File too large" in said
    assert said.count("Saved again, at step") == 1
    assert "rows 20 steps 1600 unsaved ''" in said and "left []" in said
