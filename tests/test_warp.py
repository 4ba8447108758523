"""Both implementations of MJX mean the same. Needs warp-lang, which runs on the CPU too (slowly)."""

# ruff: noqa: D103
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import agym_jax
from agym_jax.wrappers import vectorize

pytestmark = pytest.mark.warp
N = 4


def rollout(impl: str, steps: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Observations, rewards and overflow flags of a few worlds under the same actions."""
    worlds = vectorize(agym_jax.make("ScratchItchJaco-v0", impl=impl), N)
    state = jax.jit(worlds.reset)(jax.random.PRNGKey(0))
    step = jax.jit(worlds.step)
    rows = []
    for i in range(steps):
        action = jax.random.uniform(jax.random.PRNGKey(i), (N, 7), minval=-1.0, maxval=1.0)
        state = step(state, jnp.asarray(action))
        rows.append((state.obs, state.reward, state.metrics["overflow"]))
    return tuple(np.array(x) for x in zip(*rows, strict=True))  # type: ignore[return-value]


def test_warp_and_jax_give_the_same_trajectory():
    pytest.importorskip("warp", reason="warp-lang is an extra: pip install 'agym_jax[warp]'")
    obs, reward, overflow = rollout("warp", 10)
    obs_jax, reward_jax, _ = rollout("jax", 10)
    # both integrate in float32; free motion agrees far better than contact would
    np.testing.assert_allclose(obs, obs_jax, atol=2e-3)
    np.testing.assert_allclose(reward, reward_jax, atol=2e-3)
    assert not overflow.any()
