# ruff: noqa: D103 (a test's name says what it shows)
"""The pace of policies that training starts from."""

from __future__ import annotations

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from fake_env import FakeEnv
from fake_pair_env import FakePairEnv

from agym_jax.policy.policy import save_policy
from train.configs import CoopConfig, PPOConfig, resolve
from train.learning.agents import Agents
from train.learning.pace import FASTER, LEAST, SLOWER, START, next_pace
from train.learning.ppo import Hyper
from train.learning.rollout import init_rollout
from train.learning.update import make_updates
from train.sweep import parse_grid, sweep

TARGET = 0.01
CONFIG = PPOConfig(
    num_envs=8, num_steps=40, num_mini_batch=4, ppo_epoch=4, policy_hidden=(16,), value_hidden=(16,),
    distribution="normal", init_noise_std=0.05, lr=2e-2, use_linear_lr_decay=False, value_warm_up=0.0,
    save_dir=None,
)  # fmt: skip


@pytest.mark.parametrize(
    ("kl", "pace"),
    [(TARGET, 0.1), (4 * TARGET / 2.25, 0.075), (100 * TARGET, 0.1 * SLOWER), (0.0, 0.1 * FASTER)],
)
def test_the_pace_follows_the_root_of_the_divergence_within_bounds(kl, pace):
    assert next_pace(jnp.float32(0.1), jnp.float32(kl), TARGET) == pytest.approx(pace)


def test_the_pace_is_at_most_1_and_never_0_and_1_without_a_target():
    assert next_pace(jnp.float32(0.9), jnp.float32(0.0), TARGET) == 1.0
    assert next_pace(jnp.float32(LEAST), jnp.float32(1.0), TARGET) == pytest.approx(LEAST)
    assert next_pace(jnp.float32(0.1), jnp.float32(1.0), 0.0) == 1.0


@pytest.fixture(scope="module")
def start(tmp_path_factory):
    """File of a policy with little noise, from which training starts."""
    agents = Agents(CONFIG, FakeEnv(), ("robot",))
    policy = agents.policies(jax.jit(agents.init)(jax.random.PRNGKey(3)), {"env": "FakeReach-v0"})
    path = tmp_path_factory.mktemp("pace") / "policy.npz"
    save_policy(path, policy["robot"])
    return str(path)


def divergences(start, target, updates=30):
    """Divergence and pace of each update of a training that starts from the policy."""
    config = dataclasses.replace(CONFIG, robot_policy=start, target_kl=target)
    env = FakeEnv()
    venv, agents = env.vectorize(config.num_envs), Agents(config, env, ("robot",))
    learner = jax.jit(agents.init)(jax.random.PRNGKey(0))
    rollout = jax.jit(lambda key: init_rollout(venv, key, True))(jax.random.PRNGKey(1))
    run, found, paces = jax.jit(make_updates(venv, config, agents)), [], []
    for _ in range(updates):
        learner, rollout, totals = run(learner, rollout, jnp.int32(1), Hyper.of(config, 1e6))
        found.append(float(totals["loss/kl"]))
        paces.append(learner.agents["robot"].pace)
    return np.array(found), paces


def test_updates_change_a_policy_with_little_noise_as_much_as_is_wanted(start):
    free, no_pace = divergences(start, 0.0, updates=5)
    paced, paces = divergences(start, TARGET)
    assert no_pace[-1] is None and free.max() > 10 * TARGET
    assert paced.max() < 3 * TARGET
    assert TARGET / 4 < np.median(paced[-15:]) < 1.5 * TARGET
    assert float(paces[0]) != START and all(LEAST <= pace <= 1 for pace in paces)


def test_without_a_target_nothing_changes_and_new_policies_have_no_pace(start):
    config = resolve(dataclasses.replace(CONFIG, robot_policy=start, target_kl=0.0), "cpu")
    learner = jax.jit(Agents(config, FakeEnv(), ("robot",)).init)(jax.random.PRNGKey(0))
    assert learner.agents["robot"].pace is None
    pair = CoopConfig(
        policy_hidden=(4,),
        value_hidden=(4,),
        human_policy=None,
        robot_policy=None,
        target_kl=TARGET,
    )
    learner = jax.jit(Agents(pair, FakePairEnv(), ("robot", "human")).init)(jax.random.PRNGKey(0))
    assert {agent.pace for agent in learner.agents.values()} == {None}


def test_a_sweep_compares_paces(start):
    config = dataclasses.replace(CONFIG, robot_policy=start, num_env_steps=320 * 10, log_interval=5)
    settings = parse_grid([f"target_kl=0,{TARGET}"])
    free, paced = sweep(FakeEnv(), config, settings, 1).seeds
    ends = [[row["loss/kl"] for row in found.curve][-1] for found in (free, paced)]
    assert free.name == "target_kl=0/seed_1" and ends[0] > 3 * ends[1] > 0
