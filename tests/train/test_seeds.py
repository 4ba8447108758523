# ruff: noqa: D103 (a test's name says what it shows)
"""Several seeds in one run: each learns as it would alone, has files of its own, and harms no other."""

from __future__ import annotations

import dataclasses
import json
import subprocess

import jax
import numpy as np
import pytest
from fake_env import FakeEnv
from fake_pair_env import FakePairEnv
from paths import PROCESS_SECONDS
from train_runs import start_python

from agym_jax.policy.policy import read_policy
from train import coop, ppo
from train.configs import CoopConfig, PPOConfig
from train.envs import vectorize
from train.errors import CheckpointMismatchError, ConfigError, DivergedError
from train.learning.agents import Agents
from train.learning.execution import StepwiseEnv
from train.learning.rollout import collect, critic_obs, init_rollout
from train.learning.seeds import SideBySide, lane_keys, lanes_of
from train.runs.result import summary

SETTINGS = {
    "num_env_steps": 320 * 6,
    "num_envs": 16,
    "num_mini_batch": 4,
    "policy_hidden": (16,),
    "value_hidden": (16,),
    "lr": 2e-3,
    "log_interval": 2,
    "save_dir": None,
    "seed": 3,
}
CASES = {
    "ppo": (ppo.train, FakeEnv, PPOConfig, {}),
    "privileged": (ppo.train, lambda: FakeEnv(privileged_obs_size=1), PPOConfig, {}),
    "coop": (coop.train, FakePairEnv, CoopConfig, {"central_critic": True}),
}


def weights(policies):
    return np.concatenate([
        np.ravel(x) for p in policies.values() for x in jax.tree.leaves([p.weights, p.mean, p.std])
    ])  # fmt: skip


@pytest.mark.parametrize(
    "case", ["ppo", *(pytest.param(x, marks=pytest.mark.slow) for x in CASES if x != "ppo")]
)
def test_each_of_several_seeds_learns_as_it_would_alone(case):
    train, make, kind, changes = CASES[case]
    config = kind(**SETTINGS | changes)
    together = train(make(), dataclasses.replace(config, num_seeds=3))
    assert [found.seed for found in together.seeds] == [3, 4, 5]
    assert together.session_steps == 3 * together.env_steps == 3 * config.num_env_steps
    all_weights = [weights(found.policies) for found in together.seeds]
    assert np.abs(all_weights[0] - all_weights[1]).max() > 0.01  # they are different trainings
    for found, ours in zip(together.seeds[2:], all_weights[2:], strict=True):
        alone = train(make(), dataclasses.replace(config, seed=found.seed))
        np.testing.assert_allclose(ours, weights(alone.policies), atol=2e-4)
        for row, other in zip(found.curve, alone.curve, strict=True):
            assert row.keys() == other.keys() and row["episodes"] == other["episodes"]
            for name in ("return", "success", "force", "return_per_step"):
                assert row[name] == pytest.approx(other[name], rel=1e-3, abs=1e-4), name


@pytest.mark.slow
def test_seeds_beside_a_frozen_partner(tmp_path):
    first = coop.train(FakePairEnv(), CoopConfig(**SETTINGS | {"save_dir": str(tmp_path)}))
    frozen = {
        "robot_policy": str(tmp_path / "FakeCarryHuman-v0" / "policy.npz"),
        "freeze_robot": True,
    }
    config = CoopConfig(**SETTINGS | frozen | {"seed": 8}, num_seeds=2)
    together = coop.train(FakePairEnv(), config)
    kept = weights({"robot": first.policies["robot"]})
    humans = [weights({"human": found.policies["human"]}) for found in together.seeds]
    for found in together.seeds:
        np.testing.assert_array_equal(weights({"robot": found.policies["robot"]}), kept)
    assert np.abs(humans[0] - humans[1]).max() > 0.01
    alone = coop.train(FakePairEnv(), dataclasses.replace(config, seed=9, num_seeds=1))
    np.testing.assert_allclose(humans[1], weights({"human": alone.policies["human"]}), atol=2e-4)


