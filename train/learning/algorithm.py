"""What the training loop asks of a way to learn, and the simplest one: one learner for all.

The loop (``train.runs.session``), the compiled update (``train.learning.update``) and the stepwise one
(``train.learning.stepwise``) know only ``Algorithm``; ``train.learning.agents`` has the one with two learners.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, Protocol

import jax
import jax.numpy as jnp

from agym_jax.policy.networks import Architecture, make_networks, sample_action
from agym_jax.policy.policy import Policy

from ..configs import LearnConfig
from .ppo import LOSSES, LearnerState, architecture, init_learner, learn
from .rollout import Batch

STARTING = ("init_noise_std", "policy_head_gain")  # of an architecture; matter at the start only


class Algorithm(Protocol):
    """A way to learn: pure functions of a learner, which is a tree with ``key`` and ``env_steps``."""

    trainer: str  # the module that trains so, as in files and messages
    losses: tuple[str, ...]  # names of the scalars that ``learn`` returns

    def init(self, key: jax.Array) -> Any:
        """A learner that has seen nothing."""

    def act(self, learner: Any, obs: jax.Array, key: jax.Array) -> tuple[jax.Array, jax.Array, Any]:
        """Action, raw sample and log-probability for observations (B, observation)."""

    def learn(
        self,
        learner: Any,
        batch: Batch,
        last: jax.Array,
        key: jax.Array,
        total_steps: jax.Array,
        axis: str | None = None,
    ) -> tuple[Any, dict[str, jax.Array]]:
        """One update.

        Args:
            learner: before it.
            batch: as collected.
            last: what ``train.learning.rollout.critic_obs`` tells of the environments after it    (B, all).
            key: random key.
            total_steps: see ``train.learning.ppo.learn``.
            axis: the same.
        """

    def policies(self, learner: Any, info: Mapping[str, Any]) -> dict[str, Policy]:
        """The present policies by agent; ``info`` is what their files tell of the run."""

    def belongs(self) -> dict[str, Any]:
        """Name -> value of what a checkpoint must agree in, besides the environment."""


def policy_of(learner: LearnerState, arch: Architecture, info: Mapping[str, Any]) -> Policy:
    """A learner's present policy."""
    info = {**info, "env_steps": int(learner.env_steps)}
    mean, std = jnp.asarray(learner.normalizer.mean), jnp.asarray(learner.normalizer.std)
    return Policy(learner.params.policy, mean, std, arch, info)


def shape_of(arch: Architecture) -> dict[str, Any]:
    """What of an architecture decides whether weights fit, for JSON."""
    kept = {name: value for name, value in vars(arch).items() if name not in STARTING}
    return {k: list(v) if isinstance(v, tuple) else v for k, v in kept.items()}


def privileged_obs_size(config: LearnConfig, env: Any) -> int:
    """How much that nobody observes the value functions read."""
    return getattr(env, "privileged_obs_size", 0) if config.privileged_critic else 0


class OneLearner:
    """PPO of one policy that sees and moves all there is.

    Args:
        config: resolved settings.
        env: says how large observations and actions are, and who acts.
    """

    trainer = "ppo"
    losses: tuple[str, ...] = LOSSES

    def __init__(self, config: LearnConfig, env: Any) -> None:
        self.config, self.layout = config, env.layout_version
        self.agent = "joint" if len(env.action_sizes) > 1 else "robot"
        self.arch = architecture(config, env.observation_size, env.action_size)
        privileged_obs = privileged_obs_size(config, env)
        self.value_size = env.observation_size + privileged_obs if privileged_obs else None
        self.networks = make_networks(self.arch, self.value_size)

    def init(self, key: jax.Array) -> LearnerState:
        """See ``Algorithm``."""
        return init_learner(self.config, self.arch, key, self.value_size)

    def act(
        self, learner: LearnerState, obs: jax.Array, key: jax.Array
    ) -> tuple[jax.Array, jax.Array, jax.Array]:
        """See ``Algorithm``."""
        return sample_action(self.networks, learner.normalizer, learner.params.policy, obs, key)

    def learn(
        self,
        learner: LearnerState,
        batch: Batch,
        last: jax.Array,
        key: jax.Array,
        total_steps: jax.Array,
        axis: str | None = None,
    ) -> tuple[LearnerState, dict[str, jax.Array]]:
        """See ``Algorithm``."""
        if self.value_size is None:
            seen = slice(0, self.arch.observation_size)
            batch = replace(
                batch, value_obs=None, final_observation=batch.final_observation[..., seen]
            )
            last = last[..., seen]
        return learn(learner, batch, last, key, self.config, self.networks, total_steps, axis)

    def policies(self, learner: LearnerState, info: Mapping[str, Any]) -> dict[str, Policy]:
        """See ``Algorithm``."""
        info = {**info, "agent": self.agent, "layout": self.layout}
        return {self.agent: policy_of(learner, self.arch, info)}

    def belongs(self) -> dict[str, Any]:
        """See ``Algorithm``."""
        return shape_of(self.arch) | {"value_size": self.value_size}
