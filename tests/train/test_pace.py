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

from agym_jax.policy.policy import read_policy, save_policy
from train.configs import CoopConfig, PPOConfig
from train.errors import CheckpointMismatchError
from train.learning.agents import Agents
from train.learning.pace import FASTER, LEAST, SLOWER, START, next_pace
from train.learning.ppo import Hyper
from train.learning.rollout import init_rollout
from train.learning.update import make_updates
from train.ppo import train
from train.sweep import parse_grid, sweep

TARGET = 0.01
PAIR = ("robot", "human")
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


def test_the_pace_is_at_most_1_and_never_0():
    assert next_pace(jnp.float32(0.9), jnp.float32(0.0), TARGET) == 1.0
    assert next_pace(jnp.float32(LEAST), jnp.float32(1.0), TARGET) == pytest.approx(LEAST)


@pytest.fixture(scope="module")
def start(tmp_path_factory):
    """File of a policy with little noise, from which training starts."""
    agents = Agents(CONFIG, FakeEnv(), ("robot",))
    policy = agents.policies(jax.jit(agents.init)(jax.random.PRNGKey(3)), {"env": "FakeReach-v0"})
    path = tmp_path_factory.mktemp("pace") / "policy.npz"
    save_policy(path, policy["robot"])
    return str(path)


def divergences(start, target, updates=30, **changes):
    """Divergence and pace of each update of a training that starts from the policy."""
    config = dataclasses.replace(CONFIG, robot_policy=start, target_kl=target, **changes)
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
    assert START * SLOWER <= paces[0] <= START * FASTER * 1.001 and paces[0] != pytest.approx(START)


def pace_of(agents):
    """The agents' paces at the start."""
    learner = jax.jit(agents.init)(jax.random.PRNGKey(0))
    return {name: agent.pace for name, agent in learner.agents.items()}


def test_only_a_policy_that_training_starts_from_and_changes_has_a_pace(start, tmp_path):
    untargeted = dataclasses.replace(CONFIG, robot_policy=start, target_kl=0.0)
    assert pace_of(Agents(untargeted, FakeEnv(), ("robot",))) == {"robot": None}
    pair = CoopConfig(policy_hidden=(4,), value_hidden=(4,), target_kl=TARGET)
    new = Agents(pair, FakePairEnv(), PAIR)
    assert pace_of(new) == {"robot": None, "human": None}
    begun = jax.jit(new.init)(jax.random.PRNGKey(1))
    robot = new.policies(begun, {"env": FakePairEnv().name})["robot"]
    path = str(save_policy(tmp_path / "robot.npz", robot))
    goes_on = Agents(dataclasses.replace(pair, robot_policy=path), FakePairEnv(), PAIR)
    paces = pace_of(goes_on)
    assert paces["robot"] == pytest.approx(START) and paces["human"] is None
    frozen = dataclasses.replace(pair, robot_policy=path, freeze_robot=True)
    assert pace_of(Agents(frozen, FakePairEnv(), PAIR)) == {"robot": None, "human": None}
    told = goes_on.compatibility()
    assert told["robot.target_kl"] == "adapts" and told["human.target_kl"] is None


def test_while_the_value_function_warms_up_the_pace_waits(start):
    found, paces = divergences(start, TARGET, updates=3, value_warm_up=1.0)
    assert found == pytest.approx(0.0, abs=1e-6) and paces[-1] == pytest.approx(START)


def test_a_run_is_resumed_with_its_pace_and_not_without(start, tmp_path):
    config = dataclasses.replace(
        CONFIG, robot_policy=start, target_kl=TARGET, num_env_steps=320 * 4, save_dir=str(tmp_path)
    )
    train(FakeEnv(), config)
    longer = dataclasses.replace(config, num_env_steps=320 * 6)
    with pytest.raises(CheckpointMismatchError, match=r"robot\.target_kl is 'adapts'"):
        train(FakeEnv(), dataclasses.replace(longer, target_kl=0.0))
    assert train(FakeEnv(), longer).session_steps == 320 * 2


def test_a_sweep_compares_paces(start):
    config = dataclasses.replace(CONFIG, robot_policy=start, num_env_steps=320 * 3, log_interval=1)
    settings = parse_grid([f"target_kl=0,{TARGET}"])
    free, paced = sweep(FakeEnv(), config, settings, 1).seeds
    assert free.name == "target_kl=0/seed_1"
    alone = [train(FakeEnv(), dataclasses.replace(config, **x)).policy for x in settings]
    before = read_policy(start)

    def apart(policy, other):
        both = zip(jax.tree.leaves(policy.weights), jax.tree.leaves(other.weights), strict=True)
        return max(float(abs(x - y).max()) for x, y in both)

    for seed, policy in zip((free, paced), alone, strict=True):
        assert apart(seed.policies["robot"], policy) < 0.1 * apart(policy, before)
    assert apart(alone[1], before) < 0.2 * apart(alone[0], before)
