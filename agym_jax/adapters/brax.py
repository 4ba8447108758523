"""Adapter for Brax's unmodified trainers, with a new person in every episode.

    from agym_jax.adapters.brax import wrap_for_brax_training
    from brax.training.agents.ppo import train as ppo

    env = agym_jax.make("ReachingSawyer-v0")
    ppo.train(env, ..., episode_length=env.episode_length, wrap_env_fn=wrap_for_brax_training)

Brax's ``AutoResetWrapper`` starts every episode from the state of the first one. Here, every episode has a new
person, goal and start. ``docs/brax.md`` has a complete example.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jax import Array

import agym_jax.compat.mjx_print  # noqa: F401 (Brax imports MJX, which is quiet only when imported like this)
from agym_jax.compat import brax_jax
from agym_jax.errors import ActionError, WrapperError
from agym_jax.wrappers import VectorEnv

from brax.envs.base import Wrapper  # isort: skip

FORCES = "force/"
PER_STEP = "_per_step"
"""Suffix of metrics whose sum Brax divides by the length of the episode."""


def wrap_for_brax_training(
    env: Any,
    episode_length: int = 200,
    action_repeat: int = 1,
    randomization_fn: Callable | None = None,
    bootstrap_on_timeout: bool = False,
) -> BraxTrainingEnv:
    """Wrap an environment from ``agym_jax.make`` for Brax's trainers; pass this function as their ``wrap_env_fn``.

    Args:
        env: environment from ``agym_jax.make``, not wrapped.
        episode_length: control steps after which an episode is truncated; at most the task's own length.
        action_repeat: number of control steps for which every action is held.
        randomization_fn: not supported; use ``humans`` of ``agym_jax.make`` instead.
        bootstrap_on_timeout: the same value as that passed to ``brax.training.agents.ppo.train.train``; set it with
            ``functools.partial``. If true, truncations are reported in ``info["time_out"]``, not ``info["truncation"]``.

    Raises:
        WrapperError: if the environment is already wrapped or cannot be compiled, a ``randomization_fn`` is given, or
            the length is not a multiple of ``action_repeat``.
    """
    brax_jax.apply()
    if randomization_fn is not None:
        raise WrapperError(
            "randomization_fn changes the one model of a Brax environment (DomainRandomizationVmapWrapper); here "
            "each person has their own model, drawn anew in each episode. Leave it out, and specify "
            "what to draw with agym_jax.make(name, humans=Population(sizes='continuous'), robot=RobotVariation(...))."
        )
    return BraxTrainingEnv(env, episode_length, action_repeat, bootstrap_on_timeout)


class BraxTrainingEnv(Wrapper):
    """A batch of environments that follows Brax's conventions, with auto-reset; reset keys determine the batch size.

    ``state.info`` contains ``steps``, ``truncation``, ``episode_done`` and ``episode_metrics`` as written by Brax's
    ``EpisodeWrapper``. ``state.metrics`` are chosen such that Brax's sums over an episode are meaningful: the reward
    terms; ``success``, 1 at the last step of a successful episode; ``force/..._per_step`` [N], which Brax converts to
    means; and counts of ``nan`` and ``overflow``. An episode whose simulation diverged counts as truncated.

    Args:
        env: environment from ``agym_jax.make``.
        episode_length: see ``wrap_for_brax_training``.
        action_repeat: see ``wrap_for_brax_training``.
        bootstrap_on_timeout: see ``wrap_for_brax_training``.

    Raises:
        WrapperError: see ``wrap_for_brax_training``.
    """

    env: Any

    def __init__(
        self,
        env: Any,
        episode_length: int,
        action_repeat: int = 1,
        bootstrap_on_timeout: bool = False,
    ):
        if isinstance(env, (Wrapper, VectorEnv)):
            raise WrapperError(
                f"wrap_for_brax_training takes one environment as agym_jax.make returns it, got a "
                f"{type(env).__name__}, which is already a wrapper. Pass the environment inside it."
            )
        if getattr(env, "impl", None) == "native":
            raise WrapperError(
                f"{env.name} was made with impl='native', whose functions JAX cannot "
                f"trace. Use agym_jax.make({env.name!r}, impl='jax') or 'warp'."
            )
        super().__init__(env)
        self.episode_length = min(episode_length, env.episode_length)
        self.action_repeat = action_repeat
        self._limit = "time_out" if bootstrap_on_timeout else "truncation"
        self._sized: dict[int, Any] = {}
        if action_repeat < 1 or self.episode_length < 1 or self.episode_length % action_repeat:
            raise WrapperError(
                f"An episode of {self.episode_length} steps cannot be divided into actions held for "
                f"{action_repeat} steps. Choose an episode_length (at most {env.episode_length}) that is a "
                f"multiple of action_repeat."
            )

    def reset(self, rng: Array) -> Any:
        """Begin an episode in every environment.

        Args:
            rng: PRNG keys, raw (B, 2) or typed (B,).

        Raises:
            WrapperError: if there is only a single key.
        """
        typed = jnp.issubdtype(rng.dtype, jax.dtypes.prng_key)
        if rng.ndim != (1 if typed else 2):
            raise WrapperError(
                f"reset takes one PRNG key for each environment, jax.random.split(key, num_envs); got keys "
                f"of shape {rng.shape}."
            )
        state = jax.vmap(self._of(len(rng)).reset)(rng)
        zeros = jnp.zeros(len(rng), jnp.float32)
        metrics = {_name(name): zeros for name in state.metrics}
        info = {name: zeros for name in ("steps", "truncation", "episode_done", self._limit)}
        totals = dict.fromkeys(("sum_reward", "length", *metrics), zeros)
        return state.replace(metrics=metrics, info={**info, "episode_metrics": totals})

    def step(self, state: Any, action: Array) -> Any:
        """Hold the actions for ``action_repeat`` control steps, then reset the environments whose episode is over.

        Args:
            state: state of the batch.
            action: (B, action_size).

        Raises:
            ActionError: if the actions have a different shape.
        """
        expected = (*state.done.shape, self.action_size)
        if jnp.shape(action) != expected:
            raise ActionError(
                f"{self.env.name} takes actions of shape {expected}, got {jnp.shape(action)}."
            )
        env, info = self._of(expected[0]), state.info

        def hold(state: Any, _: None) -> tuple[Any, tuple]:
            after = jax.vmap(env.step)(state, action)
            return after.replace(metrics={}), (after.reward, after.done, after.metrics)

        bare = state.replace(metrics={}, info={})
        after, (reward, done, metrics) = jax.lax.scan(hold, bare, length=self.action_repeat)
        going = jnp.cumsum(done, axis=0) == done  # nothing counts after the end
        total = lambda x: jnp.sum(jnp.where(going, x, 0.0), axis=0)  # noqa: E731

        steps = jnp.where(state.done > 0, 0.0, info["steps"]) + self.action_repeat
        over = jnp.any(done > 0, axis=0) | (steps >= self.episode_length)
        done, reward = over.astype(jnp.float32), total(reward)
        metrics = {
            _name(name): metrics[name][-1] * done if name == "success" else total(metrics[name])
            for name in metrics
        }
        gains = {"sum_reward": reward, "length": self.action_repeat, **metrics}
        kept = 1 - info["episode_done"]
        totals = {name: kept * x + gains[name] for name, x in info["episode_metrics"].items()}
        info = {
            **info,
            "steps": steps,
            "truncation": jnp.zeros_like(done),
            self._limit: done,
            "episode_done": done,
            "episode_metrics": totals,
        }
        after = jax.lax.cond(
            jnp.any(over), lambda s: jax.vmap(env.reset_where)(s, over), lambda s: s, after
        )
        return after.replace(reward=reward, done=done, metrics=metrics, info=info)

    def _of(self, num_envs: int) -> Any:
        """Return the environment sized for a batch; only Warp's buffers depend on the size."""
        if getattr(self.env, "impl", None) != "warp":
            return self.env
        if num_envs not in self._sized:
            with jax.ensure_compile_time_eval():  # Brax calls from inside of jax.pmap
                self._sized[num_envs] = self.env.sized_for(num_envs)
        return self._sized[num_envs]


def _name(name: str) -> str:
    """Return the name of a metric that gives Brax the right aggregation."""
    return name + PER_STEP if name.startswith(FORCES) else name
