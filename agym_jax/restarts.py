"""Batches of environments in which some episodes continue from moments of better ones.

Where success is rare at first, what led to it is soon forgotten. Here, part of the environments whose episodes end go on
from a random moment of an episode that succeeded, instead of with a new person. The idea is that of Go-Explore (Ecoffet et
al. 2021, "First return, then explore") and of starts from demonstrations (Nair et al. 2018; Salimans and Chen 2018), with the policy's
own successes in place of an archive or of a demonstrator.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
from jax import Array

from agym_jax.saved import Saved, load_where, save
from agym_jax.wrappers import VectorEnv

COPIES = 8
"""Environments, at most, that continue from one episode."""
BEST = 64
"""Besides those that succeed, one of so many ended episodes is continued from, those with the largest return."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Restarts:
    """What a batch of B environments remembers of its episodes."""

    saved: Saved  # a random moment of each episode so far
    moments: Array  # moments that it was chosen among; 0: none yet    (B,)
    saved_return: Array  # return of the episode until then    (B,)
    episode_return: Array  # return so far    (B,)
    keys: Array  # (B, 2)


class RestartVectorEnv(VectorEnv):
    """As ``VectorEnv``; some of the ended episodes are followed by a part of an episode that was better.

    ``info["restarted"]`` is 1.0 where the present episode is one of these.

    Args:
        env: environment, on MJX.
        num_envs: number of environments, B.
        share: fraction of the ended episodes that are followed by a restart while none succeeds; it falls with
            the success rate, to 0 where all do.
        groups: equal parts of the batch that do not share episodes.
    """

    def __init__(self, env: Any, num_envs: int, share: float = 0.5, groups: int = 1):
        super().__init__(env, num_envs)
        self.share, self.groups = share, groups

    def reset(self, key: Array) -> Any:
        """Begin an episode in every environment; see ``VectorEnv.reset``."""
        state = super().reset(key)
        zeros = jnp.zeros(self.num_envs)
        restarts = Restarts(
            saved=jax.vmap(lambda s: save(self.env, s))(state.replace(info={})),
            moments=zeros,
            saved_return=zeros,
            episode_return=zeros,
            keys=jax.vmap(lambda k: jax.random.fold_in(k, 1))(state.key),
        )
        return state.replace(info=state.info | {"restarts": restarts, "restarted": zeros})

    def next_episodes(self, state: Any, info: dict[str, Any], finished: Array) -> tuple[Any, dict]:
        """Begin or continue another episode where one has ended, and note moments of the others."""
        restarts: Restarts = info["restarts"]
        total = restarts.episode_return + state.reward
        restarts = dataclasses.replace(restarts, episode_return=total)
        return jax.lax.cond(
            jnp.any(finished),
            self._restart,
            lambda state, info, _: (state, info),
            state, info | {"restarts": restarts}, finished,
        )  # fmt: skip

    def _restart(self, state: Any, info: dict[str, Any], finished: Array) -> tuple[Any, dict]:
        r: Restarts = info["restarts"]
        keys = jax.vmap(lambda k: jax.random.split(k, 4))(r.keys)
        draws = jax.vmap(jax.vmap(jax.random.uniform))(keys[:, 1:])  # (B, 3)
        own = finished & (info["restarted"] == 0)
        source, restart = self._sources(state, r, finished, own, draws[:, 0], draws[:, 1])

        def of_source(tree: Any) -> Any:
            return jax.tree.map(lambda x: x[source], tree)

        saved = of_source(r.saved)
        env = self.env
        state = jax.vmap(env.reset_where)(state, finished & ~restart)
        state = jax.vmap(lambda *x: load_where(env, *x))(state, saved, restart)
        moments = jnp.where(restart, r.moments[source], jnp.where(finished, 0, r.moments + 1))
        total = jnp.where(
            restart, r.saved_return[source], jnp.where(finished, 0.0, r.episode_return)
        )
        noted = ~finished & (draws[:, 2] * moments < 1)

        def chosen(now: Any, copied: Any, old: Any) -> Any:
            def one(now: Array, copied: Array, old: Array) -> Array:
                shape = (-1,) + (1,) * (old.ndim - 1)
                kept = jnp.where(restart.reshape(shape), copied, old)
                return jnp.where(noted.reshape(shape), now, kept)

            return jax.tree.map(one, now, copied, old)

        now = jax.vmap(lambda s: save(env, s))(state)
        restarts = Restarts(
            saved=chosen(now, saved, r.saved),
            moments=moments,
            saved_return=chosen(total, r.saved_return[source], r.saved_return),
            episode_return=total,
            keys=keys[:, 0],
        )
        restarted = jnp.where(finished, restart.astype(jnp.float32), info["restarted"])
        return state, info | {"restarts": restarts, "restarted": restarted}

    def _sources(
        self, state: Any, r: Restarts, finished: Array, own: Array, wish: Array, which: Array
    ) -> tuple[Array, Array]:
        """For each environment, the one whose saved moment it could continue from, and whether it does (B,)."""
        metrics = state.metrics
        eligible = finished & (r.moments > 0) & (metrics["nan"] == 0)
        success = metrics["success"] > 0

        def of_group(
            ended: Array, own: Array, eligible: Array, success: Array, total: Array, wish: Array, which: Array
        ) -> tuple[Array, Array]:
            score = jnp.where(eligible, total, -jnp.inf)
            rank = jnp.argsort(jnp.argsort(-score))
            count = jnp.sum(ended)
            best = eligible & (success | (rank < count // BEST))
            sources = jnp.cumsum(best)
            pick = jnp.floor(which * sources[-1]) + 1
            source = jnp.minimum(jnp.searchsorted(sources, pick), len(ended) - 1)
            failed = jnp.sum(own & ~success) / jnp.maximum(jnp.sum(own), 1)
            chance = jnp.minimum(
                self.share * failed, COPIES * sources[-1] / jnp.maximum(count, 1)
            )
            return source, ended & (wish < chance) & (sources[-1] > 0)

        args = (finished, own, eligible, success, r.episode_return, wish, which)
        split = [x.reshape(self.groups, -1) for x in args]
        source, restart = jax.vmap(of_group)(*split)
        offset = jnp.arange(self.groups)[:, None] * source.shape[1]
        return (source + offset).reshape(-1), restart.reshape(-1)

