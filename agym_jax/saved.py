"""Saving the state of an environment, and continuing from it in any environment of the same kind."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import jax

from agym_jax.state import Episode, State, select


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Saved:
    """A moment of an episode: all that its future depends on, except for random numbers."""

    data: dict[str, jax.Array]  # of the simulation, see ``MjxPhysics.save``
    task: Any
    episode: Episode
    obs: jax.Array  # (n_obs,)
    privileged_obs: Any  # (n_privileged,), or None
    past: Any


SEEN = ("task", "obs", "privileged_obs", "past")


def save(env: Any, state: State) -> Saved:
    """Return what is needed to continue from the state of one environment."""
    seen = {name: getattr(state, name) for name in SEEN}
    return Saved(data=env.physics.save(state.data), episode=state.episode, **seen)


def load_where(env: Any, state: State, saved: Saved, where: jax.Array) -> State:
    """Continue from a saved moment if ``where`` is true; reward, metrics, ``done`` and the key stay as they are.

    Args:
        env: environment of the same kind as the one that was saved.
        state: of one environment.
        saved: from ``save``.
        where: boolean ().
    """
    episode = select(where, saved.episode, state.episode)
    data = env.physics.load(state.data, saved.data, episode, where)
    old = {name: getattr(state, name) for name in SEEN}
    seen = select(where, {name: getattr(saved, name) for name in SEEN}, old)
    return state.replace(data=data, episode=episode, **seen)
