"""Restarts: some of the episodes that end are followed by a later part of a better one, instead of by a new episode.

Where success is rare at first, a policy forgets how it came about before it happens again. Here, some environments whose
episode has ended continue from a random moment of an episode that has just ended with success, with the person and everything
else as they were then. What follows differs, because actions are random, so that more is seen of what leads to success, and the
value function learns what it is worth to be on the way to it. The success rate of new episodes decides how many restarts there
are: none once every one succeeds. What they achieve is in ``docs/rare_success.md``.

That starting from promising states helps where rewards are sparse is known from demonstrations (Salimans and Chen 2018,
"Learning Montezuma's Revenge from a Single Demonstration"; Nair et al. 2018) and from Go-Explore (Ecoffet et al. 2021,
"First return, then explore"). Here the states come from the policy's own episodes that end at the same step, and there is no
archive. Statistics of training count new episodes only.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from agym_jax.state import State, raw_key
from agym_jax.wrappers import shared_reset_interval

from ..envs import is_native
from ..errors import ConfigError
from .execution import StepwiseEnv
from .rollout import BEYOND, REMEMBERED, RESTARTED, fold_in

COPIES = 8
"""Largest average number of restarts from one episode."""
BEST = 64
"""Besides those that succeed, one of so many episodes is continued from: those with the largest return."""
OF_STEP = ("reward", "done", "metrics", "info", "regions", "key")
"""Fields of a state that are those of the last step, or of all episodes."""
Moment = dict[str, Any]
"""The other fields, with which an episode goes on (B, ...)."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Remembered:
    """What a batch of B environments remembers of its present episodes."""

    moment: Moment  # a random one of those at which others ended
    moments: Array  # how many there were; 0: none yet    (B,)
    return_then: Array  # return of the episode until ``moment``    (B,)
    episode_return: Array  # until now    (B,)
    key: Array  # of further choices; the first of a group is used    (B, 2)


class RestartingVectorEnv:
    """A vectorised environment with restarts; otherwise as the one given, with any physics.

    Args:
        venv: from ``agym_jax.wrappers.vectorize``.
        share: fraction of ended episodes that are followed by a restart while none succeeds; it falls in proportion to the
            failures among new episodes.
        groups: number of equal parts of the batch that do not share episodes: those of different seeds.

    Raises:
        ConfigError: if ``venv`` is a ``StepwiseEnv``.
    """

    def __init__(self, venv: Any, share: float, groups: int = 1) -> None:
        if isinstance(venv, StepwiseEnv):
            raise ConfigError(
                "--restart-share does not work with a StepwiseEnv, whose step is compiled already."
            )
        self.venv, self.share, self.groups = venv, share, groups
        self._physics = None if is_native(venv) else getattr(venv, "physics", None)
        """That of MJX, whose data is more than what an episode needs to go on, and in Warp partly of all environments."""
        self._next = jax.jit(self._choose)

    def __getattr__(self, name: str) -> Any:
        if name == "venv":
            raise AttributeError(name)
        return getattr(self.venv, name)

    def reset(self, key: Array) -> State:
        """Begin an episode in every environment; see ``VectorEnv.reset``."""
        state = self.venv.reset(key)
        zeros = jnp.zeros(self.num_envs)
        keys = fold_in(raw_key(jnp.asarray(state.key)), BEYOND)
        remembered = Remembered(self._save(state), zeros, zeros, zeros, keys)
        return self._with(state, remembered, zeros)

    def stagger(self, state: State, key: Array) -> State:
        """See ``VectorEnv.stagger``; with any physics, so that many episodes end at the same step."""
        more = (shared_reset_interval(self.episode_length),) if is_native(self.venv) else ()
        return self.venv.stagger(state, key, *more)

    def step(self, state: State, action: Array) -> State:
        """One control step of every environment; see ``VectorEnv.step``."""
        before: Remembered = state.info[REMEMBERED]
        restarted = state.info[RESTARTED]
        plain = {name: x for name, x in state.info.items() if name not in (REMEMBERED, RESTARTED)}
        state = self.venv.step(state.replace(info=plain), action)
        total = before.episode_return + state.reward
        before = dataclasses.replace(before, episode_return=total)
        finished = state.info["truncation"] > 0
        if not isinstance(finished, jax.core.Tracer):
            if not finished.any():
                return self._with(state, before, restarted)
            return self._restart(state, before, restarted, finished)
        return jax.lax.cond(
            jnp.any(finished),
            self._restart,
            lambda state, before, restarted, _: self._with(state, before, restarted),
            state, before, restarted, finished,
        )  # fmt: skip

    def _with(self, state: State, remembered: Remembered, restarted: Array) -> State:
        return state.replace(info={**state.info, REMEMBERED: remembered, RESTARTED: restarted})

    def _restart(
        self, state: State, before: Remembered, restarted: Array, finished: Array
    ) -> State:
        """Continue other episodes in some environments that have begun a new one, and remember moments of the rest."""
        metrics = (state.metrics["success"], state.metrics["nan"])
        chosen = self._next(dataclasses.replace(before, moment={}), restarted, finished, *metrics)
        if is_native(self.venv):
            chosen = jax.device_get(chosen)
        source, restart, noted, after, restarted = chosen
        moment = jax.tree.map(lambda x: x[source], before.moment)
        state = self._load(state, moment, restart)
        kept = _select(restart, moment, before.moment)
        kept = _select(noted, self._save(state), kept)
        return self._with(state, dataclasses.replace(after, moment=kept), restarted)

    def _choose(
        self, before: Remembered, restarted: Array, finished: Array, success: Array, nan: Array
    ) -> tuple[Array, Array, Array, Remembered, Array]:
        """``choose_restarts`` of each group; the sources are indices in the whole batch."""
        own = (before, restarted, finished, success > 0, nan > 0)
        own = jax.tree.map(lambda x: x.reshape(self.groups, -1, *x.shape[1:]), own)
        source, *chosen = jax.vmap(partial(choose_restarts, share=self.share))(*own)
        source = source + jnp.arange(self.groups)[:, None] * source.shape[1]
        return jax.tree.map(lambda x: x.reshape(-1, *x.shape[2:]), (source, *chosen))

    def _save(self, state: State) -> Moment:
        names = [field.name for field in dataclasses.fields(state) if field.name not in OF_STEP]
        moment = {name: getattr(state, name) for name in names}
        if self._physics:
            moment["data"] = jax.vmap(self._physics.save)(state.data)
        return moment

    def _load(self, state: State, moment: Moment, where: Array) -> State:
        """Continue from these moments where ``where`` holds (B,)."""
        if not self._physics:
            return state.replace(
                **_select(where, moment, {name: getattr(state, name) for name in moment})
            )
        saved = moment["data"]
        rest = {name: moment[name] for name in moment if name != "data"}
        rest = _select(where, rest, {name: getattr(state, name) for name in rest})
        data = jax.vmap(self._physics.load)(state.data, saved, rest["episode"], where)
        return state.replace(data=data, **rest)


