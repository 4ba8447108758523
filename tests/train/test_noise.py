# ruff: noqa: D103 (a test's name says what it shows)
"""The bounds of the exploration noise."""

from __future__ import annotations

import dataclasses
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from brax.training.acme import running_statistics

from agym_jax.policy.networks import Architecture, init_policy, make_networks, sample_action
from train.configs import PPOConfig
from train.errors import ConfigError
from train.learning.noise import Noise

NORMAL = PPOConfig(distribution="normal", init_noise_std=1.0)


def bounds(progress: float, **settings: float) -> tuple[float, float]:
    low, high = Noise.of(dataclasses.replace(NORMAL, **settings)).at(jnp.float32(progress))
    return math.exp(float(low)), math.exp(float(high))


@pytest.mark.parametrize(("progress", "floor"), [(0.0, 0.4), (0.5, 0.4), (0.75, 0.2), (1.0, 1e-6)])
def test_the_floor_holds_for_half_of_the_run_and_falls_to_zero(progress, floor):
    low, high = bounds(progress, noise_floor=0.4)
    assert low == pytest.approx(floor, rel=1e-4) and high == math.inf


@pytest.mark.parametrize(
    ("progress", "ceiling"),
    [(0.0, math.inf), (0.4, math.inf), (0.6, 0.5), (0.8, 0.25), (1.0, 0.25)],
)
def test_the_ceiling_falls_in_equal_factors(progress, ceiling):
    assert bounds(progress, noise_end=0.25)[1] == pytest.approx(ceiling, rel=1e-4)


def test_where_floor_and_ceiling_cross_the_ceiling_counts():
    low, high = bounds(0.8, noise_floor=0.9, noise_end=0.1)
    assert low == high == pytest.approx(0.1, rel=1e-4)


def test_only_deviations_outside_of_the_bounds_are_changed():
    arch = Architecture(3, 2, (4,), (4,), "elu", "normal", 0.2, 0.01)
    policy = init_policy(make_networks(arch), arch, jax.random.PRNGKey(0))
    noise = Noise.of(dataclasses.replace(NORMAL, noise_floor=0.5))
    kept = noise.keep(policy, jnp.float32(0.1))["params"]
    np.testing.assert_allclose(np.exp(kept["std_logparam"]["log_value"]), 0.5, rtol=1e-6)
    rest = {name: layer for name, layer in kept.items() if name != "std_logparam"}
    assert all(rest[name] is policy["params"][name] for name in rest) and len(rest) == 2
    without = Noise.of(NORMAL).keep(policy, jnp.float32(0.9))["params"]["std_logparam"]
    np.testing.assert_array_equal(
        without["log_value"], policy["params"]["std_logparam"]["log_value"]
    )


def test_a_deviation_that_depends_on_the_observation_has_no_bounds():
    with pytest.raises(ConfigError, match=r"noise_floor .* --distribution normal; tanh_normal"):
        PPOConfig(noise_floor=0.1, distribution="tanh_normal")


@pytest.mark.parametrize("share", [0.0, 0.6, 1.0])
def test_a_share_of_the_noise_lasts_and_each_action_is_distributed_as_before(share):
    arch = Architecture(3, 2, (4,), (4,), "elu", "normal", 0.2, 0.01)
    networks, obs = make_networks(arch), jnp.zeros((20_000, 3))
    normalizer = running_statistics.init_state(jnp.zeros(3))
    policy = init_policy(networks, arch, jax.random.PRNGKey(0))

    def raw(key: int, held):
        drawn = sample_action(networks, normalizer, policy, obs, jax.random.PRNGKey(key), held)
        return np.asarray(drawn[1])

    held = jax.random.PRNGKey(9), jnp.float32(share)
    one, two = raw(1, held), raw(2, held)
    assert one.std() == pytest.approx(0.2, rel=0.02)
    assert np.corrcoef(one.ravel(), two.ravel())[0, 1] == pytest.approx(share, abs=0.02)
    if share == 0:
        np.testing.assert_array_equal(one, raw(1, None))
