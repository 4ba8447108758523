"""The cuff before the hand.

A policy of Jaco with a memory dressed a woman and a man in Assistive Gym, and missed another woman (seeds 7004, 7001 and 7006; unimpaired, weak, and with
limited joints). Its first 70 actions are played here from the same joint angles, six draws of the gown each: with an arm of capsules, with one as Assistive
Gym's cloth finds it (`tapered_arms`), and with that one and a gown that hung in front of the hand (`settled_gown`). Compared are the middle of the cuff, seen from
the wrist, from 1 s on until it meets the hand there, and whether the sleeve goes on. In the episode that fails, the cuff is where it is here until 3.4 s, 4 cm
before the tip of the hand, and then slides off beside the hand: as Assistive Gym's cloth finds it, a hand is an octahedron, with slopes to either side.
"""

from __future__ import annotations

from typing import Any

import jax
import numpy as np

import agym_jax
from agym_jax.tasks.dressing import BELOW_HAND
from benchmarks.parity.row import Row, traces
from benchmarks.recorded_episode import begin_as, episode_as

NAMES = ("a woman, missed", "a woman", "a man")
BEFORE = slice(10, 34)  # control steps
UP_THE_ARM = 0.2  # [m], from the tip of the hand
DRAWS = 6  # of the gown
NEAR = 0.04  # [m]
ARM: dict[str, Any] = {"tapered_arms": 1.0}


def play(env: agym_jax.Env, case: int, key: jax.Array) -> tuple[np.ndarray, bool]:
    """The middle of the cuff after each step, seen from the wrist, world axes [m] (n, 3); and whether the sleeve went on."""
    kept, state = traces("cuff"), env.reset(key)
    episode = episode_as(env, kept["q"][case], float(kept["sex"][case]), state.episode)
    state, path = begin_as(env, state, episode, key), []
    cuff = np.asarray(env.task.watched).ravel()  # type: ignore[attr-defined]
    for action, hand in zip(kept["action"][case], kept["hand"][case], strict=True):
        state = env.step(state, action)
        gown = np.asarray(state.task.cloth.pos_w)
        held = gown[np.asarray(env.task.spec.held) >= 0].mean(0)  # type: ignore[attr-defined]
        gripper = held + np.array((0.0, 0.0, BELOW_HAND))
        path.append(gown[cuff].mean(0) - gripper + hand)
    return np.array(path), float(state.task.best) > UP_THE_ARM


def rows() -> list[Row]:
    """Where the cuff is before it meets the hand, and whether the sleeve goes on."""
    kept, found = traces("cuff"), []
    for settings, what in (
        ({}, ""),
        (ARM, ", arm as there"),
        (ARM | {"settled_gown": 1.0}, ", arm and gown as there"),
    ):
        env = agym_jax.make("DressingJaco-v0", impl="native", config=settings or None)
        for case, name in enumerate(NAMES):
            played = [play(env, case, key) for key in map(jax.random.PRNGKey, range(DRAWS))]
            mean = np.mean([path[BEFORE] for path, _ in played], axis=0)
            off = float(np.linalg.norm(mean - kept["cuff"][case, BEFORE], axis=1).mean())
            on = float(np.mean([went for _, went in played]))
            found += [
                Row(f"{name}{what}: off on the way", "m", 0.0, off, NEAR, "gown-start"),
                Row(
                    f"{name}{what}: sleeve goes on, share", "", float(kept["success"][case]), on,
                    0.35, "cloth-obstacles",
                ),
            ]  # fmt: skip
    return found
