# ruff: noqa: D103 (a test's name says what it shows)
"""Seeds are measured, one is chosen over some episodes and reported over others, and two settings are compared."""

from __future__ import annotations

import dataclasses
import json
import shutil
from types import SimpleNamespace

import jax
import numpy as np
import pytest
from fake_env import FakeEnv
from fake_press_env import FakePressEnv

from agym_jax.errors import UnknownNameError
from agym_jax.policy.policy import read_policy, save_policy
from agym_jax.spec import Measure
from train import compare, select
from train.configs import PPOConfig
from train.errors import ConfigError
from train.evaluation.gentleness import Gentleness
from train.evaluation.score import EvaluationResult
from train.evaluation.seed_scores import SeedScores
from train.ppo import train
from train.runs.overview import read_rows

SHORT = PPOConfig(
    num_env_steps=320, num_envs=16, num_mini_batch=4, policy_hidden=(32,), value_hidden=(32,), lr=1e-3,
    num_seeds=3, recompute_advantages=False,  # 16 environments: values would learn so few steps by heart
)  # fmt: skip


def make(name: str, impl: str) -> FakeEnv:
    return FakeEnv(name=name)


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    """A run that has learned nothing, and one that has learned to reach."""
    from dataclasses import replace

    folder = tmp_path_factory.mktemp("runs")
    short = replace(SHORT, save_dir=str(folder / "short"))
    long = replace(SHORT, save_dir=str(folder / "long"), num_env_steps=40_000, lr=5e-3)
    return [train(FakeEnv(), config).folder for config in (short, long)]


def scores(*successes):
    results = {
        seed: EvaluationResult(
            "X-v0", np.array(rows, float), np.zeros(len(rows)), np.array(rows) > 0,
            np.zeros(len(rows)), 0, 1.0,
        )
        for seed, rows in enumerate(successes, start=5)
    }  # fmt: skip
    return SeedScores(results)


def test_scores_of_seeds():
    found = scores([1, 1, 0, 0], [1, 1, 1, 1], [0, 0, 0, 0], [1, 0, 1, 1])
    assert found.best == 6 and found.worst == 7
    summary = found.summary()
    assert summary["success_of_seeds"] == [0.5, 1.0, 0.0, 0.75] and summary["seeds"] == [5, 6, 7, 8]
    assert summary["success_iqm"] == pytest.approx(0.625)  # the mean of 0.5 and 0.75
    assert summary["success_iqm_low"] < 0.625 < summary["success_iqm_high"]
    assert "interquartile mean of success: 62.5%" in found.table()


def test_episodes_in_which_no_seed_succeeds_are_told_from_those_in_which_some_do():
    found = scores([1, 1, 0, 0], [1, 0, 1, 0], [1, 0, 0, 0])
    summary = found.summary()
    assert summary["success_of_some"] == 0.75 and summary["success_of_all"] == 0.25
    assert "some seed succeeds in 75.0%, every seed in 25.0%" in found.table()
    assert "some seed" not in scores([1, 0]).table()  # the same as its success


def test_seeds_can_be_ranked_by_gentle_success():
    found = scores([1, 1, 1, 1], [1, 1, 1, 0])
    harsh = [np.array([0.0, 5.0, 5.0, 0.0]), np.zeros(4)]
    results = {
        seed: dataclasses.replace(
            x, gentleness=Gentleness(np.ones(4), over, np.zeros(4), np.full(4, 20.0))
        )
        for (seed, x), over in zip(found.results.items(), harsh, strict=True)
    }
    assert SeedScores(results).best == 5 and SeedScores(results, "gentle").best == 6
    assert SeedScores(results, "both").best == 5  # 1.0 + 0.5, and 0.75 + 0.75 with fewer successes
    assert SeedScores(found.results, "gentle").best == 5  # where it is not measured
    assert SeedScores(results).summary()["gentle_success_of_seeds"] == [0.5, 0.75]
    assert "gentle  75.0%" in SeedScores(results).table()