def test_the_combined_curve_tells_of_all_seeds():
    result = ppo.train(FakeEnv(), PPOConfig(**SETTINGS, num_seeds=4))
    last = result.curve[-1]
    assert last["env_steps"] == 1920 and isinstance(last["env_steps"], int)
    own = [found.curve[-1]["return"] for found in result.seeds]
    assert last["num_seeds"] == 4 and last["episodes"] == sum(
        found.curve[-1]["episodes"] for found in result.seeds
    )
    assert last["return"] == pytest.approx(np.mean(np.sort(own)[1:3]))  # interquartile
    assert last["return_min"] == min(own) and last["return_max"] == max(own)
    assert min(own) <= last["return_low"] <= last["return"] <= last["return_high"] <= max(own)


def test_files_of_each_seed_and_a_run_resumed_whole(tmp_path):
    config = PPOConfig(**SETTINGS | {"save_dir": str(tmp_path)}, num_seeds=2)
    stop = lambda row, policy: row["env_steps"] >= 960  # noqa: E731
    first = ppo.train(FakeEnv(), config, on_log=stop)
    assert first.interrupted and first.env_steps < config.num_env_steps
    second = ppo.train(FakeEnv(), config)
    assert second.env_steps == config.num_env_steps
    assert second.session_steps == 2 * (second.env_steps - first.env_steps)
    assert "agym-jax select" not in summary(first)  # it is not finished
    folder = tmp_path / "FakeReach-v0"
    assert summary(second).endswith(
        f"policy: {folder / 'seed_N'}\nChoose a seed: agym-jax select {folder}"
    )
    assert (folder / "curve.png").stat().st_size > 10_000 and not (folder / "policy.npz").exists()
    for found in second.seeds:
        rows = (folder / found.name / "curve.jsonl").read_text().splitlines()
        steps = [json.loads(row)["env_steps"] for row in rows]
        assert steps == [row["env_steps"] for row in found.curve] == [640, 1280, 1920]
        policy = read_policy(folder / found.name / "policy.npz")
        assert policy.info["seed"] == found.seed and policy.info["env_steps"] == 1920
        np.testing.assert_array_equal(weights({"robot": policy}), weights(found.policies))
    for name in ("policy.npz", "selection.jsonl"):  # one is chosen, and all are trained further
        (folder / name).write_text("chosen")
    ppo.train(FakeEnv(), config)  # not further: it stays
    assert (folder / "policy.npz").read_text() == "chosen"
    combined = (folder / "curve.jsonl").read_text().splitlines()
    assert [json.loads(row)["num_seeds"] for row in combined] == [2, 2, 2]
    with pytest.raises(
        CheckpointMismatchError,
        match=r"it is of 2 trainings \(seed_3, seed_4\), this run of 3 trainings",
    ):
        ppo.train(FakeEnv(), dataclasses.replace(config, num_seeds=3, num_env_steps=9_600))
    with pytest.raises(
        CheckpointMismatchError, match=r"2 trainings \(seed_3, seed_4\), this run of 2 .*seed_5"
    ):
        ppo.train(FakeEnv(), dataclasses.replace(config, seed=5, num_env_steps=9_600))
    with pytest.raises(
        CheckpointMismatchError, match=r"of 2 trainings \(.*\), this run of 1 training\."
    ):
        ppo.train(FakeEnv(), dataclasses.replace(config, num_seeds=1, num_env_steps=9_600))
    assert (folder / "policy.npz").read_text() == "chosen"
    ppo.train(FakeEnv(), dataclasses.replace(config, num_env_steps=2_560))
    assert not (folder / "policy.npz").exists() and not (folder / "selection.jsonl").exists()
    aside = {path.name for path in (folder / "chosen_at_step_1920").iterdir()}
    assert aside == {"policy.npz", "selection.jsonl"}


def spoil(monkeypatch, *lost):
    """Give some of the seeds a learning rate with which every loss is NaN."""
    plain = SideBySide.hyper

    def hyper(self, total_steps):
        found = plain(self, total_steps)
        found.lr[list(lost)] = np.nan
        return found

    monkeypatch.setattr(SideBySide, "hyper", hyper)


