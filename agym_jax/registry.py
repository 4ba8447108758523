"""Environment ids: the product of tasks, robots and people, and what users add to it."""

from __future__ import annotations

import difflib
from dataclasses import dataclass

from agym_jax.errors import SpecError, UnknownNameError
from agym_jax.robots import ROBOTS
from agym_jax.spec import RobotSpec, Task
from agym_jax.tasks import TASKS

VERSION = "v0"


@dataclass(frozen=True)
class Recipe:
    """What an id stands for."""

    name: str
    task: Task
    robot: RobotSpec
    active: bool


def register_task(task: Task) -> None:
    """Add a task from outside of the package; its ids exist for every robot at once.

    Raises:
        SpecError: there is a task of that name already.
    """
    if task.name in TASKS:
        raise SpecError(f"There is a task {task.name!r} already.")
    TASKS[task.name] = task


def register_robot(robot: RobotSpec) -> None:
    """Add a robot from outside of the package; its ids exist for every task at once.

    Raises:
        SpecError: there is a robot of that name already.
    """
    if robot.name in ROBOTS:
        raise SpecError(f"There is a robot {robot.name!r} already.")
    ROBOTS[robot.name] = robot


def list_envs() -> list[str]:
    """Every environment id, static person first."""
    return [
        f"{task}{robot}{human}-{VERSION}"
        for human in ("", "Human")
        for task in TASKS
        for robot in ROBOTS
    ]


def parse(name: str) -> Recipe:
    """What an id stands for, such as ``ScratchItchJaco-v0`` or ``ScratchItchJacoHuman-v0``.

    Raises:
        UnknownNameError: there is no such id; the message has the nearest, and says whether it is
            the task or the robot that does not exist.
    """
    plain = name.removeprefix("agym_jax:").removeprefix("agym_jax/")
    for task in TASKS.values():
        for robot in ROBOTS.values():
            for active in (False, True):
                known = f"{task.name}{robot.name}{'Human' if active else ''}-{VERSION}"
                if plain == known:
                    return Recipe(known, task, robot, active)
    raise UnknownNameError("environment", name, list_envs(), _advice(plain))


def _advice(name: str) -> str:
    stem = name.rsplit("-", 1)[0].removesuffix("Human")
    task = next((t for t in TASKS if stem.startswith(t)), None)
    if task and stem.removeprefix(task) not in ROBOTS:
        robot = stem.removeprefix(task)
        near = difflib.get_close_matches(robot, list(ROBOTS), n=1)
        guess = f" (did you mean {near[0]!r}?)" if near else ""
        return f"The task {task} exists, the robot {robot!r} does not{guess}; robots: {', '.join(ROBOTS)}."
    return f"Ids are task + robot + ('Human' for an active person) + '-{VERSION}'."
