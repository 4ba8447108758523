"""The arm of an active person in bed.

In BedBathing, 24 people recorded in Assistive Gym moved one joint of the arm at a time with the full action, up and down, for 2 s.
Here 24 others do. Values are means over people. The bed's rolling friction holds the upper arm and the forearm in AG where they turn about
their lengths (second row), and not where the elbow bends and lifts the forearm (third row).
"""

from __future__ import annotations

import functools
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import agym_jax
from agym_jax.wrappers import vectorize
from benchmarks.parity.row import Row, traces

PEOPLE, STEPS = 24, 20  # of each action; control steps of 0.1 s
TURNS, LIFTS = ([5, 7], slice(None)), (6, 1)  # joints, and directions: 0 is the joint's own


@functools.cache
def moved() -> np.ndarray:
    """How far each joint turns in its own direction and against it [rad] (n_people, n_joints, 2)."""
    env = agym_jax.make("BedBathingJacoHuman-v0", impl="native")
    envs, qpos = vectorize(env, PEOPLE), env.scene.index.human_qpos
    n = env.action_sizes["human"]
    out = np.zeros((PEOPLE, n, 2))
    for joint in range(n):
        for side, sign in enumerate((1.0, -1.0)):
            state = envs.reset(jax.random.PRNGKey(0))
            action = np.zeros((PEOPLE, env.action_size), np.float32)
            action[:, env.action_sizes["robot"] + joint] = sign
            start = np.asarray(state.data.qpos)[:, qpos]
            for _ in range(STEPS):
                state = envs.step(state, jnp.asarray(action))
            out[:, joint, side] = (np.asarray(state.data.qpos)[:, qpos] - start)[:, joint]
    return out


def mean(moved: np.ndarray, which: tuple[Any, Any] = (slice(None), slice(None))) -> float:
    """Mean turn of some joints in some directions [rad]."""
    joints, directions = which
    return float(np.abs(moved[:, joints][..., directions]).mean())


def rows() -> list[Row]:
    """The comparison."""
    ag, ours = traces("lying_arm"), moved()
    kinds = {
        "all ten joints": (slice(None), slice(None)),
        "upper arm and forearm about their lengths": TURNS,
        "elbow, bending": LIFTS,
    }
    found = []
    for what, which in kinds.items():
        theirs = mean(ag["moved"], which)
        found.append(
            Row(f"{what}, mean turn", "rad", theirs, mean(ours, which), 0.2 * theirs, "bed-contact")
        )
    free = mean(ag["moved_without_rolling"])
    found.append(
        Row(
            "all ten joints, no rolling friction in AG",
            "rad",
            free,
            mean(ours),
            0.2 * free,
            "bed-contact",
        )
    )
    return found
