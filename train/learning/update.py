"""Many updates in one call: a rollout of all environments, and what the agents learn from it.

The loop is written once. ``ONE_PROGRAM`` compiles it whole, ``STEPWISE`` runs it from Python around a compiled
environment.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp

from ..configs import LearnConfig
from .agents import Agents, LearnerState
from .constraint import record_comfort
from .execution import ONE_PROGRAM, Execution
from .ppo import Hyper
from .rollout import (
    RolloutState,
    Totals,
    collect,
    critic_obs,
    fold_in,
    record_step,
    split_keys,
    zero_totals,
)
from .seeds import SideBySide

LEARN = "learn"
"""Scope of what the agents learn from a rollout, in the names of operations (``benchmarks.training_profile``)."""
Run = Callable[..., tuple[LearnerState, RolloutState, Totals]]


def make_updates(
    venv: Any,
    config: LearnConfig,
    agents: Agents | SideBySide,
    axis: str | None = None,
    execution: Execution = ONE_PROGRAM,
) -> Run:
    """The function that makes ``count`` updates in one call.

    Args:
        venv: vectorised environment, of the environments of one device.
        config: resolved settings.
        agents: who learns, in one training or several side by side.
        axis: name of the axis of devices, if there are several.
        execution: how the loops run.

    Returns:
        ``run(learner, rollout, count, hyper)``: learner and rollout state afterwards, and totals over all
        updates: those of ``train.learning.rollout`` and ``loss/*``. ``count`` (int32) and ``hyper`` are
        arguments of the program: runs of every length and learning rate share one compilation.
    """
    record = record_step if config.cost_limit is None else record_comfort
    act, learn = execution.compile(agents.act), execution.compile(agents.learn)

    def run(
        learner: LearnerState, rollout: RolloutState, count: jax.Array, hyper: Hyper
    ) -> tuple[LearnerState, RolloutState, Totals]:
        def update(_: Any, carry: tuple) -> tuple:
            learner, rollout, totals = carry
            key, key_rollout, key_learn = split_keys(learner.key, 3)
            if axis is not None:
                index = jax.lax.axis_index(axis)
                key_rollout, key_learn = (fold_in(k, index) for k in (key_rollout, key_learn))
            rollout, batch, sums = collect(
                lambda obs, key: act(learner, obs, key),
                venv,
                rollout,
                key_rollout,
                num_steps=config.num_steps,
                gamma=hyper.gamma,
                reward_scaling=hyper.reward_scaling,
                execution=execution,
                record=record,
            )
            last = critic_obs(rollout.env_state)
            more = () if axis is None else (axis,)
            learner = replace(learner, key=key)
            with jax.named_scope(LEARN):
                learner, losses = learn(learner, batch, last, key_learn, hyper, *more)
            if axis is not None:
                sums = jax.lax.psum(sums, axis)
            sums |= {f"loss/{name}": value for name, value in losses.items()}
            return learner, rollout, {name: total + sums[name] for name, total in totals.items()}

        totals = zero_totals(rollout.env_state, agents.axes)
        totals |= {f"loss/{name}": jnp.zeros(agents.axes, jnp.float32) for name in agents.losses}
        return execution.fori_loop(0, count, update, (learner, rollout, totals))

    return run
