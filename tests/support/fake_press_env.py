"""A finger, or two of them, paid for pressing harder than is comfortable; compiles in no time."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from fake_env import FakeEnv, FakeState
from fake_pair_env import FakePairEnv

from agym_jax.human.regions import NAMES, RegionForces, no_forces

LIMIT = 20.0  # that is comfortable [N]
HARDEST = 40.0  # that the finger can do [N]
GENTLE = ("force/peak_on_human", "force/of_comfort", "force/of_limit")


def _measured(first: FakeState) -> FakeState:
    """A first state in which nobody is touched."""
    metrics = first.metrics | dict.fromkeys(GENTLE, jnp.zeros(()))
    return first.replace(metrics=metrics, regions=no_forces())


def _pressed(after: FakeState, action: jax.Array, episode_length: int) -> FakeState:
    """A state after a step in which the mean of two actions pressed on a forearm."""
    force = HARDEST * 0.5 * (1 + jnp.mean(jnp.clip(action, -1, 1)))
    row = jnp.zeros(len(NAMES)).at[NAMES.index("forearm")].set(force)
    metrics = after.metrics | {
        "force/on_human": force,
        "force/peak_on_human": force,
        "force/of_comfort": force / LIMIT,
        "force/of_limit": force / 320.0,
        "success": (force > 5.0).astype(jnp.float32),
    }
    reward = force / HARDEST / episode_length
    return after.replace(reward=reward, metrics=metrics, regions=RegionForces.of(row, row))


@dataclass
class FakePressEnv(FakeEnv):
    """One environment: presses on a forearm with 0 to 40 N as its actions say, and is paid 1 for 40 N in all 20 steps."""

    name: str = "FakePress-v0"
    action_sizes: dict[str, int] = field(default_factory=lambda: {"robot": 2})
    comfort: Any = field(default_factory=lambda: np.full(len(NAMES), LIMIT, np.float32))

    def _first(self, key: jax.Array) -> FakeState:
        return _measured(super()._first(key))

    def step(self, state: FakeState, action: jax.Array) -> FakeState:
        """Press by the mean of two actions."""
        return _pressed(super().step(state, action), action, self.episode_length)


@dataclass
class FakePairPressEnv(FakePairEnv):
    """The same of robot and person, each with one of the two actions."""

    task_name: str = "FakePress"

    def _first(self, key: jax.Array) -> FakeState:
        return _measured(super()._first(key))

    def step(self, state: FakeState, action: jax.Array) -> FakeState:
        """Press by the mean of both actions."""
        return _pressed(super().step(state, action), action, self.episode_length)
