# ruff: noqa: D103 (a test's name says what it shows)
"""Loggers: what TensorBoard reads is the curve, also of a run that was killed and went on."""

from __future__ import annotations

import dataclasses
import errno
import importlib.util
import json
import struct
import time

import numpy as np
import pytest
from fake_env import FakeEnv
from train_runs import listening

from agym_jax.errors import MissingExtraError, UnknownNameError
from train.configs import PPOConfig, parse_arguments
from train.errors import ConfigError
from train.ppo import main, train
from train.runs import logging
from train.runs.logging.service import Place
from train.runs.logging.tensorboard import TensorBoard

SMALL = PPOConfig(
    env_name="FakeReach-v0", num_env_steps=480, num_envs=4, num_mini_batch=4, policy_hidden=(8,), value_hidden=(8,),
    log_interval=1, save_interval=2, logger=("tensorboard",),
)  # fmt: skip


def shown(folder):
    """What TensorBoard has read of a folder: tag -> steps and values."""
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

    read = EventAccumulator(str(folder))
    read.Reload()
    tags = read.Tags()["scalars"]
    return {tag: [(x.step, x.value) for x in read.Scalars(tag)] for tag in tags}, read


def check_shown(folder, curve):
    """Every number of the curve is there once, and nothing else."""
    found, _ = shown(folder)
    for name in {name for row in curve for name in row} - {"env_steps"}:
        wanted = [(row["env_steps"], row[name]) for row in curve if row.get(name) is not None]
        have = found.pop(name if "/" in name else f"train/{name}", [])
        assert [step for step, _ in have] == [step for step, _ in wanted], name
        np.testing.assert_allclose([x for _, x in have], [x for _, x in wanted], rtol=1e-6)
    assert not found


@pytest.mark.parametrize(
    "num_seeds", [1, pytest.param(2, marks=pytest.mark.slow)], ids=["one seed", "two seeds"]
)
def test_tensorboard_shows_the_curves_of_a_run_that_broke_and_went_on(tmp_path, num_seeds):
    config = dataclasses.replace(SMALL, save_dir=str(tmp_path), num_seeds=num_seeds)
    folder = tmp_path / "FakeReach-v0" / "tensorboard"

    def break_down(row, policy):
        if row["env_steps"] == 240:  # the checkpoint is of step 160
            assert [step for step, _ in shown(folder)[0]["train/return_per_step"]] == [80, 160]
            raise RuntimeError("out of memory")

    with pytest.raises(RuntimeError):
        train(FakeEnv(), config, on_log=break_down)
    result = train(FakeEnv(), config)
    assert len(result.curve) == 6
    check_shown(folder, result.curve)  # with several seeds, the statistics over them
    for seed in result.seeds if num_seeds > 1 else []:
        check_shown(folder / seed.name, seed.curve)
    told = str(shown(folder)[1].summary_metadata)
    assert all(name in told for name in ("lr", "num_seeds", "FakeReach-v0", "train/success"))
    assert len(list(folder.glob("events.*"))) == 1


@pytest.mark.slow
def test_a_logger_that_was_left_out_for_a_while_gets_everything(tmp_path):
    config = dataclasses.replace(SMALL, save_dir=str(tmp_path))
    train(FakeEnv(), dataclasses.replace(config, num_env_steps=160, logger=()))
    result = train(FakeEnv(), dataclasses.replace(config, num_env_steps=320))
    assert len(result.curve) == 4
    check_shown(tmp_path / "FakeReach-v0" / "tensorboard", result.curve)


def test_a_logger_that_fails_does_not_end_the_run_and_catches_up(tmp_path, monkeypatch):
    add, fails = TensorBoard.add, [True, False]

    def full(self, curves):
        if fails.pop():
            raise OSError(errno.ENOSPC, "No space left on device")
        add(self, curves)

    fails = [False, True]
    monkeypatch.setattr(TensorBoard, "add", full)
    progress, said = listening()
    result = train(FakeEnv(), dataclasses.replace(SMALL, save_dir=str(tmp_path)), progress)
    assert sum("--logger tensorboard failed" in text for text in said) == 1
    check_shown(tmp_path / "FakeReach-v0" / "tensorboard", result.curve)


