"""A scooper that presses on the bed.

Policies that were trained here played ten episodes with each robot in ArmManipulation of AG, where a scooper presses on the mattress's edge in
65 (Jaco) to 89 % (PR2) of the control steps. From states of these episodes, 1.5 s apart, in which it does, the next five actions (0.5 s) are played here in
C MuJoCo, from the same joint angles and speeds of robot and person, with AG's masses and motors (5 N m). Values are medians over these
states: by how much the robot's joint that turned farthest turned, and how far the robot's joint that is farthest from AG's is from it, in AG 0.
"""

from __future__ import annotations

import functools
from typing import NamedTuple

import numpy as np

import agym_jax
from agym_jax.human.population import Population
from agym_jax.robots import ROBOTS
from agym_jax.sim.c_mujoco import NativePhysics
from agym_jax.sim.contacts import contact_pairs, sides
from agym_jax.variation import RobotVariation
from benchmarks.parity.row import Row, traces
from benchmarks.recorded_episode import episode_in_place, play_on

APART = 0.03  # as for arms that touch nothing [rad]
TURNED_APART = 0.03  # [rad]


class Replays(NamedTuple):
    """Joints of a robot 0.5 s after each state."""

    turned: np.ndarray  # here, since then [rad]                              (n, n_arm)
    turned_there: np.ndarray  # in AG [rad]                                   (n, n_arm)

    @property
    def apart(self) -> np.ndarray:
        """Of the joint that is farthest from AG's [rad] (n,)."""
        return abs(self.turned - self.turned_there).max(-1)


@functools.cache
def replays(robot: str, rolling: float | None = None) -> Replays:
    """The recorded actions, played here.

    Args:
        robot: its name, such as ``"Jaco"``.
        rolling: rolling and spinning friction of the robot and its tools on the bed [m]; the task's unless given.
    """
    kept = _recorded(robot)
    env = agym_jax.make(
        f"ArmManipulation{robot}-v0", impl="native", humans=Population(masses="ag"),
        robot=RobotVariation(strength=(0.5, 0.5)),
    )  # fmt: skip
    physics = env.physics
    assert isinstance(physics, NativePhysics)
    if rolling is not None:
        touches = contact_pairs(env.task, ROBOTS[robot], env.scene.moving)
        for kind, pairs in touches.items():
            if sides(kind)[1] == "seat" and sides(kind)[0] != "human":
                rows = [physics.model.pair(f"{a}|{b}").id for a, b in pairs]
                physics.model.pair_friction[rows, 2:] = rolling
    episodes = [
        episode_in_place(
            env, {name: kept[name][case] for name in ("base", "chest", "body")},
            kept["q"][np.argmax(kept["case"] == case)], float(kept["sex"][case]), limit_scale=kept["limit_scale"][case],
        )
        for case in range(len(kept["sex"]))
    ]  # fmt: skip
    turned = []
    for i, case in enumerate(kept["case"]):
        start = {name: kept[name][i] for name in ("q", "qd", "person_q", "person_qd")}
        turned.append(play_on(env, episodes[case], start, kept["actions"][i]) - start["q"])
    return Replays(np.array(turned), kept["after"] - kept["q"])


def _recorded(robot: str) -> dict[str, np.ndarray]:
    """What is recorded of a robot."""
    start = f"{robot}_"
    return {k.removeprefix(start): x for k, x in traces("scooper").items() if k.startswith(start)}


def rows() -> list[Row]:
    """The comparison."""
    found = []
    for robot in ROBOTS:
        played = replays(robot)
        here, there = (
            float(np.median(abs(x).max(-1))) for x in (played.turned, played.turned_there)
        )
        what = f"{robot}: joint that turned farthest"
        found.append(Row(what, "rad", there, here, TURNED_APART, "bed-contact"))
        what, apart = f"{robot}: joint farthest from AG's", float(np.median(played.apart))
        found.append(Row(what, "rad", 0.0, apart, APART, "bed-contact"))
    return found
