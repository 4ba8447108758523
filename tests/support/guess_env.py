"""The contract of ``AssistiveEnv`` with its own ``State``, without physics; compiles in no time.

An episode's human has a number, which is observed; the reward is the higher, the nearer the action is to it.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp

from agym_jax.state import Episode, State, select


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class GuessData:
    """Stands for ``mjx.Data``."""

    qpos: jax.Array  # the last action    (1,)


@dataclass
class GuessEnv:
    """One environment."""

    name: str = "GuessHuman-v0"
    impl: str = "jax"
    episode_length: int = 6
    fail_at: int = -1  # step at which the physics goes non-finite

    observation_size = 2
    action_size = 1

    @property
    def unwrapped(self) -> GuessEnv:
        """Itself."""
        return self

    def reset(self, rng: jax.Array) -> State:
        """A new human."""
        key_human, key = jax.random.split(rng)
        human: Any = jax.random.uniform(key_human, minval=-1.0, maxval=1.0)
        none: Any = None
        episode = Episode(human, none, none, none, none, none, jnp.int32(0))
        zero = jnp.float32(0.0)
        metrics = dict.fromkeys(
            ("reward/guess", "force/on_human", "success", "nan", "overflow"), zero
        )
        data = GuessData(jnp.zeros(1))
        return State(data, self._obs(episode), zero, zero, metrics, {}, zero, episode, key)

    def reset_where(self, state: State, where: jax.Array) -> State:
        """A new human where it holds."""
        fresh = self.reset(state.key)
        kept = {name: getattr(state, name) for name in ("reward", "done", "metrics", "info")}
        return select(where, fresh.replace(**kept), state)

    def step(self, state: State, action: jax.Array) -> State:
        """One guess; ``task`` counts them, too."""
        step = state.episode.step + 1
        human: Any = state.episode.human
        reward = -((action[0] - human) ** 2)
        nan = (step == self.fail_at).astype(jnp.float32)
        limit = step >= self.episode_length
        metrics = {
            "reward/guess": reward,
            "force/on_human": step.astype(jnp.float32),
            "success": (-reward < 0.1).astype(jnp.float32),
            "nan": nan,
            "overflow": jnp.float32(0.0),
        }
        episode = dataclasses.replace(state.episode, step=step)
        return state.replace(
            data=GuessData(action),
            obs=self._obs(episode),
            reward=reward,
            done=nan if "steps" in state.info else jnp.maximum(limit, nan),
            metrics={**state.metrics, **metrics},
            task=state.task + 1,
            episode=episode,
        )

    def _obs(self, episode: Episode) -> jax.Array:
        human: Any = episode.human
        return jnp.stack([human, episode.step / self.episode_length])
