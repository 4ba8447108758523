"""Collecting experience: steps of all environments, with episode totals kept on the device."""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import jax
import jax.numpy as jnp

from agym_jax.state import strong

from .execution import ONE_PROGRAM, Execution

FORCE_KEY, PEAK_KEY = "force/on_human", "force/peak_on_human"
COMFORT_KEY, LIMIT_KEY = "force/of_comfort", "force/of_limit"
EPISODE_TOTALS = ("episodes", "return", "return_squared", "success", "force", "length")
GENTLE_TOTALS = ("episode/gentle", "episode/peak", "step/force/over_comfort")
"""Of environments that measure ``COMFORT_KEY``."""
REMEMBERED, RESTARTED = "restarts", "restarted"
"""Entries of ``info`` of environments with restarts: what they remember, which is not recorded, and 1.0 where the present
episode began in the middle of another (B,)."""
BEYOND = 0x0E57
"""Folded into a key of which ``split`` makes others: ``fold_in`` of a small number would be one of these."""
ACT, ENV_STEP = "act", "env_step"
"""Scopes of the policy and of the environment's step, in the names of operations (``benchmarks.training_profile``)."""
Totals = dict[str, jax.Array]
Record = Callable[..., tuple[Any, Totals, Any]]


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class RolloutState:
    """The environments and what their current episodes have gathered. Not saved in checkpoints."""

    env_state: Any  # batched state of the environment
    discounted: jax.Array  # discounted return so far, scaled reward    (B,)
    episode_return: jax.Array  # (B,)
    episode_force: jax.Array  # sum over steps of the force on the person [N]    (B,)
    episode_peak: jax.Array  # largest force on a region of the body so far [N]    (B,)
    episode_harsh: jax.Array  # steps so far in which it was above the comfort limit    (B,)
    episode_length: jax.Array  # steps so far    (B,)
    counted: jax.Array  # 1 where the episode was seen from its start, which was a new one's    (B,)


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Batch:
    """What one rollout leaves for learning; all leaves begin with (T, B).

    As collected, ``critic_obs`` is the observation and then what is privileged, and ``log_prob`` has an entry for
    each agent. In an agent's own view, they are its own.
    """

    obs: jax.Array  # (T, B, observation)
    raw_action: jax.Array  # (T, B, action)
    log_prob: Any  # (T, B)
    reward: jax.Array  # scaled by reward_scaling    (T, B)
    discounted: jax.Array  # discounted return of the episode up to this step    (T, B)
    done: jax.Array  # (T, B)
    truncation: jax.Array  # (T, B)
    final_critic_obs: jax.Array  # the last of an episode, where done    (T, B, critic observation)
    critic_obs: (
        jax.Array | None
    )  # None where the value function reads obs    (T, B, critic observation)
    of_comfort: jax.Array | None = None  # share of the comfort limit, with a cost limit    (T, B)


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Observed:
    """What of the environments' state is recorded: few arrays, for each that enters a program costs some microseconds."""

    obs: jax.Array  # (B, observation)
    privileged_obs: Any  # (B, privileged), or None
    reward: jax.Array  # (B,)
    done: jax.Array  # (B,)
    metrics: dict[str, jax.Array]  # (B,) each
    info: dict[str, Any]
    regions: Any = None

    @classmethod
    def of(cls, state: Any) -> Observed:
        """Of a batch of environments."""
        seen = (state.obs, state.privileged_obs, state.reward, state.done, state.metrics)
        info = {name: value for name, value in state.info.items() if name != REMEMBERED}
        return cls(*seen, info, getattr(state, "regions", None))


def with_privileged(obs: jax.Array, privileged_obs: jax.Array | None) -> jax.Array:
    """An observation, and what nobody observes, where there is any (..., both)."""
    return obs if privileged_obs is None else jnp.concatenate([obs, privileged_obs], -1)


def critic_obs(env_state: Any) -> jax.Array:
    """What a value function could read of the environments (B, observation + privileged)."""
    return with_privileged(env_state.obs, env_state.privileged_obs)


def split_keys(keys: jax.Array, count: int = 2) -> jax.Array:
    """New keys: of one key (count, 2), or of the key of each seed (count, seeds, 2)."""
    if keys.ndim == 1:
        return jax.random.split(keys, count)
    return jax.vmap(lambda key: jax.random.split(key, count), out_axes=1)(keys)