@pytest.mark.slow
def test_a_seed_that_diverges_is_stopped_and_harms_no_other(monkeypatch, tmp_path):
    config = PPOConfig(**SETTINGS | {"save_dir": str(tmp_path)}, num_seeds=3)
    sound = ppo.train(FakeEnv(), dataclasses.replace(config, save_dir=None))
    spoil(monkeypatch, 1)
    result = ppo.train(FakeEnv(), config)
    stopped = [found.stopped for found in result.seeds]
    assert "loss/" in stopped[1] and "not finite" in stopped[1] and stopped[0] == stopped[2] == ""
    assert not result.seeds[1].curve and result.curve[-1]["num_seeds"] == 2
    assert np.isfinite(weights(result.seeds[1].policies)).all()
    for i in (0, 2):
        np.testing.assert_array_equal(
            weights(result.seeds[i].policies), weights(sound.seeds[i].policies)
        )
    longer = dataclasses.replace(config, num_env_steps=320 * 8)
    again = ppo.train(FakeEnv(), longer)  # a resumed run knows who was stopped
    assert [bool(found.stopped) for found in again.seeds] == [False, True, False]


def test_if_all_seeds_diverge_the_run_stops(monkeypatch):
    spoil(monkeypatch, 0, 1)
    with pytest.raises(DivergedError, match="diverged before step 640: loss/"):
        ppo.train(FakeEnv(), PPOConfig(**SETTINGS, num_seeds=2))


@pytest.mark.slow
def test_stepwise_environments_take_several_seeds_too():
    venv = StepwiseEnv(vectorize(FakeEnv(), 32))
    by_steps = ppo.train(venv, PPOConfig(**SETTINGS, num_seeds=2))
    at_once = ppo.train(FakeEnv(), PPOConfig(**SETTINGS, num_seeds=2))
    for ours, theirs in zip(by_steps.seeds, at_once.seeds, strict=True):
        np.testing.assert_allclose(weights(ours.policies), weights(theirs.policies), atol=2e-4)


def test_less_than_one_seed_is_refused():
    with pytest.raises(ConfigError, match="num_seeds must be at least 1, got 0"):
        PPOConfig(num_seeds=0)


LARGE = """
import jax
from fake_env import FakeEnv
from train.configs import PPOConfig
from train.learning.agents import Agents
from train.learning.seeds import SideBySide, lane_keys, lanes_of

config = PPOConfig(num_seeds=2, policy_hidden=(512, 256, 128), value_hidden=(512, 512))
lanes = lanes_of(config)
agents = SideBySide(Agents(config, FakeEnv(), ("robot",)), lanes)
jax.block_until_ready(jax.jit(agents.init)(lane_keys(lanes)))
print("begun")
"""


@pytest.mark.slow
def test_large_networks_of_several_seeds_begin_on_a_small_cpu():
    process = start_python(LARGE, stdout=subprocess.PIPE)
    try:  # where factorisations of all seeds ran at once, this never ended on two cores
        assert process.communicate(timeout=PROCESS_SECONDS / 4)[0].split() == ["begun"]
    finally:
        process.kill()


@pytest.mark.parametrize(("others", "conditionals"), [({}, 1), ({"recompute_advantages": True}, 0)])
def test_seeds_of_the_same_settings_share_a_conditional(others, conditionals):
    """A conditional that is one for each seed would compute both of its branches."""
    config = PPOConfig(**SETTINGS, num_seeds=2, recompute_advantages=False)
    first, second = lanes_of(config)
    second = dataclasses.replace(second, config=dataclasses.replace(config, **others))
    env = FakeEnv()
    agents = SideBySide(Agents(config, env, ("robot",)), [first, second])
    venv = vectorize(env, 2 * config.num_envs)
    keys = lane_keys([first, second])

    def learn(learner, hyper):
        rollout = init_rollout(venv, keys, True)
        rollout, batch, _ = collect(
            lambda obs, key: agents.act(learner, obs, key), venv, rollout, keys,
            num_steps=4, gamma=0.9, reward_scaling=1.0,
        )  # fmt: skip
        return agents.learn(learner, batch, critic_obs(rollout.env_state), keys, hyper)

    traced = jax.make_jaxpr(learn)(jax.eval_shape(agents.init, keys), agents.hyper(1000))
    assert str(traced).count("cond[") == conditionals
