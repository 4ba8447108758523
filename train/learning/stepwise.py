"""One compiled environment step for everything: evaluation and training driven from Python.

Compiling the environment takes a minute on a CPU, and a program of many updates (``train.learning.update``)
or of whole episodes (``train.evaluate``) contains it anew. Here reset and step of a batch are
compiled once and called again and again, which costs nothing where a step takes milliseconds.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp

from agym_jax.policy.agents import AnyPolicy

from ..configs import LearnConfig
from ..errors import ConfigError
from ..evaluation.score import EvaluationResult, add_step, result_of, zero_sums
from .algorithm import Algorithm
from .rollout import (
    RolloutState,
    critic_obs,
    init_rollout,
    record_step,
    strong_types,
    zero_totals,
)


class StepwiseEnv:
    """A vectorised environment whose ``reset`` and ``step`` are compiled programs.

    Args:
        venv: vectorised, auto-resetting environment.
    """

    def __init__(self, venv: Any) -> None:
        self.venv, self.num_envs = venv, venv.num_envs
        reset = jax.jit(lambda key: strong_types(venv.reset(key)))
        lowered_reset = reset.lower(jax.random.PRNGKey(0))
        state = lowered_reset.out_info
        action = jax.ShapeDtypeStruct((venv.num_envs, venv.action_size), jnp.float32)
        step = jax.jit(lambda state, action: strong_types(venv.step(state, action)))
        lowered_step = step.lower(jax.tree.map(_aval, state), action)
        with ThreadPoolExecutor(2) as pool:
            futures = [pool.submit(x.compile) for x in (lowered_step, lowered_reset)]
            self.step, self.reset = (future.result() for future in futures)

    def vectorize(self, num_envs: int) -> StepwiseEnv:
        """Itself: the batch size is compiled in.

        Raises:
            ConfigError: another number of environments was asked for.
        """
        if num_envs != self.num_envs:
            raise ConfigError(
                f"This StepwiseEnv is compiled for {self.num_envs} environments, not {num_envs}. Set "
                f"num_processes={self.num_envs}, or make another StepwiseEnv."
            )
        return self

    def __getattr__(self, name: str) -> Any:
        if name == "venv":
            raise AttributeError(name)
        return getattr(self.venv if hasattr(self.venv, name) else self.venv.env, name)


def _aval(leaf: Any) -> jax.ShapeDtypeStruct:
    return jax.ShapeDtypeStruct(leaf.shape, leaf.dtype)


def start_stepwise(
    venv: StepwiseEnv, config: LearnConfig, algorithm: Algorithm, key: jax.Array
) -> tuple[RolloutState, Callable]:
    """Environments at their start, and ``run`` as from ``train.learning.update.make_updates``.

    Args:
        venv: the environment.
        config: resolved settings.
        algorithm: how to learn; its programs compile when called.
        key: random key of the environments.
    """
    act = jax.jit(algorithm.act)
    note = jax.jit(partial(record_step, gamma=config.gamma, reward_scaling=config.reward_scaling))
    improve = jax.jit(algorithm.learn)

    def run(
        learner: Any, rollout_state: RolloutState, count: jax.Array, total_steps: jax.Array
    ) -> tuple[Any, RolloutState, dict[str, jax.Array]]:
        totals = zero_totals(rollout_state.env_state)
        lost = {f"loss/{name}": jnp.zeros(()) for name in algorithm.losses}
        for _ in range(int(count)):
            key, key_rollout, key_learn = jax.random.split(learner.key, 3)
            batches = []
            for key_step in jax.random.split(key_rollout, config.num_steps):
                action, raw, log_prob = act(learner, rollout_state.env_state.obs, key_step)
                after = venv.step(rollout_state.env_state, action)
                rollout_state, totals, batch = note(rollout_state, totals, raw, log_prob, after)
                batches.append(batch)
            learner, losses = improve(
                replace(learner, key=key),
                jax.tree.map(lambda *leaves: jnp.stack(leaves), *batches),
                critic_obs(rollout_state.env_state),
                key_learn,
                total_steps,
            )
            lost = {name: lost[name] + losses[name.removeprefix("loss/")] for name in lost}
        return learner, rollout_state, totals | lost

    return init_rollout(venv, key, config.stagger), run


def evaluate_stepwise(
    venv: StepwiseEnv,
    policy: AnyPolicy,
    key: jax.Array,
    watch: Callable[[Any], None] | None = None,
) -> EvaluationResult:
    """One episode of each environment with the policy's mode, as ``train.evaluate.Evaluator`` does.

    Args:
        venv: the environment.
        policy: a ``Policy``, or a function like one.
        key: decides the episodes.
        watch: is shown the state of all environments, before the first step and after each.
    """
    start = time.perf_counter()
    act = jax.jit(lambda obs, key: policy(obs, key, True))
    add = jax.jit(add_step)
    key_reset, key_steps = jax.random.split(key)
    state, sums = venv.reset(key_reset), zero_sums(venv.num_envs)
    going = jnp.ones(venv.num_envs, jnp.float32)
    watch = watch or (lambda state: None)
    watch(state)
    for key_step in jax.random.split(key_steps, venv.episode_length):
        state = venv.step(state, act(state.obs, key_step))
        going, sums = add(going, sums, state)
        watch(state)
    return result_of(venv.name, jax.device_get(sums), time.perf_counter() - start)