def test_a_seed_that_needs_noise_is_named(tmp_path):
    for seed, rates in ((1, (0.2, 0.9)), (2, (0.5, 0.5)), (3, ())):
        folder = tmp_path / f"seed_{seed}"
        folder.mkdir()
        (folder / "policy.npz").touch()
        rows = [
            {"env_steps": 100 * i, "episodes": 8, "success": rate, "return_per_step": 0.0}
            for i, rate in enumerate(rates, start=1)
        ]
        (folder / "curve.jsonl").write_text("".join(json.dumps(row) + "\n" for row in rows))
    noisy = select.successes_with_noise(tmp_path)
    assert noisy == [0.9, 0.5, None]
    told = select.needs_noise(scores([1, 0, 0, 0], [1, 1, 0, 0], [0, 0, 0, 0]), noisy)
    assert "seed 5 (90.0%, mode 25.0%)." in told and "seed 6" not in told
    assert select.needs_noise(scores([1, 1, 1, 1]), [0.95]) == ""
    assert select.needs_noise(scores([1, 0, 0, 0]), [0.5]) == ""  # four episodes do not tell


def test_what_measures_have_to_reach_is_checked_before_anything_runs():
    held = SimpleNamespace(measures=(Measure("held", "1", "share of episodes"),))
    env = SimpleNamespace(name="DressingJaco-v0", task=held)
    asked = lambda *texts: select.limits(select.SelectConfig("run", at_least=texts), env)  # noqa: E731
    assert asked("held=0.9") == {"held": 0.9} and asked() == {}
    with pytest.raises(UnknownNameError, match=r"hold.*held"):
        asked("hold=0.9")
    for text in ("held", "held=much"):
        with pytest.raises(ConfigError, match="NAME=VALUE"):
            asked(text)
    with pytest.raises(UnknownNameError):  # a task without measures
        select.limits(select.SelectConfig("run", at_least=("held=1",)), FakeEnv())


@pytest.mark.slow
def test_a_run_with_a_cost_limit_is_chosen_by_gentle_success(tmp_path, capsys):
    limited = dataclasses.replace(SHORT, save_dir=str(tmp_path), cost_limit=1.0)
    run = str(train(FakePressEnv(), limited).folder)
    make_press = lambda name, impl: FakePressEnv(name=name)  # noqa: E731
    for more, by in (([], "gentle"), (["--by", "success"], "success"), (["--by", "both"], "both")):
        out = tmp_path / f"{by}.jsonl"
        words = [run, "--num-episodes", "8", "--json", str(out), *more]
        assert select.main(words, make_press) == 0
        line = json.loads(out.read_text())
        assert line["chosen_by"] == by and 0 <= line["chosen_gentle_success"] <= 1


def test_the_chosen_seed_is_reported_over_other_episodes_and_ready_for_use(runs, tmp_path, capsys):
    long, file = runs[1], tmp_path / "selection.jsonl"
    assert select.main([str(long), "--num-episodes", "64", "--json", str(file)], make) == 0
    line = json.loads(file.read_text())
    assert (
        line["kind"] == "selection"
        and line["seeds"] == [1, 2, 3]
        and line["chosen"] == line["best"]
    )
    of_seeds = dict(zip(line["seeds"], line["success_of_seeds"], strict=True))
    assert of_seeds[line["chosen"]] == max(of_seeds.values())
    assert (line["chosen_over"], line["reported_over"]) == (2001, 1001)
    assert all(0 <= x <= 1 for x in line["success_with_noise_of_seeds"])
    chosen = read_policy(long / "policy.npz")
    assert chosen.info["seed"] == line["chosen"]
    of_run = read_rows(long / "selection.jsonl")
    assert of_run[-1] == line  # asked for or not
    told = capsys.readouterr()
    assert f"Chosen: seed {line['chosen']}" in told.out
    assert f"3 of 3: seed 3 succeeds in {of_seeds[3]:.1%}" in told.err
    assert select.main([str(long), "--seed", "1001"], make) == 2
    assert "must not be reported on the episodes" in capsys.readouterr().err


