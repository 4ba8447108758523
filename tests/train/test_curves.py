# ruff: noqa: D103 (a test's name says what it shows)
"""Training with a fixed seed gives the learning curves that it gave before the trainer was rewritten (issue 16)."""

from __future__ import annotations

import json

import numpy as np
import pytest
from fake_env import FakeEnv
from fake_pair_env import FakePairEnv
from paths import DATA

from train import coop, ppo
from train.configs import CoopConfig, PPOConfig
from train.envs import vectorize
from train.learning.execution import StepwiseEnv

SETTINGS = {
    "num_env_steps": 640 * 6,
    "num_envs": 32,
    "num_mini_batch": 4,
    "policy_hidden": (16,),
    "value_hidden": (16,),
    "lr": 2e-3,
    "log_interval": 1,
    "save_dir": None,
    "recompute_advantages": False,
    "value_layer_norm": False,
    "clip_value_loss": True,
}
NORMAL = {"distribution": "normal"}
FADING = {
    "entropy_coef": 0.01,
    "entropy_decay_share": 0.5,
    "clip_value_loss": False,
    "reward_scaling": 0.5,
}
CASES = {
    "ppo": (ppo.train, FakeEnv, PPOConfig, {}),
    "ppo_privileged": (
        ppo.train,
        lambda: FakeEnv(privileged_obs_size=1),
        PPOConfig,
        NORMAL | FADING,
    ),
    "ppo_stepwise": (ppo.train, lambda: StepwiseEnv(vectorize(FakeEnv(), 32)), PPOConfig, {}),
    "coop": (coop.train, FakePairEnv, CoopConfig, {}),
    "coop_central": (
        coop.train,
        FakePairEnv,
        CoopConfig,
        NORMAL | {"central_critic": True, "use_linear_lr_decay": False},
    ),
}
CURVES = json.loads((DATA / "curves.json").read_text())
UNTIMED = ("seconds", "steps_per_second")


@pytest.mark.parametrize(
    "case",
    [
        pytest.param(x, marks=pytest.mark.slow) if x in ("ppo_stepwise", "coop_central") else x
        for x in CASES
    ],
)
def test_a_fixed_seed_gives_the_curve_it_always_gave(case: str):
    train, make, config, changes = CASES[case]
    curve = train(make(), config(**SETTINGS | changes)).curve
    found = {name: [row[name] for row in curve] for name in curve[0] if name not in UNTIMED}
    recorded = CURVES[case]
    assert found.keys() == recorded.keys()
    for name, values in recorded.items():
        # bit-identical on the machine that recorded them; with the vector units of other CPUs (tried:
        # --xla_cpu_max_isa=SSE4_2 and AVX2) means of terms of size 1, as losses are, differ by 1.4e-6
        ours, theirs = (np.array(x, float) for x in (found[name], values))
        np.testing.assert_allclose(ours, theirs, rtol=1e-5, atol=1e-5, err_msg=name)
