"""Running episodes with a policy and summing what they score: one loop for every implementation of the physics.

In a batch, all episodes run side by side in one compiled program, or step by step where the environment is compiled
(``StepwiseEnv``). C MuJoCo (``impl="native"``) steps one environment, so its episodes run one after another.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from agym_jax.policy.agents import TREES, AnyPolicy

from ..envs import jit_functions, vectorize
from ..learning.execution import ONE_PROGRAM, STEPWISE, Execution, StepwiseEnv
from .score import EvaluationResult, add_step, result_of, zero_sums

Watch = Callable[[Any], None]


@dataclass(frozen=True)
class SingleEnv:
    """An environment of C MuJoCo as a batch of one; a finished episode is not followed by another."""

    env: Any
    reset: Callable[[jax.Array], Any]
    step: Callable[[Any, jax.Array], Any]
    num_envs: int = 1


def run_episodes(
    venv: Any,
    act: Callable[[jax.Array, jax.Array], jax.Array],
    key: jax.Array,
    episode_length: int,
    execution: Execution,
    watch: Watch | None = None,
) -> dict[str, jax.Array]:
    """Sums over the first episode of each environment.

    Args:
        venv: environments, as a batch.
        act: (observation, key) -> action.
        key: decides the episodes, and what a policy samples.
        episode_length: control steps.
        execution: how the loop runs.
        watch: is shown the state of all environments, before the first step and after each; from Python only.
    """
    key_reset, key_steps = jax.random.split(key)
    add = execution.compile(add_step)

    def step(carry: tuple, key: jax.Array) -> tuple[tuple, None]:
        state, going, sums = carry
        state = venv.step(state, act(state.obs, key))
        going, sums = add(going, sums, state)
        if watch:
            watch(state)
        return (state, going, sums), None

    first = venv.reset(key_reset)
    if watch:
        watch(first)
    start = (first, jnp.ones(venv.num_envs, jnp.float32), zero_sums(first, venv.num_envs))
    (_, _, sums), _ = execution.scan(step, start, jax.random.split(key_steps, episode_length))
    return sums


class Evaluator:
    """Runs a fixed number of episodes; compiles once for all policies of one architecture.

    Args:
        env: an environment (``agym_jax.make``), or a ``StepwiseEnv``.
        num_episodes: how many.
    """

    def __init__(self, env: Any, num_episodes: int) -> None:
        self.env, self.num_episodes = env, num_episodes
        self._native = getattr(env, "impl", None) == "native"
        if self._native:
            self._venv: Any = SingleEnv(env, *jit_functions(env))
        else:
            self._venv = vectorize(env, num_episodes)
        stepwise = self._native or isinstance(self._venv, StepwiseEnv)
        self._execution = STEPWISE if stepwise else ONE_PROGRAM
        self._run_policy = jax.jit(self._run, static_argnames="deterministic")
        self._run_function = jax.jit(self._run, static_argnames=("policy", "deterministic"))

    def __call__(
        self,
        policy: AnyPolicy,
        key: jax.Array,
        deterministic: bool = True,
        watch: Watch | None = None,
    ) -> EvaluationResult:
        """Run the episodes.

        Args:
            policy: a ``Policy``, a ``Pair`` of them, or a function
                ``(obs, key, deterministic) -> action``.
            key: decides the episodes (and the samples of a policy that is not deterministic).
            deterministic: take the mode of the policy's distribution.
            watch: see ``run_episodes``; with a ``StepwiseEnv``.
        """
        start = time.perf_counter()
        if self._execution is STEPWISE:
            sums = self._from_python(policy, key, deterministic, watch)
        else:
            run = self._run_policy if isinstance(policy, TREES) else self._run_function
            sums = jax.device_get(run(policy=policy, key=key, deterministic=deterministic))
        return result_of(self.env, sums, time.perf_counter() - start)

    def _run(self, policy: Any, key: jax.Array, deterministic: bool) -> dict[str, jax.Array]:
        act = lambda obs, key: policy(obs, key, deterministic)  # noqa: E731
        return run_episodes(self._venv, act, key, self.env.episode_length, ONE_PROGRAM)

    def _from_python(
        self, policy: AnyPolicy, key: jax.Array, deterministic: bool, watch: Watch | None
    ) -> dict[str, np.ndarray]:
        """Episodes of a batch at once, those of C MuJoCo one after another."""
        act = jax.jit(lambda obs, key: policy(obs, key, deterministic))
        keys = jax.random.split(key, self.num_episodes) if self._native else key[None]
        found = []
        for number, key_episode in enumerate(keys):
            length = self.env.episode_length
            sums = run_episodes(self._venv, act, key_episode, length, STEPWISE, watch)
            found.append(jax.device_get(sums))
            if self._native and sys.stderr.isatty():
                print(f"\r{number + 1}/{len(keys)} episodes", end="", file=sys.stderr, flush=True)
        if self._native and sys.stderr.isatty():
            print("\r", end="", file=sys.stderr)
        return {name: np.concatenate([part[name] for part in found]) for name in found[0]}
