# ruff: noqa: D103 (a test's name says what it shows)
"""Settings and the command line."""

from __future__ import annotations

import dataclasses
import re
from pathlib import Path

import pytest

from agym_jax.flags import env_name_in, parse_count
from train.configs import (
    TASK_CHANGES,
    CoopConfig,
    PPOConfig,
    config_for,
    parse_arguments,
    resolve,
)
from train.errors import ConfigError
from train.task_changes import NO_SEARCH


@pytest.mark.parametrize(
    ("text", "number"), [("1e7", 10_000_000), ("20000", 20_000), ("2_000_000", 2_000_000)]
)
def test_counts_may_be_written_as_people_do(text, number):
    assert parse_count(text) == number
    assert parse_arguments(["--num-env-steps", text]).num_env_steps == number


@pytest.mark.parametrize("text", ["1.5", "-3", "ten", "nan", "inf"])
def test_other_counts_are_refused(text):
    with pytest.raises(ValueError, match="2e4"):
        parse_count(text)


def test_a_wrong_count_on_the_command_line_says_how_to_write_it(capsys):
    with pytest.raises(SystemExit):
        parse_arguments(["--num-env-steps", "many"])
    assert "such as 20000 or 2e4" in " ".join(capsys.readouterr().err.split())


def test_flags_have_assistive_gyms_names():
    words = (
        "--env-name FeedingPR2-v0 --num-env-steps 2e6 --save-dir out --seed 3 --num-envs 8 "
        "--num-steps 10 --num-mini-batch 2 --ppo-epoch 5 --clip-param 0.1 --gamma 0.98 --tau 0.9 "
        "--entropy-coef 0.01 --value-loss-coef 1 --max-grad-norm 1 --lr 1e-3 "
        "--no-use-linear-lr-decay --log-interval 7 --save-interval 9 --impl jax "
        "--allow-joint-observation --policy-hidden 32 16"
    )
    config = parse_arguments(words.split())
    assert config == dataclasses.replace(
        config_for("FeedingPR2-v0"),
        env_name="FeedingPR2-v0",
        num_env_steps=2_000_000,
        save_dir="out",
        seed=3,
        num_envs=8,
        num_steps=10,
        num_mini_batch=2,
        ppo_epoch=5,
        clip_param=0.1,
        gamma=0.98,
        gae_lambda=0.9,
        entropy_coef=0.01,
        value_loss_coef=1.0,
        max_grad_norm=1.0,
        lr=1e-3,
        use_linear_lr_decay=False,
        log_interval=7,
        save_interval=9,
        impl="jax",
        allow_joint_observation=True,
        policy_hidden=(32, 16),
    )


def test_the_environment_on_the_command_line_decides_the_defaults(monkeypatch):
    monkeypatch.setitem(TASK_CHANGES, "Feeding", {"lr": 0.5})
    assert parse_arguments(["--env-name", "FeedingPR2-v0"]).lr == 0.5
    assert parse_arguments(["--env-name=FeedingPR2-v0", "--lr", "0.25"]).lr == 0.25
    assert parse_arguments(["--env-name", "MyTaskPR2-v0"]).lr == PPOConfig.lr
    assert env_name_in(["--seed", "1"], "other") == "other"
    assert env_name_in(["--env_name", "X"], "other") == "X"


@pytest.mark.parametrize("share", [-0.5, 1.5])
def test_a_share_of_the_run_is_one(share):
    with pytest.raises(ConfigError, match=f"entropy_decay_share .* {share}"):
        PPOConfig(entropy_decay_share=share)


def test_every_task_of_the_table_has_settings_that_work():
    for task in TASK_CHANGES:
        for platform in ("cpu", "gpu"):
            config = config_for(f"{task}Jaco-v0", platform=platform)
            assert resolve(config, platform).num_envs > 0


