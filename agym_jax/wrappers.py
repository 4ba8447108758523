"""Batches of environments with auto-reset: every finished episode is followed by one with another person."""

from __future__ import annotations

import dataclasses
import os
from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from agym_jax.errors import ActionError, ArgumentError, checked_count
from agym_jax.jax_settings import enable_compilation_cache
from agym_jax.sim.arguments import check_key
from agym_jax.sim.physics import check_traceable
from agym_jax.state import State, begun, moved, raw_key

MAX_RESET_INTERVAL = 25
"""Control steps. Not a multiple of the 20 steps of a rollout, so that rollouts begin at different times of an episode."""


def available_cores() -> int:
    """Return the number of CPU cores that this process may use; where the system does not tell (macOS, Windows), of all."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def shared_reset_interval(episode_length: int) -> int:
    """Return the largest divisor of an episode length up to ``MAX_RESET_INTERVAL`` and half of it: many episodes end at the same step, not all."""
    longest = min(episode_length // 2, MAX_RESET_INTERVAL)
    return max((n for n in range(2, longest + 1) if episode_length % n == 0), default=1)


class VectorEnv:
    """A batch of copies of one environment; ``reset`` and ``step`` are pure functions.

    When an episode ends, ``step`` returns the first observation of the next episode in ``obs``, and the last
    observation of the old one in ``info["final_observation"]``. ``info["truncation"]`` is 1.0 where an episode
    ended: at its length, as all of Assistive Gym's do, or because the simulation diverged (``metrics["nan"]``). After a
    divergence, the final observation is the one before that step. If a divergence counted as a termination, which is
    worth 0, it would spare a policy the negative rewards that follow, and policies learn to cause it. If the
    task has a ``privileged_obs``, the state's corresponds to ``obs``, and ``info["final_privileged_obs"]`` to
    ``final_observation``.
    """

    def __init__(self, env: Any, num_envs: int):
        checked_count("num_envs", num_envs)
        self.env = env.sized_for(num_envs)
        self.num_envs = num_envs
        self.name = env.name
        self.episode_length = env.episode_length

    def __getattr__(self, name: str) -> Any:
        if name == "env":
            raise AttributeError(name)
        return getattr(self.env, name)

    @property
    def observation_size(self) -> int:
        """Length of one environment's observation."""
        return self.env.observation_size

    @property
    def action_size(self) -> int:
        """Length of one environment's action."""
        return self.env.action_size

    def reset(self, key: Array) -> Any:
        """Begin an episode in every environment.

        Args:
            key: one PRNG key, or one for each environment.

        Raises:
            ArgumentError: if it is neither a single key nor one key for each environment.
        """
        check_key(key, self.name, self.num_envs)
        one = key.ndim == (0 if jnp.issubdtype(key.dtype, jax.dtypes.prng_key) else 1)
        keys = jax.random.split(key, self.num_envs) if one else key
        state = jax.vmap(self.env.reset)(keys)
        info = _final(state) | {"truncation": jnp.zeros(self.num_envs)}
        return state.replace(info=info)

    def step(self, state: Any, action: Array) -> Any:
        """Advance every environment by one control step.

        Args:
            state: state of the batch.
            action: (num_envs, action_size).

        Raises:
            ActionError: if the action has a different shape.
            ArgumentError: if the state does not belong to this batch.
        """
        self._check_shapes(state, action)
        info = state.info
        state = jax.vmap(self.env.step)(state.replace(info={}), action)
        finished = state.done > 0
        info = info | _final(state) | {"truncation": finished.astype(jnp.float32)}
        state = jax.lax.cond(
            jnp.any(finished),
            lambda s: jax.vmap(self.env.reset_where)(s, finished),
            lambda s: s,
            state,
        )
        return state.replace(info=info)

    def _check_shapes(self, state: Any, action: Any) -> None:
        if np.shape(action) != (self.num_envs, self.action_size):
            raise ActionError(
                f"{self.name} in a batch of {self.num_envs} takes actions of shape "
                f"({self.num_envs}, {self.action_size}), got {np.shape(action)}."
            )
        if np.shape(state.obs)[:-1] != (self.num_envs,):
            raise ArgumentError(
                f"{self.name} in a batch of {self.num_envs} can only step states of that batch, got one with observations of "
                f"shape {np.shape(state.obs)}. Use the states that its own reset and step return."
            )

    def stagger(self, state: Any, key: Array, interval: int | None = None) -> Any:
        """Set the environments' clocks to random phases of an episode, so that episodes do not all end together.

        Args:
            state: state of the batch.
            key: PRNG key, typed or raw, or n keys for n equal parts of the batch.
            interval: steps between two phases, a divisor of the episode length; by default ``reset_interval``. Episodes end in
                one of so many steps only, and the program of a reset, which runs for the whole batch, is skipped in the others
                (except after a failure of the physics, which ends an episode at any step).
        """
        key, interval = raw_key(key), interval or self.reset_interval
        phases = self.episode_length // interval

        def draw(key: Array, count: int) -> Array:
            return interval * jax.random.randint(key, (count,), 0, phases, jnp.int32)

        if key.ndim == 1:
            step = draw(key, self.num_envs)
        else:
            each = self.num_envs // len(key)
            step = jax.vmap(lambda one: draw(one, each))(key).reshape(-1)
        return state.replace(episode=dataclasses.replace(state.episode, step=step))

    @property
    def reset_interval(self) -> int:
        """Steps between the phases of ``stagger``; see ``shared_reset_interval``."""
        return shared_reset_interval(self.episode_length)