def fold_in(keys: jax.Array, index: Any) -> jax.Array:
    """``jax.random.fold_in`` of one key (2,), or of the key of each seed (seeds, 2)."""
    return jnp.vectorize(jax.random.fold_in, excluded=(1,), signature="(k)->(k)")(keys, index)


def init_rollout(venv: Any, key: jax.Array, stagger: bool) -> RolloutState:
    """Reset all environments.

    Args:
        venv: vectorised environment; if it has ``stagger(state, key) -> state``, that spreads the
            environments over the phases of an episode.
        key: random key, or that of each seed (seeds, 2); the environments of a seed follow from its key.
        stagger: whether to use it.
    """
    key_reset, key_stagger = split_keys(key)
    if key.ndim > 1:
        each = split_keys(key_reset, venv.num_envs // len(key))
        key_reset = jnp.moveaxis(each, 0, 1).reshape(venv.num_envs, -1)
    state = venv.reset(key_reset)
    zeros = jnp.zeros(venv.num_envs, jnp.float32)
    staggered = stagger and hasattr(venv, "stagger")
    if staggered:
        state = venv.stagger(state, key_stagger)
    counted = zeros if staggered else zeros + 1
    return RolloutState(strong(state), zeros, zeros, zeros, zeros, zeros, zeros, counted)


def zero_totals(env_state: Any, axes: tuple[int, ...] = ()) -> Totals:
    """Totals of nothing, with the keys that ``collect`` adds to; ``axes`` is (seeds,) if there are several."""
    names = [f"episode/{name}" for name in EPISODE_TOTALS]
    names += ["step/reward", "step/nan", "step/overflow"]
    names += [f"step/{name}" for name in env_state.metrics if "/" in name]
    names += GENTLE_TOTALS if COMFORT_KEY in env_state.metrics else ()
    return {name: jnp.zeros(axes, jnp.float32) for name in names}


def _per_env(value: Any, num_envs: int) -> Any:
    """What holds for all environments (), or for those of each seed (seeds,), as what multiplies (B,)."""
    return value if jnp.ndim(value) == 0 else jnp.repeat(value, num_envs // len(value))


def record_step(
    rollout: RolloutState,
    totals: Totals,
    raw_action: jax.Array,
    log_prob: Any,
    after: Any,
    gamma: jax.Array | float,
    reward_scaling: jax.Array | float,
) -> tuple[RolloutState, Totals, Batch]:
    """Take note of one step of all environments.

    Args:
        rollout: before the step.
        totals: from ``zero_totals`` or an earlier step.
        raw_action: of the step    (B, action).
        log_prob: of the action, of each agent by its name    (B,).
        after: state of the environment after the step.
        gamma: discount, for the running discounted return; () or (seeds,).
        reward_scaling: factor on the reward; () or (seeds,).

    Returns:
        Rollout state and totals after the step, and what it leaves for learning    (B, ...).
    """
    before, done, metrics = rollout.env_state, after.done, after.metrics
    zero = jnp.zeros_like(after.reward)
    reward = _per_env(reward_scaling, len(done)) * after.reward
    discounted = _per_env(gamma, len(done)) * rollout.discounted + reward
    episode_return = rollout.episode_return + after.reward
    episode_force = rollout.episode_force + metrics.get(FORCE_KEY, zero)
    peak = jnp.maximum(rollout.episode_peak, metrics.get(PEAK_KEY, zero))
    over_comfort = (metrics.get(COMFORT_KEY, zero) > 1).astype(jnp.float32)
    harsh = rollout.episode_harsh + over_comfort
    length = rollout.episode_length + 1
    ended = done * rollout.counted
    gains = {
        "episode/episodes": ended,
        "episode/return": ended * episode_return,
        "episode/return_squared": ended * episode_return**2,
        "episode/success": ended * metrics.get("success", zero),
        "episode/force": ended * episode_force / length,
        "episode/length": ended * length,
        "episode/gentle": ended * metrics.get("success", zero) * (harsh == 0),
        "episode/peak": ended * peak,
        "step/force/over_comfort": over_comfort,
        "step/reward": after.reward,
        "step/nan": metrics.get("nan", zero),
        "step/overflow": metrics.get("overflow", zero),
    }
    gains |= {f"step/{name}": value for name, value in metrics.items() if "/" in name}
    totals = {
        name: total + jnp.sum(gains[name].reshape(*total.shape, -1), -1)
        for name, total in totals.items()
    }
    going_on = 1 - done
    info = after.info
    batch = Batch(
        obs=before.obs,
        raw_action=raw_action,
        log_prob=log_prob,
        reward=reward,
        discounted=discounted,
        done=done,
        truncation=info["truncation"],
        final_critic_obs=with_privileged(
            info["final_observation"], info.get("final_privileged_obs")
        ),
        critic_obs=critic_obs(before),
    )
    rollout = replace(
        rollout,
        env_state=strong(after),
        discounted=discounted * going_on,
        episode_return=episode_return * going_on,
        episode_force=episode_force * going_on,
        episode_peak=peak * going_on,
        episode_harsh=harsh * going_on,
        episode_length=length * going_on,
        counted=jnp.where(done > 0, 1 - info.get(RESTARTED, zero), rollout.counted),
    )
    return rollout, totals, batch


@functools.cache
def recording(record: Record) -> Record:
    """What takes note of many steps as ``record`` does of one; the third argument is what each step left (T, ...)."""

    def record_all(
        rollout: RolloutState, totals: Totals, moved: tuple, *more: Any
    ) -> tuple[RolloutState, Totals, Batch]:
        def step(carry: tuple, moved: tuple) -> tuple[tuple, Batch]:
            rollout, totals, batch = record(*carry, *moved, *more)
            return (rollout, totals), batch

        (rollout, totals), batch = jax.lax.scan(step, (rollout, totals), moved)
        return rollout, totals, batch

    return record_all


def collect(
    act: Callable[[jax.Array, jax.Array], tuple],
    venv: Any,
    rollout: RolloutState,
    key: jax.Array,
    *,
    num_steps: int,
    gamma: jax.Array | float,
    reward_scaling: jax.Array | float,
    execution: Execution = ONE_PROGRAM,
    record: Record = record_step,
) -> tuple[RolloutState, Batch, Totals]:
    """Step all environments ``num_steps`` times with the current policies.

    Args:
        act: (observation, key) -> action, raw sample, log-probabilities by agent.
        venv: vectorised, auto-resetting environment of B environments.
        rollout: where the environments are.
        key: random key, or that of each seed (seeds, 2).
        num_steps: T.
        gamma: discount, for the running discounted return.
        reward_scaling: factor on the reward.
        execution: how the loop runs.
        record: takes note of a step, as ``record_step`` does.

    Returns:
        The rollout state afterwards, the batch, and sums over all steps (``step/*``) and over all
        episodes that ended and were seen from their start (``episode/*``), () or (seeds,) each.
    """

    def move(env_state: Any, key: jax.Array) -> tuple[Any, tuple]:
        with jax.named_scope(ACT):
            action, raw, log_prob = act(env_state.obs, key)
        with jax.named_scope(ENV_STEP):
            after = venv.step(env_state, action)
        return strong(after), (raw, log_prob, Observed.of(after))

    def step(carry: tuple[RolloutState, Totals], key: jax.Array) -> tuple[tuple, Batch]:
        rollout, totals = carry
        env_state, moved = move(rollout.env_state, key)
        before = replace(rollout, env_state=Observed.of(rollout.env_state))
        rollout, totals, batch = record(before, totals, *moved, gamma, reward_scaling)
        return (replace(rollout, env_state=env_state), totals), batch

    env_state, totals = rollout.env_state, zero_totals(rollout.env_state, key.shape[:-1])
    keys = split_keys(key, num_steps)
    if not execution.records_later:
        (rollout, totals), batch = execution.scan(step, (rollout, totals), keys)
        return rollout, batch, totals
    before = replace(rollout, env_state=Observed.of(env_state))
    env_state, moved = execution.scan(move, env_state, keys)
    record_all = execution.compile(recording(record))
    rollout, totals, batch = record_all(before, totals, moved, gamma, reward_scaling)
    return replace(rollout, env_state=env_state), batch, totals
