"""Policies that dress.

The policies that shipped on 26 November 2026 dressed, or did not, in Assistive Gym (seeds 7000 to 7003 of each robot). Their first 100 actions (Jaco's 70)
are played here from the same bases and joint angles, four times each, with joints up to 1 mrad off: with the gown that hung in front of the most similarly
placed hand (`settled_gown`) and with a gown that swings to the hand. Compared is the share of the replays in which the cuff comes more than 0.2 m up the arm.
"""

from __future__ import annotations

import dataclasses
import functools
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import agym_jax
from agym_jax.state import State
from benchmarks.parity.row import Row, traces
from benchmarks.recorded_episode import begin_as, episode_as

ROBOTS = ("PR2", "Jaco", "Baxter", "Sawyer")
UP_THE_ARM = 0.2  # [m], from the tip of the hand
DRAWS = 4  # replays of each episode
OFF = 0.001  # of the joints [rad]


def cases(robot: str) -> np.ndarray:
    """Rows of the traces that a robot played (4,)."""
    return np.flatnonzero(traces("dressing")["robot"] == robot)


@functools.cache
def env_of(robot: str, settled: bool) -> agym_jax.Env:
    """The environment in which its actions are played."""
    config: dict[str, Any] = {"settled_gown": float(settled)}
    return agym_jax.make(f"Dressing{robot}-v0", impl="native", config=config)


def begin(env: agym_jax.Env, case: int, key: jax.Array) -> State:
    """The start of a replay of one row of the traces."""
    kept, state = traces("dressing"), env.reset(key)
    base = {x: jnp.asarray(kept[x][case]) for x in ("base_pos", "base_quat")}
    place = dataclasses.replace(state.episode.placement, **base)
    drawn = dataclasses.replace(state.episode, placement=place)
    off = np.asarray(jax.random.uniform(key, (7,), minval=-OFF, maxval=OFF))
    episode = episode_as(env, kept["q"][case] + off, float(kept["sex"][case]), drawn)
    return begin_as(env, state, episode, key)


def play(env: agym_jax.Env, case: int, key: jax.Array) -> float:
    """How far up the arm the cuff came in a replay, the tip of the hand being 0 [m]."""
    kept, state = traces("dressing"), begin(env, case, key)
    for action in kept["actions"][case, : kept["steps"][case]]:
        state = env.step(state, action)
    return max(float(state.task.best), 0.0)


def dressed(robot: str, settled: bool) -> float:
    """Share of a robot's replays in which the sleeve goes on."""
    env, keys = env_of(robot, settled), map(jax.random.PRNGKey, range(DRAWS))
    return float(np.mean([play(env, i, key) > UP_THE_ARM for key in keys for i in cases(robot)]))


def rows() -> list[Row]:
    """The comparison."""
    found = []
    for settled, name in ((True, "settled gown"), (False, "gown that swings")):
        for robot in ROBOTS:
            ag = float(np.mean(traces("dressing")["dressed"][cases(robot)] > UP_THE_ARM))
            quantity = f"{robot}'s policy, {name}: dressed, share of replays"
            found.append(Row(quantity, "", ag, dressed(robot, settled), 0.25, "gown-start"))
    return found