def with_restarts(venv: Any, share: float, groups: int) -> Any:
    """The vectorised environment, with restarts if ``share`` is not 0; see ``RestartingVectorEnv``."""
    return RestartingVectorEnv(venv, share, groups) if share else venv


def choose_restarts(
    before: Remembered, restarted: Array, finished: Array, success: Array, nan: Array, share: float
) -> tuple[Array, Array, Array, Remembered, Array]:
    """Choose, among environments that share their episodes, after a step.

    Args:
        before: what they remember, without moments.
        restarted: whose episode, before the step, had begun in the middle of another, 1.0 or 0.0 (n,).
        finished: whose episode has ended (n,).
        success: who succeeded in this step (n,).
        nan: whose simulation diverged (n,).
        share: see ``RestartingVectorEnv``.

    Returns:
        For each environment, the index of the one that it would continue from, whether it does, whether its present moment is
        to be remembered; what else they remember now, and ``restarted`` after the step (n, ...).
    """
    ends = jnp.any(finished)
    keys = jax.random.split(before.key[0])
    wish, which, note = jax.random.uniform(keys[1], (3, len(finished)))
    eligible = finished & (before.moments > 0) & ~nan
    own = finished & (restarted == 0)
    source, restart = choose_sources(
        finished, own, eligible, success, before.episode_return, wish, which, share
    )

    def now(of_source: Array, of_new: float, going_on: Array) -> Array:
        other = jnp.where(finished, of_new, going_on)
        return jnp.where(restart, of_source[source], other)

    moments = now(before.moments, 0.0, before.moments + ends)
    total = now(before.return_then, 0.0, before.episode_return)
    noted = ends & ~finished & (note * moments < 1)  # each of n moments with probability 1 / n
    then = jnp.where(restart, before.return_then[source], before.return_then)
    after = Remembered(
        moment={},
        moments=moments,
        return_then=jnp.where(noted, total, then),
        episode_return=total,
        key=jnp.where(ends, keys[0], before.key),
    )
    restarted = jnp.where(finished, restart.astype(jnp.float32), restarted)
    return source, restart, noted, after, restarted


def choose_sources(
    finished: Array,
    own: Array,
    eligible: Array,
    success: Array,
    episode_return: Array,
    wish: Array,
    which: Array,
    share: float,
) -> tuple[Array, Array]:
    """Choose, among environments that share their episodes, which continue from which.

    Args:
        finished: whose episode has just ended (n,).
        own: those of them that had begun as new ones (n,).
        eligible: those of them that can be continued from (n,).
        success: who succeeded (n,).
        episode_return: (n,).
        wish: uniform random numbers, for whether (n,).
        which: uniform random numbers, for which (n,).
        share: see ``RestartingVectorEnv``.

    Returns:
        For each environment, the index of the one that it would continue from, and whether it does (n,).
    """
    order = jnp.argsort(jnp.where(eligible, -episode_return, jnp.inf))
    rank = jnp.argsort(order)
    ended = jnp.sum(finished)
    best = eligible & (success | (rank < ended // BEST))
    sources = jnp.cumsum(best)
    count = sources[-1]
    picked = jnp.searchsorted(sources, jnp.floor(which * count) + 1)
    failures = jnp.sum(own & ~success) / jnp.maximum(jnp.sum(own), 1)
    chance = jnp.minimum(share * failures, COPIES * count / jnp.maximum(ended, 1))
    restart = finished & (wish < chance) & (count > 0)
    return jnp.minimum(picked, len(finished) - 1), restart


def _select(where: Any, new: Any, old: Any) -> Any:
    """``state.select`` for batches: ``where`` is (B,)."""

    def one(new: Any, old: Any) -> Any:
        xp = jnp if isinstance(where, jax.Array) else np
        return xp.where(xp.reshape(where, (-1, *(1 for _ in old.shape[1:]))), new, old)

    return jax.tree.map(one, new, old)
