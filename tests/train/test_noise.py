# ruff: noqa: D103 (a test's name says what it shows)
"""The bounds of the exploration noise."""

from __future__ import annotations

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from fake_env import FakeEnv

from agym_jax.policy.networks import Architecture, init_policy, make_networks
from train.configs import PPOConfig, config_for
from train.continued import NOISE_BOUNDS
from train.errors import ConfigError
from train.learning.agents import Agents
from train.learning.noise import keep_noise, log_ceiling, log_floor
from train.task_changes import TASK_CHANGES


@pytest.mark.parametrize(("progress", "floor"), [(0.0, 0.4), (0.5, 0.4), (0.75, 0.2), (1.0, 1e-6)])
def test_the_floor_holds_for_half_of_the_run_and_falls_to_zero(progress, floor):
    assert math.exp(float(log_floor(0.4, jnp.float32(progress)))) == pytest.approx(floor, rel=1e-4)


def test_only_deviations_below_the_floor_are_changed():
    arch = Architecture(3, 2, (4,), (4,), "elu", "normal", 0.2, 0.01)
    policy = init_policy(make_networks(arch), arch, jax.random.PRNGKey(0))
    before = policy["params"]["std_logparam"]["log_value"]
    kept = keep_noise(policy, 0.5, 0.0, 0.0, jnp.float32(0.1))["params"]
    np.testing.assert_allclose(np.exp(kept["std_logparam"]["log_value"]), 0.5, rtol=1e-6)
    rest = {name: layer for name, layer in kept.items() if name != "std_logparam"}
    assert all(rest[name] is policy["params"][name] for name in rest) and len(rest) == 2
    for floor in (0.0, 0.1):
        same = keep_noise(policy, floor, 0.0, 0.0, jnp.float32(0.1))["params"]["std_logparam"]
        np.testing.assert_array_equal(same["log_value"], before)


@pytest.mark.parametrize(("progress", "ceiling"), [(0.0, 1.0), (0.5, 0.1), (1.0, 0.01)])
def test_the_ceiling_falls_by_equal_factors_over_the_run(progress, ceiling):
    bound = math.exp(float(log_ceiling(0.01, 0.0, jnp.float32(progress))))
    assert bound == pytest.approx(ceiling, rel=1e-4)
    assert log_ceiling(0.0, 0.0, jnp.float32(progress)) == jnp.inf


@pytest.mark.parametrize(
    ("progress", "ceiling"), [(0.0, 1.0), (0.6, 1.0), (0.8, 0.1), (1.0, 0.01), (1.01, 0.01)]
)
def test_before_its_share_of_the_run_the_ceiling_is_1(progress, ceiling):
    bound = math.exp(float(log_ceiling(0.01, jnp.float32(0.6), jnp.float32(progress))))
    assert bound == pytest.approx(ceiling, rel=1e-4)


def test_only_deviations_above_the_ceiling_are_changed_and_it_wins_over_the_floor():
    policy = {"params": {"std_logparam": {"log_value": jnp.log(jnp.array([0.05, 0.3, 2.0]))}}}

    def kept(*bounds):
        log_value = keep_noise(policy, *bounds, jnp.float32(0.5))["params"]["std_logparam"]
        return np.exp(log_value["log_value"])

    np.testing.assert_allclose(kept(0.0, 0.04, 0.0), [0.05, 0.2, 0.2], rtol=1e-5)
    np.testing.assert_allclose(kept(0.0, 0.0, 0.0), [0.05, 0.3, 2.0], rtol=1e-5)
    np.testing.assert_allclose(kept(0.4, 0.04, 0.0), 0.2, rtol=1e-5)


@pytest.mark.parametrize(
    "settings", [{"noise_ceiling": 1.5}, {"noise_ceiling": 0.2, "noise_ceiling_from": 1.0}]
)
def test_a_ceiling_that_could_not_fall_is_refused(settings):
    with pytest.raises(ConfigError, match="noise_ceiling must be at most 1"):
        PPOConfig(**settings, distribution="normal")


def test_a_training_that_starts_from_a_policy_has_no_bounds_of_its_own():
    for task, changes in TASK_CHANGES.items():
        config = config_for(f"{task}Jaco-v0", continues=True)
        assert [getattr(config, name) for name in NOISE_BOUNDS] == [0.0, 0.0, 0.0], changes


@pytest.mark.parametrize("name", ["noise_floor", "noise_ceiling"])
def test_a_deviation_that_depends_on_the_observation_has_no_bounds(name):
    with pytest.raises(ConfigError, match=rf"{name} .* --distribution normal; tanh_normal"):
        PPOConfig(**{name: 0.1}, distribution="tanh_normal")


@pytest.mark.parametrize("clips", [True, False])
def test_the_environment_takes_what_was_sampled_or_its_nearest_action(clips):
    config = PPOConfig(distribution="normal", init_noise_std=4.0, clip_actions=clips)
    agents = Agents(config, FakeEnv(), ("robot",))
    learner = agents.init(jax.random.PRNGKey(0))
    action, raw, _ = agents.act(learner, jnp.zeros((64, 4)), jax.random.PRNGKey(1))
    assert np.abs(raw).max() > 4
    np.testing.assert_array_equal(action, np.clip(raw, -1, 1) if clips else raw)
