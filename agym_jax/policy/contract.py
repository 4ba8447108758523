"""Specification of a policy's inputs and outputs, for running it outside agym_jax."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

import numpy as np

import agym_jax
from agym_jax import observe
from agym_jax.human.body import joint_limits
from agym_jax.policy.networks import OBSERVATION_CLIP
from agym_jax.spec import RobotSpec, Task

FORMAT = "agym_jax policy 1"
CONVENTIONS = {
    "world": "z up; one frame for scene, robot and person",
    "world axes, from X": "the difference of two positions in the world, seen along the world's axes",
    "quaternions": "w, x, y, z. At the start of an episode w > 0 where w * w > 1/4, and elsewhere the greatest of x, y, z is "
    "positive; from then on the sign that is nearer to the one before, so that none jumps",
    "joint angles": "arm_angles and human_angles are in the order of the action's entries; joints that turn freely begin in "
    "[-pi, pi) and count on from there",
    "averages": "columns named ..._mean_300ms are exponential moving averages of the column whose name they begin with, here with a "
    "time constant of 0.3 s: at the start of an episode the column itself; in every control step, the control period divided by "
    "the time constant is the share of the new value",
    "forces": "means over the last control step; 0 at the start of an episode",
}


def contract(env: Any, agent: str, info: Mapping[str, Any]) -> dict[str, str]:
    """Describe the meaning of all inputs and outputs: name -> text (JSON unless it is a word or a number).

    Args:
        env: an ``AssistiveEnv``.
        agent: acting agent: "robot", "human", or "joint" for both.
        info: information about the policy, see ``Policy``.
    """
    agents = ("robot", "human") if agent == "joint" and env.active else (agent,)
    told = {
        "format": FORMAT,
        "env": env.name,
        "agent": agent,
        "control_period_s": f"{env.dt:g}",
        "control_rate_hz": f"{1 / env.dt:g}",
        "observation": observation_entries(env, agents),
        "observation_use": "raw values; the graph subtracts means, divides by deviations and clips to "
        f"[-{OBSERVATION_CLIP:g}, {OBSERVATION_CLIP:g}]",
        "action": action_entries(env, agents),
        "action_meaning": {name: action_meaning(env.task, name) for name in agents},
        "conventions": CONVENTIONS,
        "trained": {name: x for name, x in info.items() if name != "agent"},
        "agym_jax": agym_jax.__version__,
    }
    return {name: x if isinstance(x, str) else json.dumps(x) for name, x in told.items()}


def observation_entries(env: Any, agents: tuple[str, ...]) -> list[dict[str, Any]]:
    """Describe the observation's columns, in order: name, first column and one past the last, unit, frame."""
    entries, start = [], 0
    for agent in agents:
        for name, column in observe.columns(env.observation_records[agent]).items():
            stop = start + column.size
            entries.append(
                {"name": name, "agent": agent, "start": start, "stop": stop, "unit": column.unit, "frame": column.frame}
            )  # fmt: skip
            start = stop
    return entries


def action_entries(env: Any, agents: tuple[str, ...]) -> list[dict[str, Any]]:
    """Describe the action's entries, in order: joint, its limits [rad], and the displacement of a full action of 1 [rad]."""
    scale, found = env.task.control.action_scale, []
    for agent in agents:
        names = acting_joints(env.robot, env.task, agent)
        if agent == "robot":
            limits = env.controller.robot_range
        else:
            limits = joint_limits(names, np.float32(1.0), np)
        found += [
            {
                "joint": name, "agent": agent, "low": -1, "high": 1, "full_action_rad": scale,
                "joint_limits_rad": [round(float(x), 6) for x in pair],
            }
            for name, pair in zip(names, limits, strict=True)
        ]  # fmt: skip
    return found


def acting_joints(robot: RobotSpec, task: Task, agent: str) -> tuple[str, ...]:
    """Return the joints that the entries of an agent's action move, in order; agent is "robot" or "human"."""
    if agent == "robot":
        return tuple(name for arm in robot.arms_for(task) for name in arm.joints)
    return task.human.moving(True)


def action_meaning(task: Task, agent: str) -> str:
    """Explain in words how an agent's action moves its joints."""
    control = task.control
    dt = control.time_step * control.frame_skip
    if agent == "robot":
        return (
            f"For {dt:g} s each joint's motor moves it towards the angle measured at the start of the control step plus "
            f"{control.action_scale:g} rad times the action (in steps of 0.05 rad times the action, none beyond the joint's "
            f"limits), at a velocity of {control.rate:g} /s times what is left, with at most {control.max_torque:g} N m."
        )
    return (
        f"For {dt:g} s the muscles of each joint pull it towards the angle measured at the start of the control step (with "
        f"tremor: the one held so far) plus {control.action_scale:g} rad times the action, within the joint's limits. Limits "
        "are those without an impairment, which narrows them."
    )
