# ruff: noqa: D103 (a test's name says what it shows)
"""Learning under a cost limit: the cost, the controller, and training on a finger that is paid for pressing."""

from __future__ import annotations

import dataclasses
import json

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from fake_env import FakeEnv
from fake_press_env import FakePairPressEnv, FakePressEnv
from train_runs import check_restored, listening

from train import coop, ppo
from train.configs import CoopConfig, PPOConfig, parse_arguments
from train.envs import vectorize
from train.errors import CheckpointMismatchError, ConfigError
from train.evaluate import Evaluator
from train.learning.agents import Agents
from train.learning.constraint import (
    ConstraintHyper,
    ConstraintState,
    Penalty,
    control,
    penalised,
    step_cost,
)
from train.learning.execution import StepwiseEnv
from train.learning.ppo import Hyper
from train.sweep import parse_grid, rank, sweep, table

SETTINGS = {
    "num_env_steps": 320 * 60,
    "num_envs": 16,
    "num_mini_batch": 4,
    "policy_hidden": (16,),
    "value_hidden": (16,),
    "value_layer_norm": False,  # with it, four seeds end with 20 N, as they begin; without it, with 22 to 33
    "distribution": "normal",
    "init_noise_std": 0.3,
    "lr": 3e-3,
    "log_interval": 4,
    "save_dir": None,
    "cost_tighten_from": 0.0,  # there is nothing to be learned first
    "cost_tighten_until": 0.0,
    "cost_multiplier_max": 100.0,
}
SHORT = SETTINGS | {"num_env_steps": 320 * 6, "log_interval": 2}
LIMIT = 2.0  # of 40, where the finger presses as hard as it can


def mean_of(curve, name, rows=4):
    """Mean of the last rows of a curve."""
    return np.mean([row[name] for row in curve[-rows:]])


def test_cost_is_1_above_the_limit_and_up_to_1_more_for_how_far():
    share = jnp.array([0.0, 0.99, 1.0, 1.0001, 1.5, 2.0, 9.0])
    np.testing.assert_allclose(step_cost(share), [0, 0, 0, 1.0001, 1.5, 2, 2], rtol=1e-6)


def test_with_a_margin_costs_begin_below_the_limit():
    share = jnp.array([0.0, 0.5, 0.75, 0.9, 1.0, 1.0001, 2.0])
    expected = [0, 0, 0, 0.6, 1, 1.0001, 2]
    np.testing.assert_allclose(step_cost(share, 0.25), expected, rtol=1e-5, atol=1e-6)


def state_at(cost=-1.0, integral=0.0):
    zero = jnp.zeros(())
    return ConstraintState(None, (), zero + cost, zero + integral, zero)


def test_multiplier_rises_above_the_limit_falls_below_it_and_rests_at_it():
    hyper = ConstraintHyper(2.0, 200.0, 0.0, 0.1, 0.0, 0.0, 0.0, 9.0)
    _, above, multiplier = control(state_at(), jnp.float32(6.0), hyper)
    assert float(above) == pytest.approx(0.1 * 0.5)  # (6 - 2) / (6 + 2)
    assert float(multiplier) == pytest.approx(9.0 * 0.1 * 0.5)  # that share of the largest
    _, below, _ = control(state_at(integral=1.0), jnp.float32(0.0), hyper)
    assert float(below) == pytest.approx(0.9)  # as far down as it ever goes in one update
    cost, rests, _ = control(state_at(2.0, 1.0), jnp.float32(2.0), hyper)
    assert (float(cost), float(rests)) == (2.0, 1.0)
    _, most, multiplier = control(state_at(integral=1.0), jnp.float32(60.0), hyper)
    assert (float(most), float(multiplier)) == (1.0, 9.0)
    _, floor, multiplier = control(state_at(integral=0.0), jnp.float32(0.5), hyper)
    assert float(floor) == float(multiplier) == 0.0
    _, error_of_none, _ = control(
        state_at(), jnp.float32(0.0), dataclasses.replace(hyper, limit=0.0)
    )
    assert float(error_of_none) == 0.0


