"""Collecting experience: a scan over steps of all worlds, with episode totals kept on the device."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import jax
import jax.numpy as jnp

FORCE_KEY = "force/on_person"
EPISODE_TOTALS = ("episodes", "return", "return_squared", "success", "force", "length")


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Worlds:
    """The worlds and what their current episodes have gathered. Not saved in checkpoints."""

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
    terminal_obs: (
        jax.Array
    )  # as value_obs, last of an episode, where done    (T, B, value observation)
    value_obs: jax.Array | None = (
        None  # what the value function reads, if not obs; as collected, the
    )
    # observation and then what is hidden    (T, B, value observation)


def with_hidden(obs: jax.Array, hidden: jax.Array | None) -> jax.Array:
    """An observation, and what nobody observes, where the environment tells it (..., both)."""
    return obs if hidden is None else jnp.concatenate([obs, hidden], -1)


def everything(env_state: Any) -> jax.Array:
    """What a value function could read of the worlds (B, observation + hidden)."""
    return with_hidden(env_state.obs, env_state.info.get("hidden"))


def first_worlds(venv: Any, key: jax.Array, stagger: bool) -> Worlds:
    """Reset all worlds.

    Args:
        venv: vectorised environment; if it has ``stagger(state, key) -> state``, that spreads the
            worlds over the phases of an episode.
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
    return Worlds(state, zeros, zeros, zeros, zeros, zeros if staggered else zeros + 1)


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


def account(
    worlds: Worlds,
    totals: dict[str, jax.Array],
    raw_action: jax.Array,
    log_prob: Any,
    after: Any,
    gamma: float,
    reward_scaling: float,
) -> tuple[Worlds, dict[str, jax.Array], Batch]:
    """Take note of one step of all worlds.

    Args:
        worlds: before the step.
        totals: from ``zero_totals`` or an earlier step.
        raw_action: of the step    (B, action).
        log_prob: of the action    (B,), or of each agent's by its name.
        after: state of the environment after the step.
        gamma: discount, for the running discounted return.
        reward_scaling: factor on the reward.

    Returns:
        Worlds and totals after the step, and what it leaves for learning    (B, ...).
    """
    before, done, metrics = worlds.env_state, after.done, after.metrics
    zero = jnp.zeros_like(after.reward)
    reward = reward_scaling * after.reward
    discounted = gamma * worlds.discounted + reward
    episode_return = worlds.episode_return + after.reward
    episode_force = worlds.episode_force + metrics.get(FORCE_KEY, zero)
    length = worlds.episode_length + 1
    ended = done * worlds.counted
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
        terminal_obs=with_hidden(after.info["terminal_obs"], after.info.get("terminal_hidden")),
        value_obs=everything(before),
    )
    worlds = replace(
        worlds,
        env_state=strong_types(after),
        discounted=discounted * going_on,
        episode_return=episode_return * going_on,
        episode_force=episode_force * going_on,
        episode_length=length * going_on,
        counted=jnp.maximum(worlds.counted, done),
    )
    return worlds, totals, batch


def collect(
    act: Callable[[jax.Array, jax.Array], tuple],
    venv: Any,
    worlds: Worlds,
    key: jax.Array,
    *,
    num_steps: int,
    gamma: float,
    reward_scaling: float,
) -> tuple[Worlds, Batch, dict[str, jax.Array]]:
    """Step all worlds ``num_steps`` times with the current policy.

    Args:
        act: (observation, key) -> action, raw sample, log-probability, as ``sample_action``.
        venv: vectorised, auto-resetting environment of B worlds.
        worlds: where the worlds are.
        key: random key.
        num_steps: T.
        gamma: discount, for the running discounted return.
        reward_scaling: factor on the reward.

    Returns:
        The worlds afterwards, the batch, and sums over all steps (``step/*``) and over all
        episodes that ended and were seen from their start (``episode/*``).
    """

    def step(carry: tuple[Worlds, dict], key: jax.Array) -> tuple[tuple[Worlds, dict], Batch]:
        worlds, totals = carry
        before = worlds.env_state
        action, raw, log_prob = act(before.obs, key)
        after = venv.step(before, action)
        worlds, totals, batch = account(worlds, totals, raw, log_prob, after, gamma, reward_scaling)
        return (worlds, totals), batch

    start = (worlds, zero_totals(worlds.env_state))
    (worlds, totals), batch = jax.lax.scan(step, start, jax.random.split(key, num_steps))
    return worlds, batch, totals
