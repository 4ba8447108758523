"""Collecting experience: a scan over steps of all environments, with episode totals kept on the device."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import jax
import jax.numpy as jnp

FORCE_KEY = "force/on_human"
EPISODE_TOTALS = ("episodes", "return", "return_squared", "success", "force", "length")


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class RolloutState:
    """The environments and what their current episodes have gathered. Not saved in checkpoints."""

    env_state: Any  # batched state of the environment
    discounted: jax.Array  # discounted return so far, scaled reward    (B,)
    episode_return: jax.Array  # (B,)
    episode_force: jax.Array  # sum over steps of the force on the person [N]    (B,)
    episode_length: jax.Array  # steps so far    (B,)
    counted: jax.Array  # 1 where the episode was seen from its start    (B,)


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Batch:
    """What one rollout leaves for learning; all leaves begin with (T, B)."""

    obs: jax.Array  # (T, B, observation)
    raw_action: jax.Array  # (T, B, action)
    log_prob: Any  # (T, B); where two learn, of each by its name
    reward: jax.Array  # scaled by reward_scaling    (T, B)
    discounted: jax.Array  # discounted return of the episode up to this step    (T, B)
    done: jax.Array  # (T, B)
    truncation: jax.Array  # (T, B)
    final_observation: (
        jax.Array
    )  # as value_obs, last of an episode, where done    (T, B, value observation)
    value_obs: jax.Array | None = (
        None  # what the value function reads, if not obs; as collected, the
    )
    # observation and then what is hidden    (T, B, value observation)


def with_privileged(obs: jax.Array, privileged_obs: jax.Array | None) -> jax.Array:
    """An observation, and what nobody observes, where the environment tells it (..., both)."""
    return obs if privileged_obs is None else jnp.concatenate([obs, privileged_obs], -1)


def critic_obs(env_state: Any) -> jax.Array:
    """What a value function could read of the environments (B, observation + hidden)."""
    return with_privileged(env_state.obs, env_state.info.get("privileged_obs"))


def init_rollout(venv: Any, key: jax.Array, stagger: bool) -> RolloutState:
    """Reset all environments.

    Args:
        venv: vectorised environment; if it has ``stagger(state, key) -> state``, that spreads the
            environments over the phases of an episode.
        key: random key.
        stagger: whether to use it.
    """
    key_reset, key_stagger = jax.random.split(key)
    state = venv.reset(key_reset)
    zeros = jnp.zeros(venv.num_envs, jnp.float32)
    staggered = stagger and hasattr(venv, "stagger")
    if staggered:
        state = venv.stagger(state, key_stagger)
    state = strong_types(state)
    return RolloutState(state, zeros, zeros, zeros, zeros, zeros if staggered else zeros + 1)


def strong_types(tree: Any) -> Any:
    """The tree with the types that its leaves have after a loop, so that nothing compiles twice.

    ``jnp.where(x, 1.0, 0.0)`` is "weakly" float32, which a compiled function tells from float32.
    """

    def strong(leaf: Any) -> Any:
        leaf = jnp.asarray(leaf)
        is_key = jnp.issubdtype(leaf.dtype, jax.dtypes.extended)
        return leaf if is_key else jnp.asarray(leaf, leaf.dtype)

    return jax.tree.map(strong, tree)


def zero_totals(env_state: Any) -> dict[str, jax.Array]:
    """Totals of nothing, with the keys that ``collect`` adds to."""
    names = [f"episode/{name}" for name in EPISODE_TOTALS]
    names += ["step/reward", "step/nan", "step/overflow"]
    names += [f"step/{name}" for name in env_state.metrics if "/" in name]
    return {name: jnp.zeros((), jnp.float32) for name in names}


def record_step(
    rollout_state: RolloutState,
    totals: dict[str, jax.Array],
    raw_action: jax.Array,
    log_prob: Any,
    after: Any,
    gamma: float,
    reward_scaling: float,
) -> tuple[RolloutState, dict[str, jax.Array], Batch]:
    """Take note of one step of all environments.

    Args:
        environments: before the step.
        totals: from ``zero_totals`` or an earlier step.
        raw_action: of the step    (B, action).
        log_prob: of the action    (B,), or of each agent's by its name.
        after: state of the environment after the step.
        gamma: discount, for the running discounted return.
        reward_scaling: factor on the reward.

    Returns:
        Environments and totals after the step, and what it leaves for learning    (B, ...).
    """
    before, done, metrics = rollout_state.env_state, after.done, after.metrics
    zero = jnp.zeros_like(after.reward)
    reward = reward_scaling * after.reward
    discounted = gamma * rollout_state.discounted + reward
    episode_return = rollout_state.episode_return + after.reward
    episode_force = rollout_state.episode_force + metrics.get(FORCE_KEY, zero)
    length = rollout_state.episode_length + 1
    ended = done * rollout_state.counted
    gains = {
        "episode/episodes": ended,
        "episode/return": ended * episode_return,
        "episode/return_squared": ended * episode_return**2,
        "episode/success": ended * metrics.get("success", zero),
        "episode/force": ended * episode_force / length,
        "episode/length": ended * length,
        "step/reward": after.reward,
        "step/nan": metrics.get("nan", zero),
        "step/overflow": metrics.get("overflow", zero),
    }
    gains |= {f"step/{name}": value for name, value in metrics.items() if "/" in name}
    totals = {name: total + jnp.sum(gains[name]) for name, total in totals.items()}
    going_on = 1 - done
    batch = Batch(
        obs=before.obs,
        raw_action=raw_action,
        log_prob=log_prob,
        reward=reward,
        discounted=discounted,
        done=done,
        truncation=after.info["truncation"],
        final_observation=with_privileged(
            after.info["final_observation"], after.info.get("final_privileged_obs")
        ),
        value_obs=critic_obs(before),
    )
    rollout_state = replace(
        rollout_state,
        env_state=strong_types(after),
        discounted=discounted * going_on,
        episode_return=episode_return * going_on,
        episode_force=episode_force * going_on,
        episode_length=length * going_on,
        counted=jnp.maximum(rollout_state.counted, done),
    )
    return rollout_state, totals, batch


def collect(
    act: Callable[[jax.Array, jax.Array], tuple],
    venv: Any,
    rollout_state: RolloutState,
    key: jax.Array,
    *,
    num_steps: int,
    gamma: float,
    reward_scaling: float,
) -> tuple[RolloutState, Batch, dict[str, jax.Array]]:
    """Step all environments ``num_steps`` times with the current policy.

    Args:
        act: (observation, key) -> action, raw sample, log-probability, as ``sample_action``.
        venv: vectorised, auto-resetting environment of B environments.
        environments: where the environments are.
        key: random key.
        num_steps: T.
        gamma: discount, for the running discounted return.
        reward_scaling: factor on the reward.

    Returns:
        The environments afterwards, the batch, and sums over all steps (``step/*``) and over all
        episodes that ended and were seen from their start (``episode/*``).
    """

    def step(
        carry: tuple[RolloutState, dict], key: jax.Array
    ) -> tuple[tuple[RolloutState, dict], Batch]:
        rollout_state, totals = carry
        before = rollout_state.env_state
        action, raw, log_prob = act(before.obs, key)
        after = venv.step(before, action)
        rollout_state, totals, batch = record_step(
            rollout_state, totals, raw, log_prob, after, gamma, reward_scaling
        )
        return (rollout_state, totals), batch

    start = (rollout_state, zero_totals(rollout_state.env_state))
    (rollout_state, totals), batch = jax.lax.scan(step, start, jax.random.split(key, num_steps))
    return rollout_state, batch, totals
