# ruff: noqa: D103
"""Flags that say what environment is made, and that runs of other settings do not mix."""

from __future__ import annotations

import json
from typing import Any

import pytest
from fake_env import FakeEnv

from agym_jax import Population
from agym_jax.flags import EnvFlags, command_words, parse_flags
from agym_jax.policy.policy import read_policy
from agym_jax.tasks.scratch_itch import Config
from agym_jax.viewer.command import ViewConfig
from train import coop, crossplay, demo, enjoy, evaluate, ppo, select, sweep
from train.configs import CoopConfig, PPOConfig, config_for, parse_arguments
from train.enjoy import EnjoyConfig
from train.errors import CheckpointMismatchError
from train.evaluate import EvaluateConfig
from train.sweep import SweepConfig

WORDS = (
    "--env-name ScratchItchJaco-v0 --task.scratch 3 --humans.sizes continuous --episode-length 100"
)
OPTIONS = {
    "config": Config(scratch=3.0),
    "humans": Population("continuous"),
    "episode_length": 100,
}


class ChangedEnv(FakeEnv):
    """One that says that it is not as its name says."""

    changes: dict[str, Any] = {}  # noqa: RUF012
    humans = Population()
    variation = task = None
    memory = ()


def make(name: str, impl: str, episode_length: int = 20, **options: Any) -> ChangedEnv:
    env = ChangedEnv(episode_length=episode_length)
    env.changes = {} if episode_length == 20 else {"episode_length": episode_length}
    assert not options
    return env


@pytest.mark.parametrize("kind", [PPOConfig, EvaluateConfig, EnjoyConfig, SweepConfig, ViewConfig])
def test_flags_become_the_arguments_of_make(kind):
    config = parse_flags(kind, WORDS.split(), "x")
    assert config.options() == OPTIONS
    assert parse_flags(kind, [], "x").options() == {}


def test_the_trainers_have_them_beside_their_own():
    config = parse_arguments([*WORDS.split(), "--lr", "1e-3"])
    assert config.options() == OPTIONS and config.lr == 1e-3
    assert config_for("ReachingJaco-v0").options() == {}
    other = parse_arguments(["--env-name", "FeedingPR2-v0", "--task.eaten", "5"])
    assert other.task.eaten == 5.0 and set(other.options()) == {"config"}


@pytest.mark.parametrize("main", [ppo.main, coop.main])
def test_the_help_of_trainers_says_whose_defaults_it_shows(main, capsys):
    with pytest.raises(SystemExit):
        main(["--env-name", "FeedingPR2-v0", "--help"])
    out = capsys.readouterr().out
    words = " ".join(out.split())
    usual = CoopConfig.env_name if main is coop.main else PPOConfig.env_name
    assert f"those of the environment named by --env-name ({usual} if it is left out)" in words
    assert "add --env-name ID before --help" in words and "--task.eaten" in out
    assert "128 128" in words, "defaults of a CPU"


def test_hyperparameters_have_the_names_of_other_libraries_too():
    words = (
        "--learning-rate 1e-3 --epochs 3 --num-minibatches 2 --clip-range 0.1 --total-timesteps 2e4"
    )
    config = parse_arguments(words.split())
    assert (config.lr, config.ppo_epoch, config.num_mini_batch) == (1e-3, 3, 2)
    assert (config.clip_param, config.num_env_steps) == (0.1, 20_000)


@pytest.mark.parametrize("module", [evaluate, crossplay, demo])
def test_the_help_of_a_command_says_what_it_does(module, capsys):
    with pytest.raises(SystemExit):
        module.main(["--help"])
    words = " ".join(capsys.readouterr().out.split())
    does = module.__doc__.partition(":")[0]
    assert f"{does}: agym-jax {module.__name__.removeprefix('train.')}" in words
    assert "Flags of ``agym-jax" not in words


