"""A held arm that is pushed.

A policy that was trained here scratched in Assistive Gym with a Jaco: twelve episodes, six unimpaired men and women who hold still. Its
first 40 actions are played here from the same joint angles in C MuJoCo: the scratcher and the fingers come upon the arm after one
second and push it out of its pose. The value of AG is how far AG's own episodes end from each other when the robot's joints start
up to 1 mrad apart (two draws each). All are medians over episodes.
"""

from __future__ import annotations

import functools
from typing import NamedTuple

import jax
import numpy as np

import agym_jax
from agym_jax.human.population import Population
from benchmarks.parity.row import Row, traces
from benchmarks.recorded_episode import episode_as

STEPS = (10, 20, 40)
JOINTS_APART = 0.03  # as for arms that touch nothing [rad]
WRIST_APART = 0.02  # [m]


class Paths(NamedTuple):
    """Where robot and person are at the start and after every control step."""

    angles: np.ndarray  # of the robot [rad]                                  (n, steps + 1, 7)
    wrist: np.ndarray  # from where it was at the start, along world axes [m] (n, steps + 1, 3)
    force: np.ndarray  # on the person, in each step [N]                      (n, steps)


@functools.cache
def ours(masses: str, cases: tuple[int, ...] | None = None) -> Paths:
    """The recorded actions, played here.

    Args:
        masses: of the people, see ``Population``.
        cases: which; all unless given.
    """
    kept = traces("pushed_arm")
    env = agym_jax.make("ScratchItchJaco-v0", impl="native", humans=Population(masses=masses))
    aim, sense = jax.jit(env.controller.targets), jax.jit(env._sense)
    paths = []
    for case in range(len(kept["sex"])) if cases is None else cases:
        episode = episode_as(env, kept["q"][case, 0], float(kept["sex"][case]))
        data = env.physics.reset(env.physics.make_data(), episode)
        hand = env.scene.model.body("human/right_hand").id
        angles, wrist, force = [kept["q"][case, 0]], [np.asarray(data.xpos)[hand].copy()], []
        for action in kept["actions"][case]:
            data, sums, motion = env.physics.step(data, episode, aim(episode, data, action))
            sensed = sense(data, sums, motion, episode)
            angles.append(np.array(data.qpos[env.scene.index.robot_qpos]))
            wrist.append(np.asarray(data.xpos)[hand].copy())
            force.append(float(sensed.force_on_human))
        paths.append((angles, np.array(wrist) - wrist[0], force))
    return Paths(*(np.array(x, np.float32) for x in zip(*paths, strict=True)))


def recorded() -> Paths:
    """The episodes in Assistive Gym."""
    kept = traces("pushed_arm")
    return Paths(kept["q"], kept["wrist"] - kept["wrist"][:, :1], kept["force"])


def apart(one: Paths, other: Paths, step: int) -> tuple[np.ndarray, np.ndarray]:
    """Largest difference of a joint [rad] and distance of the wrists [m] after a control step (n,), (n,)."""
    joints = abs(one.angles - other.angles)[:, step].max(-1)
    return joints, np.linalg.norm((one.wrist - other.wrist)[:, step], axis=-1)


def itself() -> list[Paths]:
    """AG's episodes again, from joint angles up to 1 mrad off."""
    kept, ag = traces("pushed_arm"), recorded()
    draws = zip(*(kept[x].swapaxes(0, 1) for x in ("again_q", "again_wrist")), strict=True)
    return [
        Paths(
            np.concatenate([ag.angles[:, :1], q], 1),
            np.concatenate([0.0 * wrist[:, :1], wrist - kept["wrist"][:, :1]], 1),
            ag.force,
        )
        for q, wrist in draws
    ]


def rows() -> list[Row]:
    """The comparison."""
    ag, again, out = recorded(), itself(), []
    for masses, name, why in (
        ("ag", "AG's masses", ("jaco-hand", "jaco-hand")),
        ("body", "our masses", ("jaco-hand", "girdle-support")),
    ):
        mine = ours(masses)
        for i, (what, unit, tolerance) in enumerate(
            (("robot's joint farthest", "rad", JOINTS_APART), ("wrist", "m", WRIST_APART))
        ):
            for step in STEPS:
                theirs = float(np.median([apart(x, ag, step)[i] for x in again]))
                here = float(np.median(apart(mine, ag, step)[i]))
                quantity = f"{name}: {what} from AG's after {step} control steps, median"
                out.append(Row(quantity, unit, theirs, here, tolerance, why[i]))
        theirs, here = float(ag.force.mean()), float(mine.force.mean())
        quantity = f"{name}: force of robot and tool on the person, mean of 4 s"
        out.append(Row(quantity, "N", theirs, here, 0.25 * theirs, "jaco-hand"))
    return out