def test_networks_are_smaller_on_a_cpu_unless_others_are_asked_for():
    words = ["--env-name", "FeedingJaco-v0", "--lr", "0.5"]
    here, there = (parse_arguments(words, platform=x) for x in ("cpu", "gpu"))
    assert sum(here.policy_hidden) < sum(there.policy_hidden)
    assert (here.lr, here.gamma) == (there.lr, there.gamma) == (0.5, 0.99)
    mine = parse_arguments([*words, "--policy-hidden", "32", "16"], platform="cpu")
    assert mine.policy_hidden == (32, 16)


@pytest.mark.parametrize("task", TASK_CHANGES)
def test_two_learners_have_the_settings_of_one_in_the_same_task(task):
    one = config_for(f"{task}Jaco-v0")
    two = config_for(f"{task}JacoHuman-v0", CoopConfig)
    for platform in ("cpu", "gpu"):
        resolved = [dataclasses.asdict(resolve(config, platform)) for config in (one, two)]
        apart = {"env_name", "candidates_until", "num_env_steps", "log_interval", "save_interval"}
        apart |= NO_SEARCH.keys()
        common = resolved[0].keys() & resolved[1].keys() - apart
        assert len(common) > 25
        assert {n: resolved[0][n] for n in common} == {n: resolved[1][n] for n in common}


def test_trainings_that_rarely_find_success_search_for_it_with_candidates_and_restarts():
    def searches(name, kind=PPOConfig, **more):
        config = config_for(name, kind, **more)
        return config.num_candidates, config.restart_share

    assert searches("DressingPR2-v0") == searches("ArmManipulationJaco-v0") == (4, 0.5)
    assert searches("ArmManipulationPR2-v0") == searches("DrinkingJaco-v0") == (1, 0.0)
    assert searches("DressingPR2-v0", continues=True) == (1, 0.0)
    assert searches("DressingPR2-v0", platform="cpu") == (1, 0.0)
    assert (
        searches("DressingPR2Human-v0") == searches("DressingPR2Human-v0", CoopConfig) == (1, 0.0)
    )
    words = "--env-name DressingPR2-v0 --num-candidates 1 --restart-share 0"
    assert not NO_SEARCH.items() - vars(parse_arguments(words.split())).items()


def test_the_command_line_of_two_learners_knows_its_own_flags():
    words = "--env-name FeedingPR2Human-v0 --central-critic --human-policy p.npz --freeze-human"
    config = parse_arguments(words.split(), CoopConfig)
    assert config == dataclasses.replace(
        config_for("FeedingPR2Human-v0", CoopConfig),
        central_critic=True,
        human_policy="p.npz",
        freeze_human=True,
    )
    assert parse_arguments([], CoopConfig).env_name == "ScratchItchJacoHuman-v0"


def test_environments_that_devices_cannot_share_get_a_suggestion():
    assert resolve(PPOConfig(num_envs=64), "gpu", devices=4).devices == 4
    with pytest.raises(ConfigError, match=r"30 environments .* 4 devices.*--num-envs 32"):
        resolve(PPOConfig(num_envs=30), "gpu", devices=4)
    text = r"17 environments x 20 steps = 340 samples on each of 2 devices.* 7 mini-.*--num-mini-batch 5"
    with pytest.raises(ConfigError, match=text):
        resolve(PPOConfig(num_envs=34, num_steps=20, num_mini_batch=7), "gpu", devices=2)


def test_robots_alone_are_trained_with_the_steps_of_the_results():
    base = PPOConfig().num_env_steps
    assert config_for("ReachingJaco-v0").num_env_steps == 4_000_000
    assert config_for("ScratchItchPR2-v0").num_env_steps == 20_000_000
    assert config_for("MyTask-v0").num_env_steps == base
    for others in (
        config_for("ReachingJaco-v0", platform="cpu"),
        config_for("ReachingJaco-v0", continues=True),
        config_for("ReachingJacoHuman-v0", CoopConfig),
    ):
        assert others.num_env_steps == base
    page = (Path(__file__).parents[2] / "docs" / "seeds.md").read_text()
    table = page.partition("<!-- table:selections -->")[2].partition("<!-- /table")[0]
    rows = re.findall(r"^\| (\w+-v0)[ †]*\| 8 x ([\d.]+) M \|", table, re.MULTILINE)
    rows = [(name, 1e6 * float(steps)) for name, steps in rows if "Human" not in name]
    assert len(rows) > 20
    for name, steps in rows:
        if not name.startswith("Dressing"):  # there, candidates are the default
            assert config_for(name).num_env_steps == pytest.approx(steps, rel=0.01), name


