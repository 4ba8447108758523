"""Several trainings side by side, one for each seed: one batch of environments, many learners.

The environments of all seeds are one flat batch, seed after seed, because a simulator steps one large batch faster
than several small ones. All that learns (networks, optimisers, statistics, random keys, hyper-parameters) has a
leading axis of seeds, and what reads it is vmapped over that axis. Seed s learns as it would alone.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from agym_jax.policy.policy import Policy

from ..configs import LearnConfig
from .agents import Agents, LearnerState
from .ppo import Hyper
from .rollout import Batch

CANDIDATE_STRIDE = 1_000_003
"""Between the seeds of two candidates of a training."""


@dataclass(frozen=True)
class Lane:
    """One of the trainings of a run.

    Attributes:
        name: its folder in that of the run.
        seed: of its networks, environments and exploration.
        config: settings; lanes of a run differ in what ``Hyper`` holds at most.
    """

    name: str
    seed: int
    config: LearnConfig


def lanes_of(config: LearnConfig) -> list[Lane]:
    """The trainings that a configuration asks for: one for each seed."""
    seeds = range(config.seed, config.seed + config.num_seeds)
    return [Lane(f"seed_{seed}", seed, config) for seed in seeds]


def candidates_of(config: LearnConfig) -> list[Lane]:
    """The trainings of which those of ``lanes_of`` are the best, ``num_candidates`` for each seed, seed after seed.

    The first candidate of a seed is what would be trained without candidates.
    """
    return [
        Lane(f"{lane.name}/candidate_{number + 1}", lane.seed + CANDIDATE_STRIDE * number, config)
        for lane in lanes_of(config)
        for number in range(config.num_candidates)
    ]


def lane_keys(lanes: Sequence[Lane]) -> jax.Array:
    """The random key of a single lane (2,), or those of several (lanes, 2)."""
    keys = jnp.stack([jax.random.PRNGKey(lane.seed) for lane in lanes])
    return keys if len(lanes) > 1 else keys[0]


class SideBySide:
    """As ``Agents``, with a leading axis of seeds in all that learns.

    Args:
        agents: of one training.
        lanes: the trainings.

    Attributes:
        axes: the leading axes of the learner.
    """

    def __init__(self, agents: Agents, lanes: Sequence[Lane]) -> None:
        self.single, self.lanes, self.count, self.axes = agents, lanes, len(lanes), (len(lanes),)
        self.config, self.trainer, self.losses = agents.config, agents.trainer, agents.losses

    def init(self, keys: jax.Array) -> LearnerState:
        """Agents that have seen nothing, from the key of each seed (seeds, 2)."""
        # one after the other: in batches of large QR factorisations, jaxlib 0.10 hangs on two CPU cores
        return jax.lax.map(self.single.init, keys)

    def act(
        self, learner: LearnerState, obs: jax.Array, keys: jax.Array
    ) -> tuple[jax.Array, jax.Array, dict[str, jax.Array]]:
        """As ``Agents.act``, for the environments of all seeds (B, observation)."""
        own = obs.reshape(self.count, -1, *obs.shape[1:])
        acted = jax.vmap(self.single.act)(learner, own, keys)
        return jax.tree.map(lambda x: x.reshape(-1, *x.shape[2:]), acted)

    def learn(
        self,
        learner: LearnerState,
        batch: Batch,
        last: jax.Array,
        keys: jax.Array,
        hyper: Hyper,
        axis: str | None = None,
    ) -> tuple[LearnerState, dict[str, jax.Array]]:
        """As ``Agents.learn``, of each seed from its own environments; where ``hyper.learns`` is 0, nothing changes.

        Returns:
            The learners, and losses (seeds,).
        """

        def one(
            learner: LearnerState, batch: Batch, last: jax.Array, key: jax.Array, hyper: Hyper
        ) -> tuple[LearnerState, dict[str, jax.Array]]:
            return self.single.learn(learner, batch, last, key, hyper, axis)

        by_seed = jax.tree.map(lambda x: x.reshape(x.shape[0], self.count, -1, *x.shape[2:]), batch)
        last = last.reshape(self.count, -1, *last.shape[1:])
        hyper_axes = jax.tree.map(lambda _: 0, hyper)
        if len({lane.config.recompute_advantages for lane in self.lanes}) == 1:
            # one branch of a conditional for all seeds; of one for each seed, vmap computes both branches
            hyper = replace(hyper, recompute_advantages=hyper.recompute_advantages[0])
            hyper_axes = replace(hyper_axes, recompute_advantages=None)
        learned, losses = jax.vmap(one, in_axes=(0, 1, 0, 0, hyper_axes))(
            learner, by_seed, last, keys, hyper
        )

        def chosen(new: jax.Array, old: jax.Array) -> jax.Array:
            learns = hyper.learns.reshape(-1, *(1 for _ in new.shape[1:])) > 0
            return jnp.where(learns, new, old)

        return jax.tree.map(chosen, learned, learner), losses

    def hyper(self, total_steps: float) -> Hyper:
        """The hyper-parameters of all seeds, NumPy arrays (seeds,) each."""
        length = self.single.episode_length
        each = [Hyper.of(lane.config, total_steps, length) for lane in self.lanes]
        return jax.tree.map(lambda *x: np.stack(x), *each)

    def of_seeds(self, learner: LearnerState) -> list[LearnerState]:
        """The learner of each seed."""
        return [jax.tree.map(lambda x, i=i: x[i], learner) for i in range(self.count)]

    def policies(self, learner: LearnerState, info: Mapping[str, Any]) -> dict[str, Policy]:
        """As ``Agents.policies``, of the learner of one seed."""
        return self.single.policies(learner, info)

    def compatibility(self) -> dict[str, Any]:
        """As ``Agents.compatibility``."""
        names = [lane.name for lane in self.lanes]
        return {**self.single.compatibility(), "lanes": names}


def stacked(learners: Sequence[LearnerState]) -> LearnerState:
    """The learner of a run, from those of its seeds (the opposite of ``of_seeds``)."""
    if len(learners) == 1:
        return learners[0]
    return jax.tree.map(lambda *x: jnp.stack(x), *learners)


def keep_learner(learner: LearnerState, kept: LearnerState, index: int) -> LearnerState:
    """The learners, but with that of one seed from ``kept``."""
    return jax.tree.map(lambda new, old: new.at[index].set(old[index]), learner, kept)
