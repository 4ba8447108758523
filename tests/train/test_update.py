# ruff: noqa: D103 (a test's name says what it shows)
"""Hyper-parameters are arguments of the compiled update."""

from __future__ import annotations

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from fake_env import FakeEnv
from train_runs import same_bytes

from train.configs import PPOConfig
from train.learning.agents import Agents
from train.learning.ppo import Hyper
from train.learning.rollout import init_rollout
from train.learning.update import make_updates

CONFIG = PPOConfig(
    num_envs=4, num_steps=10, num_mini_batch=2, policy_hidden=(8,), value_hidden=(8,),
    distribution="normal", entropy_coef=0.01, save_dir=None,
)  # fmt: skip
OTHERS = {
    "lr": 1e-2,
    "use_linear_lr_decay": not CONFIG.use_linear_lr_decay,
    "gamma": 0.5,
    "gae_lambda": 0.5,
    "clip_param": 0.01,
    "value_loss_coef": 2.0,
    "entropy_coef": 0.1,
    "entropy_decay_share": 0.9,
    "max_grad_norm": 1e-3,
    "eps": 1e-2,
    "reward_scaling": 0.01,
    "noise_floor": 2.0,
    "noise_ceiling": 0.1,
    "value_warm_up": 0.5,
}
STEPS = 400  # of the run, of which a few are made


@pytest.fixture(scope="module")
def program():
    """An environment, the compiled update, and what it starts from."""
    env = FakeEnv()
    venv, agents = env.vectorize(CONFIG.num_envs), Agents(CONFIG, env, ("robot",))
    learner = jax.jit(agents.init)(jax.random.PRNGKey(0))
    rollout = jax.jit(lambda key: init_rollout(venv, key, True))(jax.random.PRNGKey(1))
    return env, jax.jit(make_updates(venv, CONFIG, agents)), learner, rollout


def test_another_hyper_parameter_compiles_nothing_and_changes_what_is_learned(program):
    env, run, learner, rollout = program

    def learned(config, steps=STEPS):
        after, _, _ = run(learner, rollout, jnp.int32(3), Hyper.of(config, steps))
        return after.agents["robot"].params

    before = learned(CONFIG)
    for name, value in OTHERS.items():
        assert not same_bytes(before, learned(dataclasses.replace(CONFIG, **{name: value}))), name
    assert not same_bytes(before, learned(CONFIG, 2 * STEPS)), "length of the run"
    bounded = dataclasses.replace(CONFIG, noise_ceiling=OTHERS["noise_ceiling"])
    late = dataclasses.replace(bounded, noise_ceiling_from=0.5)
    assert not same_bytes(learned(bounded), learned(late)), "noise_ceiling_from"
    assert same_bytes(before, learned(CONFIG))
    assert env.traces == {"reset": 1, "step": 1} and run._cache_size() == 1


def test_the_program_of_another_configuration_is_the_same(program):
    _, _, learner, rollout = program

    def text(**changes):
        config, env = dataclasses.replace(CONFIG, **changes), FakeEnv()
        agents = Agents(config, env, ("robot",))
        run = make_updates(env.vectorize(CONFIG.num_envs), config, agents)
        return jax.jit(run).lower(learner, rollout, np.int32(1), Hyper.of(config, 1)).as_text()

    plain = text()
    assert text(**OTHERS, num_env_steps=123_456, seed=9) == plain
    assert text(ppo_epoch=3) != plain


def test_before_the_value_function_is_warm_the_policy_stays_as_it_is(program):
    _, run, learner, rollout = program

    def learned(share):
        hyper = Hyper.of(dataclasses.replace(CONFIG, value_warm_up=share), STEPS)
        return run(learner, rollout, jnp.int32(3), hyper)[0].agents["robot"].params

    before, warming, past = learner.agents["robot"].params, learned(0.5), learned(0.1)
    assert same_bytes(warming.policy, before.policy) and not same_bytes(warming.value, before.value)
    assert not same_bytes(past.policy, before.policy)
