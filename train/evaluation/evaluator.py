"""Running episodes with a policy and summing their scores: one loop for every physics implementation.

All episodes run in parallel in one compiled program, or step by step if the environment is compiled separately
(``StepwiseEnv``). On C MuJoCo (``impl="native"``) they run step by step, in batches, each with its own key.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from agym_jax.policy.agents import TREES, AnyPolicy

from ..envs import is_native, vectorize
from ..learning.execution import ONE_PROGRAM, STEPWISE, Execution, execution_of
from ..learning.rollout import Observed, split_keys
from .people import people_in
from .score import EvaluationResult, add_step, result_of, zero_sums

Watch = Callable[[Any], None]


AT_ONCE = 64
"""Number of episodes that C MuJoCo runs in parallel."""


def run_episodes(
    venv: Any,
    act: Callable[[jax.Array, jax.Array], jax.Array],
    key: jax.Array,
    episode_length: int,
    execution: Execution,
    watch: Watch | None = None,
) -> dict[str, jax.Array]:
    """Run the first episode of each environment; return sums over its steps, and its person.

    Args:
        venv: batch of environments.
        act: (observation, key) -> action.
        key: determines the episodes and the policy's samples (2,); or one key for each environment (B, 2).
        episode_length: control steps per episode.
        execution: how the loop runs.
        watch: called with the state of all environments before the first step and after each step; from Python only.
    """
    key_reset, key_steps = split_keys(key)
    add = execution.compile(add_step)

    def step(carry: tuple, key: jax.Array) -> tuple[tuple, None]:
        state, going, sums = carry
        state = venv.step(state, act(state.obs, key))
        going, sums = add(going, sums, Observed.of(state))
        if watch:
            watch(state)
        return (state, going, sums), None

    first = venv.reset(key_reset)
    if watch:
        watch(first)
    start = (first, jnp.ones(venv.num_envs, jnp.float32), zero_sums(first, venv.num_envs))
    (_, _, sums), _ = execution.scan(step, start, split_keys(key_steps, episode_length))
    return sums | people_in(first)


class Evaluator:
    """Runs a fixed number of episodes; compiles only once for all policies with the same architecture.

    Args:
        env: an environment (``agym_jax.make``), or a ``StepwiseEnv``.
        num_episodes: number of episodes.
        at_once: number of episodes run in parallel on C MuJoCo.
    """

    def __init__(self, env: Any, num_episodes: int, at_once: int = AT_ONCE) -> None:
        self.env, self.num_episodes = env, num_episodes
        self._native = is_native(env)
        at_once = min(num_episodes, at_once) if self._native else num_episodes
        self._venv = vectorize(env, at_once)
        self._execution = STEPWISE if self._native else execution_of(self._venv)
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
            key: determines the episodes (and the samples of a policy that is not deterministic).
            deterministic: act by the mode of the policy's distribution.
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
        """Run the episodes in a single batch, or on C MuJoCo batch by batch."""
        act = lambda obs, key: policy(obs, key, deterministic)  # noqa: E731
        length = self.env.episode_length
        if not self._native:
            return jax.device_get(
                run_episodes(self._venv, jax.jit(act), key, length, STEPWISE, watch)
            )
        act, found = jax.jit(jax.vmap(act)), []
        keys, at_once = jax.random.split(key, self.num_episodes), self._venv.num_envs
        for start in range(0, self.num_episodes, at_once):
            part = keys[start : start + at_once]
            venv = self._venv if len(part) == at_once else vectorize(self.env, len(part))
            found.append(jax.device_get(run_episodes(venv, act, part, length, STEPWISE, watch)))
            if sys.stderr.isatty():
                done = f"{start + len(part)}/{self.num_episodes}"
                print(f"\r{done} episodes", end="", file=sys.stderr, flush=True)
        if sys.stderr.isatty():
            print("\r", end="", file=sys.stderr)
        return {name: np.concatenate([part[name] for part in found]) for name in found[0]}
