"""Evaluation of one environment after another, for physics that JAX cannot batch: C MuJoCo.

Only the parts around the physics are compiled, in seconds.
"""

from __future__ import annotations

import sys
import time
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from agym_jax.policy.agents import AnyPolicy

from ..envs import jit_functions
from .score import EvaluationResult, add_step, result_of, zero_sums


def evaluate_alone(
    env: Any, policy: AnyPolicy, num_episodes: int, key: jax.Array, deterministic: bool = True
) -> EvaluationResult:
    """As ``train.evaluate.Evaluator``, one episode after the other.

    Args:
        env: an environment of one environment.
        policy: a ``Policy``, a ``Pair`` of them, or a function ``(obs, key, deterministic) -> action``.
        num_episodes: how many.
        key: decides the episodes (and the samples of a policy that is not deterministic).
        deterministic: take the mode of the policy's distribution.
    """
    start = time.perf_counter()
    reset, step = jit_functions(env)
    act = jax.jit(lambda obs, key: policy(obs, key, deterministic))
    add = jax.jit(add_step)
    found = []
    for number, key_episode in enumerate(jax.random.split(key, num_episodes)):
        key_reset, key_steps = jax.random.split(key_episode)
        state, going, sums = reset(key_reset), jnp.ones(1), zero_sums(1)
        for key_step in jax.random.split(key_steps, env.episode_length):
            state = step(state, act(state.obs, key_step))
            going, sums = add(going, sums, state)
            if state.done > 0:
                break
        found.append(jax.device_get(sums))
        if sys.stderr.isatty():
            print(f"\r{number + 1}/{num_episodes} episodes", end="", file=sys.stderr, flush=True)
    if sys.stderr.isatty():
        print("\r", end="", file=sys.stderr)
    sums = {name: np.concatenate([part[name] for part in found]) for name in found[0]}
    return result_of(env.name, sums, time.perf_counter() - start)
