# ruff: noqa: D103 (a test's name says what it shows)
"""Settings learn side by side as they would alone, are ranked by their seeds, and nonsense is refused."""

from __future__ import annotations

import dataclasses
import json

import jax
import numpy as np
import pytest
from fake_env import FakeEnv

from agym_jax.errors import UnknownNameError
from train.configs import PPOConfig
from train.errors import ConfigError
from train.ppo import train
from train.select import had_limit
from train.sweep import main, name_of, parse_grid, rank, setting_of, sweep

CONFIG = PPOConfig(
    num_env_steps=320 * 60, num_envs=16, num_mini_batch=4, policy_hidden=(16,), value_hidden=(16,),
    lr=2e-3, log_interval=20, save_dir=None,
)  # fmt: skip


def weights(policy):
    return np.concatenate([np.ravel(x) for x in jax.tree.leaves(policy.weights)])


@pytest.mark.slow
def test_each_setting_learns_as_it_would_alone_and_the_better_one_comes_first():
    settings = parse_grid(["lr=1e-6,5e-3", "gamma=0.9"])
    result = sweep(FakeEnv(), CONFIG, settings, 2)
    names = [found.name for found in result.seeds]
    assert names[0] == "lr=1e-06,gamma=0.9/seed_1" and names[3] == "lr=0.005,gamma=0.9/seed_2"
    alone = train(FakeEnv(), dataclasses.replace(CONFIG, lr=5e-3, gamma=0.9, seed=2))
    apart = [
        np.abs(weights(x.policies["robot"]) - weights(alone.policy)).max() for x in result.seeds
    ]
    # 60 updates make rounding errors larger, on some processors up to 0.015
    assert apart[3] < 0.05 and min(apart[:3]) > 0.5
    ranked = rank(result, settings, 2)
    assert ranked[0]["setting"]["lr"] == 5e-3
    assert ranked[0]["return_iqm"] > ranked[1]["return_iqm"]


def test_settings_of_a_grid():
    assert parse_grid(["lr=1e-3,2e-3", "entropy-coef=0,1"]) == [
        {"lr": 1e-3, "entropy_coef": 0}, {"lr": 1e-3, "entropy_coef": 1},
        {"lr": 2e-3, "entropy_coef": 0}, {"lr": 2e-3, "entropy_coef": 1},
    ]  # fmt: skip
    some = parse_grid(["lr=1,2,3,4", "gamma=0,1"], random=3, seed=5)
    assert len(some) == 3 and len({name_of(x) for x in some}) == 3
    assert [setting_of(name_of(x)) for x in some] == some
    assert some == parse_grid(["lr=1,2,3,4", "gamma=0,1"], random=3, seed=5)
    with pytest.raises(UnknownNameError, match="ppo_epoch"):
        parse_grid(["ppo_epoch=2,4"])
    with pytest.raises(ConfigError, match="with numbers"):
        parse_grid(["lr=a,b"])
    for twice in (["lr=1e-3,0.001"], ["lr=1", "lr=2"], ["lr=0.10000001,0.10000002"]):
        with pytest.raises(ConfigError, match=r"--grid has lr.* twice"):
            parse_grid(twice)
    with pytest.raises(ConfigError, match="at least two settings"):
        parse_grid(["lr=1"])


@pytest.mark.slow
def test_the_command_writes_the_ranking(tmp_path, capsys):
    words = f"--env-name FakeReach-v0 --grid lr=1e-4,1e-3 --num-seeds 2 --num-envs 4 --num-env-steps 640 --save-dir {tmp_path}"
    assert main(words.split(), lambda name, impl: FakeEnv(name=name)) == 0
    ranked = json.loads((tmp_path / "FakeReach-v0" / "sweep.json").read_text())
    assert {x["setting"]["lr"] for x in ranked} == {1e-4, 1e-3}
    assert (tmp_path / "FakeReach-v0" / "lr=0.0001" / "seed_2" / "policy.npz").is_file()
    out = capsys.readouterr().out
    folder = tmp_path / "FakeReach-v0" / "SETTING"
    assert "worst seed" in out and f"Choose a seed: agym-jax select {folder}\n" in out


def test_settings_of_a_limit_are_refused_without_one():
    settings = parse_grid(("cost_multiplier_max=0.2,0.5",))
    with pytest.raises(ConfigError, match="cost_multiplier_max has no effect without a limit"):
        sweep(FakeEnv(), CONFIG, settings, 1)


def test_a_setting_of_a_sweep_has_the_limit_of_the_sweep(tmp_path):
    setting = tmp_path / "cost_limit=0.1"
    setting.mkdir()
    assert not had_limit(setting)
    for limit in (None, 0.1):
        (tmp_path / "config.json").write_text(json.dumps({"config": {"cost_limit": limit}}))
        assert had_limit(setting) is (limit is not None)