def test_settings_of_another_task_are_no_flags(capsys):
    with pytest.raises(SystemExit):
        parse_arguments(["--env-name", "ReachingJaco-v0", "--task.scratch", "3"])
    assert "--task.scratch" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "told"),
    [("--humans.sizes continous", "'continuous'"), ("--task.spacing 0.001", "at least 0.03 m")],
)
@pytest.mark.parametrize("main", [evaluate.main, ppo.main])
def test_what_makes_no_sense_ends_with_a_sentence(main, words, told, capsys):
    try:
        status = main(["--env-name", "BedBathingJaco-v0", *words.split()])
    except SystemExit as stop:  # tyro's own
        status = stop.code
    assert status == 2
    assert told in " ".join(capsys.readouterr().err.split())


TRAIN = [
    "--env-name",
    "FakeReach-v0",
    "--num-env-steps",
    "64",
    "--num-envs",
    "4",
    "--num-steps",
    "8",
    "--num-mini-batch",
    "1",
    "--ppo-epoch",
    "1",
    "--policy-hidden",
    "4",
    "--value-hidden",
    "4",
    "--impl",
    "jax",
    "--save-dir",
]


@pytest.mark.slow
@pytest.mark.jit
def test_a_run_of_other_settings_is_not_continued(tmp_path, capsys, restored_settings):
    """And its policies say so where they are evaluated otherwise; ``select`` makes the environment of the run."""
    words = [*TRAIN, str(tmp_path)]
    assert ppo.main([*words, "--episode-length", "10", "--num-seeds", "2"], make) == 0
    run = tmp_path / "FakeReach-v0"
    assert json.loads((run / "config.json").read_text())["config"]["episode_length"] == 10
    assert read_policy(run / "seed_1" / "policy.npz").info["changes"] == {"episode_length": 10}
    assert ppo.main([*words, "--num-seeds", "2"], make) == 2
    said = capsys.readouterr().err
    assert CheckpointMismatchError.__name__ in said
    assert "episode_length is 10 in the run, the default here" in said and "--fresh" in said
    assert ppo.main([*words, "--episode-length", "10", "--num-seeds", "2"], make) == 0  # as before

    assert (
        select.main([str(run), "--num-episodes", "2", "--impl", "jax", "--no-shipped"], make) == 0
    )
    measure = ["--env-name", "FakeReach-v0", "--load-dir", str(tmp_path), "--num-episodes", "2"]
    capsys.readouterr()
    longer, same = tmp_path / "longer.jsonl", tmp_path / "same.jsonl"
    assert evaluate.main([*measure, "--json", str(longer)], make) == 0
    said = "episode_length is 10 in training, the default here"
    assert f"Differs from training: {said}." in capsys.readouterr().out
    assert json.loads(longer.read_text())["other_than_in_training"] == said
    assert evaluate.main([*measure, "--episode-length", "10", "--json", str(same)], make) == 0
    assert "Differs from training" not in capsys.readouterr().out
    line = json.loads(same.read_text())
    assert line["changes"] == {"episode_length": 10} and "other_than_in_training" not in line
    assert line["policy_changes"] == {"episode_length": 10}


@pytest.mark.parametrize(
    ("words", "becomes"),
    [
        (["A-v0", "--seed", "1"], ["--env-name", "A-v0", "--seed", "1"]),
        (["--env-name", "A-v0"], ["--env-name", "A-v0"]),
        (["--seed", "1"], ["--seed", "1"]),
        ([], []),
    ],
)
def test_an_id_may_come_first(words, becomes):
    assert command_words(words) == becomes


@pytest.mark.parametrize(
    ("command", "more"),
    [
        (ppo, ""), (coop, ""), (evaluate, ""), (enjoy, ""), (demo, ""),
        (crossplay, "--robots zero --humans zero"), (sweep, "--grid lr=1e-3,1e-4"),
    ],
)  # fmt: skip
def test_every_command_of_an_environment_takes_its_id_first(command, more, capsys):
    assert command.main(["ReachingSawyr-v0", *more.split()]) == 2
    assert "Did you mean 'ReachingSawyer" in capsys.readouterr().err


def test_a_command_without_arguments_reads_those_of_its_process(monkeypatch):
    monkeypatch.setattr("sys.argv", ["evaluate.py", "--env-name", "FeedingPR2-v0"])
    assert parse_flags(EnvFlags, None, "evaluate").env_name == "FeedingPR2-v0"
    assert parse_flags(EnvFlags, [], "evaluate").env_name == EnvFlags.env_name