def test_a_run_of_more_varied_people_can_be_measured_among_the_usual_ones(runs, tmp_path, capsys):
    run, file, asked = tmp_path / runs[1].name, tmp_path / "selection.jsonl", []
    varied = {"humans.sizes": "both"}
    for seed in (1, 2):
        policy = read_policy(runs[1] / f"seed_{seed}" / "policy.npz")
        (run / f"seed_{seed}").mkdir(parents=True)
        info = {**policy.info, "changes": varied}
        save_policy(run / f"seed_{seed}" / "policy.npz", dataclasses.replace(policy, info=info))

    def record_make(name, impl, **options):
        asked.append(options)
        return FakeEnv(name=name)

    words = [str(run), "--num-episodes", "16", "--default-settings", "--json", str(file)]
    assert select.main(words, record_make) == 0
    line, chosen = json.loads(file.read_text()), read_policy(run / "policy.npz")
    assert asked == [{}] and "changes" not in line and line["trained_with"] == varied
    assert chosen.info["meant_for"] == {} and chosen.info["changes"] == varied
    seed = read_policy(run / f"seed_{line['chosen']}" / "policy.npz")
    jax.tree.map(np.testing.assert_array_equal, chosen.weights, seed.weights)
    with pytest.raises(TypeError, match="humans"):  # without it, as trained: the fake has no people
        select.main(words[:3], lambda name, impl: FakeEnv(name=name))


def test_a_run_without_seeds_is_refused(tmp_path, capsys):
    assert select.main([str(tmp_path)], make) == 2
    assert "--num-seeds 8" in capsys.readouterr().err


def test_what_has_learned_is_better_than_what_has_not(runs, tmp_path, capsys):
    short, long = map(str, runs)
    file = tmp_path / "comparison.jsonl"
    assert compare.main([long, short, "--num-episodes", "64", "--json", str(file)], make) == 0
    line = json.loads(file.read_text())
    assert line["returns"] == {"probability": 1.0, "low": 1.0, "high": 1.0}
    assert line["seed"] == 1001 and "impl" in line
    assert line["first"]["return_iqm"] > line["second"]["return_iqm"]
    assert "has a higher return than one of the second with prob" in capsys.readouterr().out
    assert compare.main([short, short, "--num-episodes", "64"], make) == 0
    assert "a higher return than one of the second with probability 50%" in capsys.readouterr().out


def test_a_file_of_results_that_cannot_be_written_is_refused_before_anything_is_evaluated(
    runs, tmp_path, capsys
):
    short = str(runs[0])
    for command in ([compare, [short, short]], [select, [short]]):
        assert command[0].main([*command[1], "--json", str(tmp_path)], make) == 2
        assert "it is a folder. Nothing has been computed yet" in capsys.readouterr().err


def test_runs_without_any_difference_are_called_equal(monkeypatch, runs, capsys):
    monkeypatch.setattr(compare, "score_seeds", lambda *_, **__: scores([1, 0], [0, 1]))
    assert compare.main([str(runs[0]), str(runs[0]), "--num-episodes", "2"], make) == 0
    out = capsys.readouterr().out
    assert "All seeds of both runs have the same number of successes.\n" in out
    assert "All seeds of both runs have the same return.\n" in out and "probability" not in out


def test_what_counts_is_the_environment_not_the_name_of_the_folder(runs, tmp_path, capsys):
    """As settings of a sweep have folders of their own."""
    setting = shutil.copytree(runs[0], tmp_path / "lr=0.001")
    assert compare.main([str(setting), str(runs[0]), "--num-episodes", "8"], make) == 0
    assert select.main([str(setting), "--num-episodes", "8"], make) == 0
    for file in setting.glob("seed_*/policy.npz"):
        policy = read_policy(file)
        other = dataclasses.replace(policy, info={**policy.info, "env": "Other-v0"})
        save_policy(file, other)
    assert compare.main([str(runs[0]), str(setting)], make) == 2
    assert "Other-v0 are different environments" in capsys.readouterr().err
