# ruff: noqa: D103
"""The parts of the benchmarks that need no environment."""

from __future__ import annotations

import dataclasses
import json
import signal
from types import SimpleNamespace
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from agym_jax.data.npz import write_npz
from agym_jax.errors import DamagedFileError
from benchmarks import compile as starts
from benchmarks import kills, nan, resume, speed_tables, throughput, training_speed, viewer_speed
from benchmarks.child import ChildError, run_child
from benchmarks.rollout import run_steps, zero_totals
from train.configs import parse_arguments
from train.runs.folder import RunFolder


def test_percentile_of_a_histogram_is_right_to_a_bin():
    rng = np.random.default_rng(0)
    forces = np.where(rng.random(200_000) < 0.5, 0.0, rng.exponential(8.0, 200_000))
    counts = np.bincount(np.asarray(nan.bin_of(jnp.asarray(forces))), minlength=nan.BINS)
    assert counts.sum() == len(forces)
    for share in (0.9, 0.999, 0.9999):
        assert nan.percentile(counts, share) == pytest.approx(np.quantile(forces, share), rel=0.01)
    assert nan.percentile(counts, 0.4) == 0.0


def test_forces_beyond_the_histogram_are_kept_in_its_ends():
    bins = np.asarray(nan.bin_of(jnp.array([0.0, 1e-9, 1e12, jnp.inf])))
    assert bins.tolist() == [0, 0, nan.BINS - 1, nan.BINS - 1]


@pytest.mark.parametrize("flag", ["--steps", "--repeats", "--num-envs"])
def test_throughput_of_nothing_is_refused(flag, capsys):
    assert throughput.main([flag, "0"]) == 2
    assert flag in capsys.readouterr().err


def test_throughput_of_an_unknown_environment_says_what_exists(capsys):
    status = throughput.main(["--env-name", "ScratchItchJacko-v0", "--num-envs", "4"])
    assert status == 2
    assert "Did you mean 'ScratchItchJaco-v0'" in capsys.readouterr().err


def test_a_child_gets_its_variables_and_reports_its_last_line():
    code = "import json, os, sys; print('noise'); print(json.dumps([sys.argv[1], os.environ['A']]))"
    assert run_child(code, "b", A="c") == ["b", "c"]
    with pytest.raises(ChildError, match=r"(?s)measuring process failed.*ZeroDivisionError"):
        run_child("1 / 0")


def test_a_start_is_measured_with_empty_caches_and_with_filled_ones(monkeypatch):
    seen = []

    def child(code, began, *arguments, **caches):
        seen.append((arguments, caches))
        return {"impl": "jax", "num_envs": 64, "compile_s": 2.0, "until_training_s": 3.0}

    monkeypatch.setattr(starts, "run_child", child)
    rows = list(starts.measure("ReachingJaco-v0", "jax"))
    assert [row["start"] for row in rows] == ["cold", "warm"]
    assert seen[0] == seen[1]  # the same caches
    assert set(seen[0][1]) == {"AGYM_JAX_CACHE", "WARP_CACHE_PATH"}


def test_a_start_of_an_unknown_environment_says_what_exists(capsys):
    assert starts.main(["--env-name", "ScratchItchJacko-v0"]) == 2
    assert "Did you mean 'ScratchItchJaco-v0'" in capsys.readouterr().err


def test_a_run_ends_as_its_last_episodes_did_and_a_failed_one_says_why(capsys):
    rows = [{"return": None if i < 4 else float(i), "success": i / 100} for i in range(24)]
    assert resume.end(rows) == {"return": 22.5, "success": 0.225}
    assert resume.main(["--env-name", "RechingJaco-v0", "--seeds", "1"]) == 2
    assert "ReachingJaco-v0" in capsys.readouterr().err


def test_the_search_for_nan_notes_one_interrupt():
    before = signal.getsignal(signal.SIGINT)
    with nan.noted_interrupt() as stop:
        assert not stop() and signal.getsignal(signal.SIGINT) is not before
        signal.raise_signal(signal.SIGINT)
        assert stop() and signal.getsignal(signal.SIGINT) is before
    with nan.noted_interrupt():
        pass
    assert signal.getsignal(signal.SIGINT) is before  # without an interrupt too


def test_speed_of_training_counts_every_call_but_the_first(monkeypatch):
    def make(name, impl):
        return SimpleNamespace(name=name, impl=impl)

    def train(env, settings, progress):
        rows = [{"steps_per_second": v} for v in (1.0, 30.0, 50.0, 40.0)]
        steps = settings.num_env_steps
        return SimpleNamespace(curve=rows, config=settings, env_steps=steps, nan_steps=0)

    monkeypatch.setattr(training_speed, "make_env", make)
    monkeypatch.setattr(training_speed.coop, "train", train)
    config = training_speed.TrainingSpeedConfig(num_envs=16, updates=20, impl="jax")
    row = training_speed.measure(config, 2, 2)
    assert (row["steps_per_s"], row["steps_per_s_min"], row["steps_per_s_max"]) == (40, 30, 50)
    assert (row["num_envs"], row["devices"], row["learners"]) == (32, 2, 2)
    assert (
        row["steps"] == 11 * 2 * 32 * 20
    )  # calls, updates of each, environments, steps of a rollout
    seeds = training_speed.measure(dataclasses.replace(config, num_seeds=3), 2, 2)
    assert seeds["num_seeds"] == 3 and seeds["steps"] == 3 * row["steps"]


