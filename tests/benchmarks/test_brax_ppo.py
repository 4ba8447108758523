# ruff: noqa: D103
"""Brax's PPO and ours are compared with the same settings, on the same humans, and evaluating costs no time."""

from __future__ import annotations

import json
import time
from types import SimpleNamespace
from typing import Any

import jax
import numpy as np
import pytest
from fake_env import FakeEnv, FakeState

from agym_jax.state import select
from benchmarks import brax_ppo, training_tables
from benchmarks.brax_ppo import BraxPPOConfig, Curve, measure, settings
from train.configs import PPOConfig, config_for
from train.evaluate import Evaluator

SMALL = BraxPPOConfig(num_env_steps=6400, num_envs=16, points=2, episodes=8, reward_scaling=0.1)


class RestartingEnv(FakeEnv):
    """The fake environment with what Brax's adapter asks for besides."""

    impl = "jax"

    def reset_where(self, state: FakeState, where: jax.Array) -> FakeState:
        """A new episode where it holds."""
        kept = {name: getattr(state, name) for name in ("reward", "done", "metrics", "info")}
        return select(where, self._first(state.key).replace(**kept), state)


def test_brax_gets_the_settings_of_train_ppo():
    config = BraxPPOConfig(num_envs=2048)
    brax, same, shipped = (settings(config, "ScratchItchJaco-v0", who) for who in ("brax", "same", "shipped"))  # fmt: skip
    assert brax == same != shipped
    theirs = config_for("ScratchItchJaco-v0", PPOConfig)
    for name in ("lr", "gamma", "gae_lambda", "ppo_epoch", "num_steps", "policy_hidden"):
        assert getattr(same, name) == getattr(shipped, name) == getattr(theirs, name)
    assert shipped.normalize_reward and not same.normalize_reward
    assert same.num_envs % same.num_mini_batch == 0  # Brax's mini-batches are of whole rollouts


def test_evaluating_is_no_training_time():
    found = SimpleNamespace(success=0.5, returns=np.zeros(2), nan=np.zeros(2), overflow=0)

    def evaluator(policy: Any, key: Any) -> Any:
        time.sleep(0.2)
        return found

    curve = Curve(evaluator, jax.random.PRNGKey(0))  # type: ignore[arg-type]
    begin = time.perf_counter()
    for steps in (1, 2, 3):
        curve.measure(steps, lambda: None)  # type: ignore[arg-type, return-value]
    assert time.perf_counter() - begin - curve.seconds() > 0.59
    assert [point["env_steps"] for point in curve.points] == [1, 2, 3]


@pytest.mark.slow
@pytest.mark.parametrize("trainer", ["brax", "same"])
def test_a_training_leaves_a_curve(trainer: brax_ppo.Trainer):
    env = RestartingEnv()
    line = json.loads(json.dumps(measure(SMALL, env, Evaluator(env, SMALL.episodes), trainer)))
    curve = line["curve"]
    assert curve["env_steps"] == [3200, 6400] and line["steps"] == 6400
    assert np.isfinite(curve["return"]).all() and len(set(curve["return"])) == 2
    assert 0 < curve["seconds"][0] < curve["seconds"][1] == line["train_s"]
    assert line["compile_s"] > 0 and line["trainer"] == trainer


def test_table_and_picture_show_steps_and_seconds(tmp_path):
    curve = {
        "env_steps": [100_000, 200_000, 300_000, 400_000],
        "seconds": [10.0, 20.0, 30.0, 40.0],
        "success": [0.1, 0.5, 0.95, 1.0],
    }
    about = {"commit": "0123456789", "device": {"kind": "Some GPU"}, "overflow": 0, "nan": 0}
    line = about | {
        "env": "ReachingJaco-v0", "trainer": "brax", "steps": 400_000, "episodes": 500, "curve": curve,
        "steps_to_90": 300_000, "seconds_to_90": 30.0, "steps_per_s": 10_000, "compile_s": 12.0,
    }  # fmt: skip
    never = line | {"trainer": "shipped", "steps_to_90": None, "seconds_to_90": None}
    (tmp_path / "brax_ppo.jsonl").write_text("\n".join(map(json.dumps, (never, line))))
    rows = training_tables.brax_ppo(tmp_path).splitlines()
    assert (
        "| ReachingJaco-v0 | Brax PPO | 0.4 M | 10% | 50% | 95% | 100% | 0.3 M, 30 s |" in rows[2]
    )
    assert "not reached" in rows[3] and "500 episodes" in rows[-1]
    brax_ppo.draw([line, never], tmp_path / "curves.png")
    assert (tmp_path / "curves.png").stat().st_size > 5000