def test_the_limit_is_tightened_during_the_run():
    hyper = ConstraintHyper(0.5, 200.0, 1.0, 1.0, 0.0, 0.2, 0.6, 9.0)
    at = lambda share: float(hyper.limit_at(jnp.float32(share)))  # noqa: E731
    assert at(0.0) == at(0.2) == pytest.approx(200.0) and at(0.6) == at(1.0) == 0.5
    assert at(0.4) == pytest.approx(10.0, rel=1e-3)  # by equal factors
    early = control(state_at(), jnp.float32(20.0), hyper, jnp.float32(0.1))
    late = control(state_at(), jnp.float32(20.0), hyper, jnp.float32(0.5))
    assert float(early[2]) == 0.0 < float(late[2])
    for limit in (0.0, 1e6):  # none at all is no number of factors; and one above what can be
        odd = dataclasses.replace(hyper, limit=limit)
        shares = [float(odd.limit_at(jnp.float32(x))) for x in (0.0, 0.4, 0.6)]
        assert np.isfinite(shares).all() and shares[-1] == limit


def test_proportional_and_derivative_parts_answer_to_the_smoothed_cost():
    hyper = ConstraintHyper(1.0, 200.0, 2.0, 0.0, 0.0, 0.0, 0.0, 1.0)
    cost, _, multiplier = control(state_at(1.0), jnp.float32(11.0), hyper)
    assert float(cost) == pytest.approx(2.0)  # a tenth of the way
    assert float(multiplier) == pytest.approx(2.0 / 3.0)
    hyper = ConstraintHyper(1.0, 200.0, 0.0, 0.0, 3.0, 0.0, 0.0, 1.0)
    _, _, rising = control(state_at(1.0), jnp.float32(11.0), hyper)
    assert float(rising) == pytest.approx(1.0)  # 3 / 3
    _, _, falling = control(state_at(11.0), jnp.float32(1.0), hyper)
    assert float(falling) == 0.0


def test_advantages_are_those_of_the_reward_less_those_of_the_cost():
    rng = np.random.default_rng(0)
    reward, cost = (jnp.asarray(x, jnp.float32) for x in rng.normal(size=(2, 50, 40)))
    assert penalised(reward, None) is reward
    np.testing.assert_array_equal(penalised(reward, Penalty(cost, jnp.float32(0.0))), reward)
    both = penalised(reward, Penalty(cost, jnp.float32(3.0)))
    np.testing.assert_allclose(both, reward - 3 * cost, rtol=1e-6)


@pytest.fixture(scope="module")
def runs():
    """Training with and without a limit."""
    config = PPOConfig(**SETTINGS)
    return (
        ppo.train(FakePressEnv(), config),
        ppo.train(FakePressEnv(), dataclasses.replace(config, cost_limit=LIMIT, num_seeds=2)),
    )


@pytest.mark.slow
def test_without_a_limit_the_finger_presses_harder_and_harder(runs):
    free, _ = runs
    last = free.curve[-1]
    assert last["force"] > 24.0 and last["gentle"] == 0.0 and last["success"] == 1.0
    assert "multiplier" not in last and "cost" not in last
    assert free.learner.agents["robot"].constraint is None


@pytest.mark.slow
def test_with_a_limit_the_cost_comes_down_to_it_and_the_task_is_still_done(runs):
    _, limited = runs
    for found in limited.seeds:
        curve = found.curve
        assert curve[0]["cost"] > 4 * LIMIT  # at first it does not matter
        assert mean_of(curve, "cost") < 2 * LIMIT
        assert max(row["multiplier"] for row in curve) > 0.3
        assert curve[-1]["success"] > 0.95 and mean_of(curve, "force") > 10.0
        result = Evaluator(FakePressEnv(), 50)(found.policies["robot"], jax.random.PRNGKey(0))
        assert result.gentle_success > 0.9 and result.forces.mean() > 10.0
    a, b = (x.curve[-1]["multiplier"] for x in limited.seeds)
    assert a != b  # each has a controller of its own


@pytest.mark.slow
def test_each_of_several_seeds_learns_as_it_would_alone():
    config = PPOConfig(**SHORT, cost_limit=LIMIT)
    together = ppo.train(FakePressEnv(), dataclasses.replace(config, num_seeds=2))
    alone = ppo.train(FakePressEnv(), dataclasses.replace(config, seed=2))
    for row, other in zip(together.seeds[1].curve, alone.curve, strict=True):
        for name in ("cost", "multiplier", "gentle", "peak", "loss/cost_value_loss"):
            assert row[name] == pytest.approx(other[name], rel=1e-3, abs=1e-4), name


@pytest.mark.slow
def test_stepwise_environments_learn_the_same():
    config = PPOConfig(**SHORT, cost_limit=LIMIT)
    at_once = ppo.train(FakePressEnv(), config)
    by_steps = ppo.train(StepwiseEnv(vectorize(FakePressEnv(), 16)), config)
    for row, other in zip(at_once.curve, by_steps.curve, strict=True):
        assert row["cost"] == pytest.approx(other["cost"], rel=1e-4)
        assert row["multiplier"] == pytest.approx(other["multiplier"], rel=1e-4)