def test_speed_of_training_an_unknown_environment_says_what_exists(capsys):
    assert training_speed.main(["--env-name", "FeedingJackoHuman-v0"]) == 2
    assert "Did you mean 'FeedingJacoHuman-v0'" in capsys.readouterr().err


def test_speed_of_training_knows_one_learner_and_two(capsys):
    with pytest.raises(SystemExit):
        training_speed.main(["--learners", "3"])
    assert "1" in (said := capsys.readouterr().err) and "2" in said and "3" in said


def test_the_table_of_training_compares_with_one_learner_on_one_device(tmp_path):
    about = {"commit": "0123456789", "device": {"kind": "GPU"}, "env": "A-v0", "impl": "warp"}
    speeds = {"steps_per_s": 0, "steps_per_s_min": 1, "steps_per_s_max": 2, "num_envs": 8}
    one = about | speeds | {"learners": 1, "devices": 1, "steps_per_s": 200}
    two = about | speeds | {"learners": 2, "devices": 1, "steps_per_s": 150}
    (tmp_path / "training_speed.jsonl").write_text("\n".join(map(json.dumps, (two, one))))
    rows = speed_tables.training_speed(tmp_path).splitlines()[2:4]
    assert [row.split("|")[-2].strip() for row in rows] == ["1.00", "0.75"]
    seeds = one | {"num_seeds": 8, "steps_per_s": 900}  # of its own: it does not hide the one above
    (tmp_path / "training_speed.jsonl").write_text("\n".join(map(json.dumps, (two, one, seeds))))
    assert speed_tables.training_speed(tmp_path).splitlines()[2:4] == rows
    found = speed_tables.seed_speed(tmp_path).splitlines()
    assert found[
        2
    ] == "| A-v0 | warp | 8 x 8 | float32 | **900** (1 to 2) |" and "A-v0" not in "".join(found[3:])


def test_what_a_kill_breaks_is_found(tmp_path):
    config = kills.KillsConfig(folder=tmp_path, num_env_steps=1440)
    disk = kills.Disk(config, RunFolder(str(tmp_path), config.env_name))
    disk.folder.checkpoints.mkdir(parents=True)
    rows = [{"env_steps": 480}, {"env_steps": 960}]
    disk.folder.write_curve(rows)
    checkpoint = disk.folder.checkpoints / "step_000000000480.npz"
    write_npz(checkpoint, {"a": np.ones(2)}, {"curve": rows[:1]})
    assert disk.faults() == [] and disk.saved() == 480 and disk.total == 1440
    disk.folder.write_curve([*rows, rows[-1]])
    assert disk.faults() == ["rows of steps [480, 960, 960]"]
    disk.folder.write_curve(rows[1:])
    assert len(disk.faults()) == 2
    checkpoint.write_bytes(checkpoint.read_bytes()[:99])
    with pytest.raises(DamagedFileError):
        disk.faults()


def test_the_commands_of_a_killed_run_mean_its_settings(tmp_path):
    config = kills.KillsConfig(folder=tmp_path)
    train, evaluate = kills.commands(config, 3, tmp_path)
    assert parse_arguments(train[1:], platform="cpu") == kills.settings(config, 3, tmp_path)
    assert (train[0], evaluate[0]) == ("train", "evaluate")


def test_the_viewers_speed_is_measured_within_one_episode(capsys):
    assert viewer_speed.main(["--env-names", "ReachingJaco-v0", "--seconds", "18"]) == 2
    assert "lasts 20 s" in capsys.readouterr().err


@pytest.mark.slow
def test_the_viewer_keeps_up_with_real_time(tmp_path):
    file = tmp_path / "speed.jsonl"
    words = ["--env-names", "ReachingJaco-v0", "--seconds", "2", "--json", str(file)]
    assert viewer_speed.main(words) == 0
    line = json.loads(file.read_text())
    assert 5 < line["frames_per_s"] < 26 and 0.8 < line["share_of_real_time"] < 1.2


class Flat(NamedTuple):
    """A state of environments that only move."""

    obs: Any
    reward: Any
    done: Any
    metrics: dict[str, Any]


@pytest.mark.parametrize("act", [None, lambda obs: 0.0 * obs + 2.0])
def test_steps_are_a_policys_where_there_is_one_and_random_otherwise(act):
    zero = jnp.zeros(3)
    state = Flat(jnp.zeros((3, 1)), zero, zero, {"nan": zero, "overflow": zero})
    venv = SimpleNamespace(
        num_envs=3,
        action_size=1,
        step=lambda state, action: state._replace(obs=action, reward=action[:, 0]),
    )
    end, totals = run_steps(venv, steps=4, act=act)(state, jax.random.PRNGKey(0), zero_totals())
    if act:
        assert totals["reward"] == 2.0 * 3 * 4
    else:
        assert np.unique(end.obs).size == 3 and np.abs(end.obs).max() <= 1.0
    assert totals["nan"] == totals["overflow"] == totals["episodes"] == 0