class NativeVectorEnv(VectorEnv):
    """A batch on C MuJoCo (``impl="native"``): like ``VectorEnv``, but multi-threaded, in NumPy, and not traceable.

    Args:
        env: environment made with ``impl="native"``.
        num_envs: number of environments.
        num_threads: number of threads that step them; by default one per CPU core. It affects only the speed.
    """

    def __init__(self, env: Any, num_envs: int, num_threads: int | None = None):
        super().__init__(env, num_envs)
        if num_threads is not None:
            checked_count("num_threads", num_threads)
        wanted = num_threads or available_cores()
        physics = env.physics
        count = -(-num_envs // physics.rows[1])  # slots
        count = min(num_envs, -(-count // wanted) * wanted)
        ends = [num_envs * i // count for i in range(count + 1)]
        self.num_threads = min(wanted, count)
        self._slots = [(physics.slot(num_envs), slice(a, b)) for a, b in pairwise(ends)]
        self._pool = ThreadPoolExecutor(self.num_threads, thread_name_prefix="agym_jax")

    @property
    def reset_interval(self) -> int:
        """Always 1: an environment that ends is reset alone."""
        return 1

    def reset(self, key: Array) -> Any:
        """Begin an episode in every environment; see ``VectorEnv.reset``."""
        check_key(key, self.name, self.num_envs)
        check_traceable(self.env.physics, key)
        key = raw_key(key)
        keys = np.asarray(jax.random.split(key, self.num_envs) if key.ndim == 1 else key)

        def reset(slot: Any, part: slice) -> dict[str, Any]:
            with slot.lock:
                return self.env.native_rows.reset(slot, keys[part])

        state = State(info={}, **_joined(self._pool.map(reset, *zip(*self._slots, strict=True))))
        info = _final(state) | {"truncation": np.zeros(self.num_envs, np.float32)}
        return state.replace(info=info)

    def step(self, state: Any, action: Any) -> Any:
        """Advance every environment by one control step; see ``VectorEnv.step``."""
        check_traceable(self.env.physics, state.obs, action)
        self._check_shapes(state, action)
        action, rows = np.asarray(action, np.float32), self.env.native_rows

        def step(slot: Any, part: slice) -> tuple[dict[str, Any], Any]:
            with slot.lock:
                fields = rows.step(slot, state, part, action[part])
                finished = np.flatnonzero(fields["done"] > 0)
                if not len(finished):
                    return fields, None
                keys, keys_next = rows.split(slot, np.asarray(state.key[part])[finished])
                fresh = rows.reset(slot, keys, finished) | {"key": keys_next}
                return fields, (finished + part.start, fresh)

        steps, resets = zip(*self._pool.map(step, *zip(*self._slots, strict=True)), strict=True)
        state = moved(state, _joined(steps))
        truncation = (state.done > 0).astype(np.float32)
        info = state.info | _final(state) | {"truncation": truncation}
        return begun(state, [x for x in resets if x]).replace(info=info)


def _joined(parts: Any) -> Any:
    """Concatenate the fields of the slots into those of the batch."""
    return jax.tree.map(lambda *x: np.concatenate(x), *parts)


def _final(state: Any) -> dict[str, Array]:
    """Return the observations at the end of a step, before any reset."""
    final = {"final_observation": state.obs}
    privileged = state.privileged_obs
    return final if privileged is None else final | {"final_privileged_obs": privileged}


def vectorize(env: Any, num_envs: int) -> VectorEnv:
    """Make a batch of ``num_envs`` copies of an environment, with auto-reset.

    Raises:
        ArgumentError: if ``env`` is not an environment, or ``num_envs`` is not a whole number of at least 1.
    """
    if not hasattr(env, "sized_for"):
        made = f": agym_jax.make({env!r}) makes one" if isinstance(env, str) else ""
        raise ArgumentError(f"vectorize takes an environment{made}; got {env!r}.")
    enable_compilation_cache()
    native = getattr(env, "native_rows", None) is not None
    return NativeVectorEnv(env, num_envs) if native else VectorEnv(env, num_envs)