@pytest.mark.slow
def test_robot_and_person_learn_under_one_limit():
    config = CoopConfig(**SETTINGS | {"num_env_steps": 320 * 40}, cost_limit=LIMIT)
    result = coop.train(FakePairPressEnv(), config)
    first, last = result.curve[0], result.curve[-1]
    assert first["cost"] > 4 * LIMIT and mean_of(result.curve, "cost") < 2.5 * LIMIT
    assert max(row["multiplier"] for row in result.curve) > 0 and last["force"] > 8.0
    assert {"loss/robot/cost_value_loss", "loss/human/cost_value_loss"} <= last.keys()
    states = [agent.constraint for agent in result.learner.agents.values()]
    assert float(states[0].multiplier) == float(states[1].multiplier)


def test_a_restored_learner_goes_on_with_its_multiplier(tmp_path):
    env, config = FakePressEnv(), PPOConfig(**SHORT, cost_limit=0.1)
    restored = check_restored(env, config, Agents(config, env, ("robot",)), tmp_path)
    constraint = restored.agents["robot"].constraint
    assert float(constraint.multiplier) > 0 and float(constraint.cost) > 0


def test_a_run_goes_on_with_another_limit_but_not_with_none(tmp_path):
    config = PPOConfig(**SHORT | {"save_dir": str(tmp_path)}, cost_limit=LIMIT)
    ppo.train(FakePressEnv(), config)
    row = json.loads((tmp_path / "FakePress-v0" / "curve.jsonl").read_text().splitlines()[-1])
    assert row["multiplier"] > 0 and row["cost"] > 0
    longer = dataclasses.replace(config, num_env_steps=320 * 8)
    with pytest.raises(CheckpointMismatchError, match="constrained is True, this run has None"):
        ppo.train(FakePressEnv(), dataclasses.replace(longer, cost_limit=None))
    progress, said = listening()
    other = ppo.train(FakePressEnv(), dataclasses.replace(longer, cost_limit=1.0), progress)
    assert other.env_steps == 320 * 8 and any("cost_limit is now 1.0" in x for x in said)
    assert "cost " in said[-1] and "multiplier " in said[-1] and "gentle " in said[-1]


@pytest.mark.slow
def test_a_sweep_of_limits_shows_what_gentleness_costs():
    settings = parse_grid(["cost_limit=0.5,1e6"])
    result = sweep(FakePressEnv(), PPOConfig(**SETTINGS), settings, 2)
    ranked = {x["setting"]["cost_limit"]: x for x in rank(result, settings, 2)}
    assert ranked[0.5]["gentle_iqm"] > 0.3 > ranked[1e6]["gentle_iqm"]
    assert ranked[0.5]["peak_iqm"] < 22.0 < ranked[1e6]["peak_iqm"]
    assert result.seeds[2].curve[-1]["multiplier"] == 0.0  # what is never reached is no limit
    assert "gentle" in table(list(ranked.values()))


def test_limits_compile_nothing_anew():
    config = PPOConfig(**SHORT)
    assert Hyper.of(config, 100, 20).constraint is None
    a, b = (Hyper.of(dataclasses.replace(config, cost_limit=x), 100, 20) for x in (0.1, 3.0))
    assert (
        jax.tree.structure(a) == jax.tree.structure(b) and a.constraint.limit != b.constraint.limit
    )
    assert all(x.dtype == np.float32 for x in jax.tree.leaves(a))


def test_what_cannot_work_is_refused():
    with pytest.raises(ConfigError, match="cost_limit must be at least 0 and finite, got -1"):
        PPOConfig(cost_limit=-1.0)
    with pytest.raises(ConfigError, match="cost_integral must be at least 0 and finite, got inf"):
        PPOConfig(cost_integral=np.inf)
    with pytest.raises(ConfigError, match=r"--cost-limit .*does not measure.*force/of_comfort"):
        ppo.train(FakeEnv(), PPOConfig(**SHORT, cost_limit=1.0))
    words = ["--env-name", "ReachingJaco-v0", "--cost-limit", "0.05", "--cost-integral", "0.1"]
    for kind in (PPOConfig, CoopConfig):
        config = parse_arguments(words, kind)
        assert (config.cost_limit, config.cost_integral) == (0.05, 0.1)
    assert parse_arguments(words[:2]).cost_limit is None