def test_automatic_settings_depend_on_the_machine():
    assert resolve(PPOConfig(), "cpu").num_envs == 64
    config = resolve(PPOConfig(), "gpu")
    assert config.num_envs == 1024
    lines = 10_000_000 / (1024 * config.num_steps * config.log_interval)
    assert 40 < lines < 160
    assert config.save_interval % config.log_interval == 0


def test_batches_that_do_not_divide_get_a_suggestion():
    with pytest.raises(ConfigError, match=r"3 environments x 5 steps = 15.*--num-mini-batch 5"):
        resolve(PPOConfig(num_envs=3, num_steps=5, num_mini_batch=7), "cpu")


@pytest.mark.parametrize(
    "wrong", [{"num_steps": 0}, {"lr": 0.0}, {"gamma": 1.5}, {"num_env_steps": 2**33}]
)
def test_impossible_values_are_named(wrong):
    ((name, value),) = wrong.items()
    with pytest.raises(ConfigError, match=f"{name} must be .*{value}"):
        PPOConfig(**wrong)


def test_mini_batches_of_a_small_batch_are_not_too_small():
    config = config_for("FeedingJaco-v0")
    on_cpu, on_gpu = resolve(config, "cpu"), resolve(config, "gpu")
    assert on_cpu.num_envs * on_cpu.num_steps // on_cpu.num_mini_batch == 80
    assert on_gpu.num_mini_batch == config.num_mini_batch == 32


def test_advantages_are_estimated_anew_where_an_update_has_many_samples():
    config = PPOConfig()
    assert not resolve(config, "cpu").recompute_advantages
    assert resolve(config, "gpu").recompute_advantages
    for asked in (True, False):
        asking = dataclasses.replace(config, recompute_advantages=asked)
        assert {resolve(asking, x).recompute_advantages for x in ("cpu", "gpu")} == {asked}


def test_value_functions_come_first_where_a_policy_goes_on():
    def warm_up(kind, **changes):
        return resolve(kind(**changes), "cpu").value_warm_up

    assert warm_up(PPOConfig) == 0.0 and warm_up(PPOConfig, robot_policy="shipped") == 0.05
    assert warm_up(PPOConfig, robot_policy="shipped", value_warm_up=0.2) == 0.2
    assert warm_up(CoopConfig, human_policy="h.npz") == 0.05
    assert warm_up(CoopConfig, human_policy="h.npz", freeze_human=True) == 0.0
    with pytest.raises(ConfigError, match="value_warm_up must be between 0 and 1, got 2"):
        PPOConfig(value_warm_up=2.0)
    with pytest.raises(ConfigError, match=r"--robot-policy .* use agym-jax coop"):
        PPOConfig(robot_policy="shipped", allow_joint_observation=True)


@pytest.mark.parametrize("kind", [PPOConfig, CoopConfig])
def test_a_training_that_starts_from_a_policy_has_no_noise_floor_unless_it_is_asked_for(kind):
    words = ["--env-name", "DrinkingJacoHuman-v0"]
    assert parse_arguments(words, kind).noise_floor > 0
    for start in (["--robot-policy", "shipped"], ["--robot_policy=policy.npz"]):
        assert parse_arguments([*words, *start], kind).noise_floor == 0
        assert parse_arguments([*words, *start, "--noise-floor", "0.3"], kind).noise_floor == 0.3
