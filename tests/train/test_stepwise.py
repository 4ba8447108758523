# ruff: noqa: D103
"""Driven from Python, evaluation and training do what they do inside one program; the demo runs."""

from __future__ import annotations

import dataclasses

import jax
import numpy as np
import pytest
from fake_env import FakeEnv
from fake_pair_env import FakePairEnv

from agym_jax.policy import baseline_policy
from train.configs import PPOConfig
from train.demo import main as demo
from train.errors import ConfigError
from train.evaluate import Evaluator
from train.learning.execution import StepwiseEnv
from train.ppo import train
from train.runs.session import resolve_config

CONFIG = PPOConfig(
    num_env_steps=1280,
    num_envs=16,
    num_mini_batch=4,
    policy_hidden=(16,),
    value_hidden=(16,),
    log_interval=2,
    save_dir=None,
)


@pytest.fixture(scope="module")
def stepwise():
    env = FakeEnv()
    return env, StepwiseEnv(env.vectorize(16))


def test_training_is_the_same_either_way(stepwise):
    env, venv = stepwise
    before = dict(env.traces)
    by_steps = train(venv, CONFIG)
    assert env.traces == before  # nothing of the environment is compiled again
    at_once = train(FakeEnv(), CONFIG)
    assert [row["episodes"] for row in by_steps.curve] == [r["episodes"] for r in at_once.curve]
    for ours, theirs in zip(by_steps.curve, at_once.curve, strict=True):
        for name in ("return", "return_per_step", "force", "loss/value_loss", "loss/entropy"):
            assert ours[name] == pytest.approx(theirs[name], rel=1e-3), name


def test_evaluation_is_the_same_either_way(stepwise):
    env, venv = stepwise
    seen = []
    key, policy = jax.random.PRNGKey(3), baseline_policy("random", 2)
    ours = Evaluator(venv, 16)(policy, key, watch=seen.append)
    theirs = Evaluator(env, 16)(policy, key)
    np.testing.assert_allclose(ours.returns, theirs.returns, rtol=1e-4)
    np.testing.assert_array_equal(ours.successes, theirs.successes)
    assert len(seen) == env.episode_length + 1


def test_another_batch_size_is_refused(stepwise):
    _, venv = stepwise
    with pytest.raises(ConfigError, match="compiled for 16 environments, not 32"):
        train(venv, dataclasses.replace(CONFIG, num_envs=32))


def test_the_demo_is_of_robots_alone(capsys, tmp_path):
    words = ["--env-name", "FeedingJacoHuman-v0", "--out", str(tmp_path)]
    assert demo(words, make=lambda *_: FakePairEnv()) == 2
    assert "act together" in capsys.readouterr().err


def test_demo_without_a_policy_says_how_to_train_one(tmp_path, capsys):
    status = demo(["--env-name", "FakeReach-v0", "--out", str(tmp_path)], lambda name, impl: None)
    assert status == 2
    assert "agym-jax train --env-name FakeReach-v0" in capsys.readouterr().err


def test_the_demo_knows_which_environments_there_are(tmp_path, capsys):
    assert demo(["--env-name", "ScratchItchJako-v0", "--out", str(tmp_path)]) == 2
    said = capsys.readouterr().err
    assert "UnknownNameError" in said and "Did you mean 'ScratchItchJaco-v0'" in said
    assert not list(tmp_path.iterdir())


def test_several_hosts_do_not_train_with_c_mujoco(monkeypatch):
    monkeypatch.setattr(jax, "process_count", lambda: 2)
    config = PPOConfig(env_name="FakeReach-v0", save_dir=None)
    with pytest.raises(ConfigError, match="one machine"):
        resolve_config(StepwiseEnv(FakeEnv().vectorize(4)), config)