def test_loggers_are_refused_before_anything_is_built(tmp_path, monkeypatch, capsys):
    assert parse_arguments(["--logger", "tensorboard", "wandb"]).logger == ("tensorboard", "wandb")
    assert PPOConfig().logger == ()
    with pytest.raises(UnknownNameError, match="Did you mean 'tensorboard'"):
        logging.check_loggers(["tensorbord"], "runs")
    with pytest.raises(ConfigError, match=r"--save-dir None"):
        logging.check_loggers(["tensorboard"], None)
    monkeypatch.setattr(logging, "find_spec", lambda name: None)
    with pytest.raises(
        MissingExtraError, match=r'needs tensorboardX: pip install "agym_jax\[tensorboard\]"'
    ):
        train(env := FakeEnv(), dataclasses.replace(SMALL, save_dir=str(tmp_path)))
    assert env.traces["reset"] == 0 and not list(tmp_path.iterdir())
    words = ["--env-name", "FakeReach-v0", "--logger", "wandb", "--save-dir", str(tmp_path)]
    assert main(words, make=lambda *_: pytest.fail("built before")) == 2
    assert 'pip install "agym_jax[wandb]"' in capsys.readouterr().err


def test_services_get_each_step_once_with_all_seeds_in_it(tmp_path):
    curves = {
        "": [{"env_steps": 80, "success": 0.5, "return": None}],
        "seed_1": [{"env_steps": 80, "success": 0.4, "loss/kl": 2.0}],
    }
    got = []
    place = Place(tmp_path / "place.json")
    place.log(curves, lambda numbers, step: got.append((step, numbers)))
    wanted = {"train/success": 0.5, "seed_1/train/success": 0.4, "seed_1/loss/kl": 2.0}
    assert got == [(80, wanted)]
    curves[""].append({"env_steps": 160, "success": 0.75})
    resumed = Place(tmp_path / "place.json")
    assert resumed.identity == place.identity
    resumed.log(curves, lambda numbers, step: got.append((step, numbers)))
    assert got[1:] == [(160, {"train/success": 0.75})]


@pytest.mark.skipif(not importlib.util.find_spec("wandb"), reason="needs the extra wandb")
def test_wandb_offline_continues_one_run(tmp_path, monkeypatch):
    monkeypatch.setenv("WANDB_MODE", "offline")
    monkeypatch.setenv("WANDB_SILENT", "true")
    config = dataclasses.replace(
        SMALL, save_dir=str(tmp_path), logger=("wandb",), num_env_steps=160
    )
    train(FakeEnv(), config)
    train(FakeEnv(), dataclasses.replace(config, num_env_steps=320))
    folder = tmp_path / "FakeReach-v0"
    place = json.loads((folder / "wandb.json").read_text())
    assert place["env_steps"] == 320
    files = sorted((folder / "wandb").glob(f"offline-run-*-{place['id']}/run-{place['id']}.wandb"))
    deadline, steps = time.monotonic() + 60, []
    while len(steps) < 4 and time.monotonic() < deadline:  # a process of wandb's own writes them
        steps = [x for path in files for x in wandb_steps(path)]
        time.sleep(0.2)
    assert len(files) == 2 and steps == [80, 160, 240, 320]


def wandb_steps(path):
    """Steps of the rows in an offline log, whose records are framed as in LevelDB's logs."""
    from wandb.proto import wandb_internal_pb2

    content, at, data, found = path.read_bytes(), 7, b"", []
    while at < len(content):
        if 2**15 - at % 2**15 < 7:  # the rest of a block is empty
            at += 2**15 - at % 2**15
            continue
        length, kind = struct.unpack("<HB", content[at + 4 : at + 7])
        data += content[at + 7 : at + 7 + length]
        at += 7 + length
        if kind in (1, 4):  # whole, or the last part
            record, data = wandb_internal_pb2.Record.FromString(data), b""
            if record.WhichOneof("record_type") == "history":
                found.append(record.history.step.num)
    return found


@pytest.mark.skipif(not importlib.util.find_spec("trackio"), reason="needs the extra trackio")
def test_trackio_continues_one_run(tmp_path, monkeypatch):
    monkeypatch.setenv("TRACKIO_DIR", str(tmp_path / "trackio"))
    import sqlite3

    config = dataclasses.replace(
        SMALL, save_dir=str(tmp_path), logger=("trackio",), num_env_steps=160
    )
    train(FakeEnv(), config)
    result = train(FakeEnv(), dataclasses.replace(config, num_env_steps=320))
    (database,) = (tmp_path / "trackio").rglob("agym_jax*.db")
    with sqlite3.connect(database) as connection:
        rows = connection.execute(
            "select run_name, step, metrics from metrics order by step"
        ).fetchall()
    place = json.loads((tmp_path / "FakeReach-v0" / "trackio.json").read_text())
    assert {name for name, _, _ in rows} == {f"FakeReach-v0-{place['id']}"}
    assert [step for _, step, _ in rows] == [80, 160, 240, 320]
    assert json.loads(rows[-1][2])["train/return_per_step"] == pytest.approx(
        result.curve[-1]["return_per_step"]
    )
