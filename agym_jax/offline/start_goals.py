"""What the hands of a robot have to reach: the start of an episode, and further goals on the person."""

from __future__ import annotations

from typing import Any

import jax
import numpy as np

from agym_jax.errors import SpecError
from agym_jax.human import body, population
from agym_jax.human import pose as human_pose
from agym_jax.math3d import axis_angle_quat, quat_mul, rotation_matrix
from agym_jax.offline.bullet_ik import bullet_quat
from agym_jax.spec import Goal, Quat, RobotSpec, Task


def goals_of(task: Task, robot: RobotSpec, n_arms: int) -> list[list[Goal]]:
    """What each arm of a pair has to reach besides its start; a single arm, all of a task's goals."""
    goals = [[Goal.of(goal) for goal in of_arm] for of_arm in task.goals]
    if n_arms != len(goals):
        goals = [[goal for of_arm in goals for goal in of_arm]]
    if not robot.base_search(task.name).requires_goals:
        goals = [[goal for goal in of_arm if not goal.required] for of_arm in goals]
    return goals


def goal_quat(goal: Goal, start: Quat) -> Quat | None:
    """Orientation of a hand at a goal, world, wxyz, given that at the start; None where it is free."""
    if goal.yaw is None:
        return None
    turn = axis_angle_quat(np.array([0.0, 0.0, 1.0]), np.array(goal.yaw), np)
    return tuple(quat_mul(turn, np.array(start), np).tolist())


def start_quat(task: Task, robot: RobotSpec, arm: int, scene: Any) -> Quat:
    """Orientation of a hand's end-effector site at the start, world, wxyz.

    By default the hand points along +x, at the person, and its fingers open sideways.
    """
    if task.name in robot.start_rotations:
        return robot.start_rotations[task.name]
    model, spec = scene.model, scene.arms[arm]
    rot = lambda name: rotation_matrix(model.site(f"robot/{name}").quat, np)  # noqa: E731
    tool_in_hand = rot(spec.end_effector).T @ rot(spec.tool_frame)
    forwards = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    return tuple(bullet_quat((forwards @ tool_in_hand.T)[:, :, None])[:, 0].tolist())


def draw_goals(
    task: Task,
    robot: RobotSpec,
    goals: list[list[Goal]],
    rows: int,
    seed: int,
    rng: np.random.Generator,
) -> tuple[np.ndarray, list[np.ndarray]]:
    """Where the hands start and what they have to reach, for R rows and as many people (64 different ones).

    Args:
        task: of the pair.
        robot: of the pair.
        goals: of each arm.
        rows: R.
        seed: of starts and people.
        rng: says who is the person of which row.

    Returns:
        start positions, world [m] (R, n_arms, 3), and goals of each arm, world [m] (R, n_goals, 3).

    Raises:
        SpecError: the task has fewer starts than the robot has arms.
    """
    n_arms = len(goals)
    keys = jax.random.split(jax.random.PRNGKey(seed), rows)
    start = np.asarray(jax.vmap(lambda k: task.start(k, robot.name))(keys))
    if start.ndim != 3 or start.shape[1] < n_arms or start.shape[2] != 3:
        raise SpecError(
            f"{task.name}.start must give one row [m] for each arm, of shape ({n_arms}, 3); with "
            f"{robot.name} it gives {start.shape[1:]}."
        )
    humans = _points(task, [g.link for of_arm in goals for g in of_arm], 64, seed)
    who = rng.integers(0, 64, rows)
    points = [
        np.stack([humans[g.link][who] + (0.0, 0.0, g.above) for g in of_arm], axis=1)
        if of_arm
        else np.zeros((rows, 0, 3))
        for of_arm in goals
    ]
    return start[:, :n_arms].astype(float), points


def _points(task: Task, names: list[str], count: int, seed: int) -> dict[str, np.ndarray]:
    """Positions of named points of sampled people, world [m] name -> (count, 3)."""
    spec = task.human

    def one(key: jax.Array) -> tuple[population.Human, human_pose.BodyPose]:
        key_human, key_pose = jax.random.split(key)
        human = population.sample_human(
            key_human,
            population.Population(),
            len(spec.joints),
            spec.tremor_amplitude,
            spec.impairments,
        )
        return human, human_pose.sample_pose(key_pose, spec, human)

    keys = jax.random.split(jax.random.PRNGKey(seed), count)
    drawn = jax.tree.map(np.asarray, jax.jit(jax.vmap(one))(keys))
    order = [link.name for link in body.LINKS]
    found: dict[str, list] = {name: [] for name in names}
    for i in range(count):
        human, pose = jax.tree.map(lambda x: x[i], drawn)  # noqa: B023
        # no joint is free here, so every link has a pose in the world
        rows = human_pose.rows(spec, pose, human.dims, (), human.limit_scale, np)
        for name in found:
            if name == "mouth":
                point = human_pose.mouth_of(spec, pose, human.dims, human.limit_scale, np)
            else:
                point = rows.body_pos[order.index(name)]
            found[name].append(np.array(point))
    return {name: np.array(rows) for name, rows in found.items()}
