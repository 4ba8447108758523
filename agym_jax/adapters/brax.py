"""Brax's trainers on every environment: a new human in each episode, Brax itself unchanged.

    from agym_jax.adapters.brax import wrap_for_brax_training
    from brax.training.agents.ppo import train as ppo

    env = agym_jax.make("ReachingSawyer-v0")
    ppo.train(env, ..., episode_length=env.episode_length, wrap_env_fn=wrap_for_brax_training)

Brax's ``AutoResetWrapper`` begins every episode from the state of the first one. Here an episode that ends is
followed by one with another human, goal and start. ``docs/brax.md`` has a full example.
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
"""Brax divides the sum of a metric by the length of the episode if its name ends like this."""


def wrap_for_brax_training(
    env: Any,
    episode_length: int = 200,
    action_repeat: int = 1,
    randomization_fn: Callable | None = None,
    bootstrap_on_timeout: bool = False,
) -> BraxTrainingEnv:
    """What Brax's trainers take as ``wrap_env_fn``; for ``agym_jax.make``'s environments.

    Args:
        env: from ``agym_jax.make``, not wrapped.
        episode_length: control steps after which an episode is cut; the task's own length at most.
        action_repeat: control steps that every action is held for.
        randomization_fn: none is taken, see ``humans`` of ``agym_jax.make``.
        bootstrap_on_timeout: as ``brax.training.agents.ppo.train.train`` has it, with
            ``functools.partial``: time limits are told in ``info["time_out"]``, not in ``info["truncation"]``.

    Raises:
        WrapperError: the environment is wrapped already, cannot be compiled, or there is a
            ``randomization_fn``; or the length is not a multiple of ``action_repeat``.
    """
    brax_jax.apply()
    if randomization_fn is not None:
        raise WrapperError(
            "randomization_fn changes the one model of a Brax environment (DomainRandomizationVmapWrapper); here "
            "every human has a model of their own, drawn anew in each episode. Leave it out, and say "
            "what to draw with agym_jax.make(name, humans=Population(sizes='continuous'), robot=RobotVariation(...))."
        )
    return BraxTrainingEnv(env, episode_length, action_repeat, bootstrap_on_timeout)


class BraxTrainingEnv(Wrapper):
    """A batch of environments by Brax's conventions, with auto-reset; as large as the keys that reset it.

    ``state.info`` has ``steps``, ``truncation``, ``episode_done`` and ``episode_metrics`` as Brax's
    ``EpisodeWrapper`` writes them. ``state.metrics`` are such that Brax's sum over an episode says something:
    rewards by their terms; ``success``, 1 at the last step of an episode that succeeded; ``force/..._per_step`` [N],
    which Brax turns into means; and counts of ``nan`` and ``overflow``.

    Args:
        env: from ``agym_jax.make``.
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
                f"{type(env).__name__}, which is a wrapper already. Pass what it wraps."
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
                f"An episode of {self.episode_length} steps cannot be made of actions that are held for "
                f"{action_repeat}. Choose an episode_length (at most {env.episode_length}) that is a "
                f"multiple of action_repeat."
            )

    def reset(self, rng: Array) -> Any:
        """Fresh episodes.

        Args:
            rng: PRNG keys, raw (B, 2) or typed (B,).

        Raises:
            WrapperError: there is one key only.
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
        """Hold the actions for ``action_repeat`` control steps; then begin anew where an episode is over.

        Args:
            state: of the batch.
            action: (B, action_size).

        Raises:
            ActionError: the actions have another shape.
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
        failed = jnp.any(metrics["nan"] > 0, axis=0)
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
            self._limit: done * ~failed,
            "episode_done": done,
            "episode_metrics": totals,
        }
        after = jax.lax.cond(
            jnp.any(over), lambda s: jax.vmap(env.reset_where)(s, over), lambda s: s, after
        )
        return after.replace(reward=reward, done=done, metrics=metrics, info=info)

    def _of(self, num_envs: int) -> Any:
        """The environment with room for a batch; only Warp's buffers depend on it."""
        if getattr(self.env, "impl", None) != "warp":
            return self.env
        if num_envs not in self._sized:
            with jax.ensure_compile_time_eval():  # Brax calls from inside of jax.pmap
                self._sized[num_envs] = self.env.sized_for(num_envs)
        return self._sized[num_envs]


def _name(name: str) -> str:
    """A metric's name as Brax shall read it."""
    return name + PER_STEP if name.startswith(FORCES) else name
