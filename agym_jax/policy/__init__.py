"""Policies: load a shipped or trained one, and run it.

policy = load_policy("ScratchItchJaco-v0")
action = policy(state.obs)
"""

import agym_jax.compat.mjx_print  # noqa: F401 (before Brax, which imports MJX)
from agym_jax.policy.agents import Baseline, Pair, baseline_policy
from agym_jax.policy.check import check_policy
from agym_jax.policy.files import load_policy
from agym_jax.policy.policy import Policy, save_policy

__all__ = [
    "Baseline",
    "Pair",
    "Policy",
    "baseline_policy",
    "check_policy",
    "load_policy",
    "save_policy",
]
