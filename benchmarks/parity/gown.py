"""The gown in the hand.

In Assistive Gym (AG) and here a Jaco played the same actions from the same joint angles, before unimpaired people: three paths
of a script, 0.15 m above the arm, and one of a former policy, fast and 0.25 m above the arm, which had dressed people here while episodes
began with the hand in the gown and the gown passed the hand with room to spare. Compared are whether the sleeve goes on, how far up the
arm the cuff comes, and AG's number of the gown's force from 4 s on: here newtons times `AG_FORCE`.
"""

from __future__ import annotations

from typing import Any

import jax
import numpy as np

import agym_jax
from agym_jax.tasks import dressing
from benchmarks.parity.row import Row, traces
from benchmarks.recorded_episode import begin_as, episode_as

NAMES = ("script, a man", "script, a woman", "script, another man", "former policy, a man")
ON = (1.0, 0.0, 1.0, 0.0)
"""Whether the sleeve was ever on the forearm in Assistive Gym. The woman's passes beside it, and the upper arm crosses the cuff
at the end."""
ON_HAND = 40  # control steps until the gown is on the hand
NEAR = 0.08  # of the same place on the arm [m]
STARTS = 8  # of the gown here, drawn


def play(env: agym_jax.Env, case: int, key: jax.Array) -> tuple[np.ndarray, float]:
    """AG's number of the gown's force (200,), and how far up the arm the cuff came, the person's tip of the hand being 0 [m]."""
    kept, state = traces("gown"), env.reset(key)
    episode = episode_as(env, kept["q"][case], float(kept["sex"][case]), state.episode)
    state, felt = begin_as(env, state, episode, key), []
    for action in kept["action"][case]:
        state = env.step(state, action)
        felt.append(float(dressing.felt(state.task)))
    return np.array(felt), max(float(state.task.best), 0.0)


def rows() -> list[Row]:
    """Whether it goes on, how far, and how hard it presses, on capsules and on an arm as Assistive Gym's cloth finds it."""
    settings: tuple[tuple[dict[str, Any] | None, str], ...] = (
        (None, ""),
        ({"tapered_arms": 1.0}, ", arm as there"),
    )
    return [
        row
        for config, what in settings
        for env in [agym_jax.make("DressingJaco-v0", impl="native", config=config)]
        for case, name in enumerate(NAMES)
        for row in compared(env, case, name + what)
    ]


def compared(env: agym_jax.Env, case: int, name: str) -> list[Row]:
    """The comparison of one recorded episode."""
    kept = traces("gown")
    played = [play(env, case, jax.random.PRNGKey(start)) for start in range(STARTS)]
    on = [x for x in played if x[1] > 0.2]
    share = len(on) / STARTS
    found = [
        Row(f"{name}: sleeve goes on, share of starts", "", ON[case], share, 0.35, "gown-start")
    ]
    if ON[case] and on:
        best = float(np.mean([x[1] for x in on]))
        found.append(Row(f"{name}: cuff up the arm", "m", float(kept["best"][case]), best, NEAR))
        ag, ours = (
            float(np.mean([x[ON_HAND:] for x in xs]))
            for xs in (kept["number"][[case]], [x[0] for x in on])
        )
        found.append(
            Row(f"{name}: number of the gown's force", "", ag, ours, 0.3 * ag, "cloth-force")
        )
    return found
