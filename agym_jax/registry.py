"""Environment ids: the product of tasks, robots and people, and what users add to it.

``my_module:WavingJaco-v0`` imports ``my_module``, which registers what it has, and then means
``WavingJaco-v0``: so every command line knows ids from outside of the package.
"""

from __future__ import annotations

import difflib
import importlib
import re
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from agym_jax.errors import SpecError, UnknownNameError
from agym_jax.robots import ROBOTS
from agym_jax.tasks import TASKS

if TYPE_CHECKING:
    from agym_jax.spec import RobotSpec, Task

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
        SpecError: there is a task of that name already, or the name cannot be part of an id.
    """
    _check_name("task", task.name)
    if task.name in TASKS:
        raise SpecError(f"There is a task {task.name!r} already.")
    TASKS[task.name] = task


def register_robot(robot: RobotSpec) -> None:
    """Add a robot from outside of the package; its ids exist for every task at once.

    Raises:
        SpecError: there is a robot of that name already, or the name cannot be part of an id.
    """
    _check_name("robot", robot.name)
    if robot.name in ROBOTS:
        raise SpecError(f"There is a robot {robot.name!r} already.")
    ROBOTS[robot.name] = robot


def _check_name(kind: str, name: str) -> None:
    """Raise if a name cannot be part of an id."""
    if not re.fullmatch(r"[A-Za-z][A-Za-z0-9_]*", name) or name.endswith("Human"):
        raise SpecError(
            f"A {kind} cannot be called {name!r}: ids are made of its name, as in ScratchItchJaco-{VERSION}. Use letters "
            f"and digits, beginning with a letter, and not Human at the end."
        )


def list_envs() -> list[str]:
    """Every environment id, static person first."""
    return [
        f"{task}{robot}{human}-{VERSION}"
        for human in ("", "Human")
        for task in TASKS
        for robot in ROBOTS
    ]


def parse(name: str) -> Recipe:
    """What an id stands for, such as ``ScratchItchJaco-v0`` or ``my_module:WavingJacoHuman-v0``.

    Args:
        name: an id; a module before it is imported first. The recipe's name is without it.

    Raises:
        UnknownNameError: there is no such module or id; the message has the nearest, and says whether
            it is the task or the robot that does not exist.
    """
    if not isinstance(name, str):
        raise UnknownNameError("environment", name, list_envs(), _advice("", ""))
    module, _, plain = name.removeprefix("agym_jax/").rpartition(":")
    _import(module, name)
    for task in TASKS:
        for robot in ROBOTS:
            for active in (False, True):
                if plain == f"{task}{robot}{'Human' if active else ''}-{VERSION}":
                    return Recipe(plain, TASKS[task], ROBOTS[robot], active)
    raise UnknownNameError("environment", name, list_envs(), _advice(plain, module))


def static_id(name: str) -> str:
    """The id of the same task and robot with a person who holds still."""
    return name.replace("Human-", "-")


def active_id(name: str) -> str:
    """The id of the same task and robot with a person who acts."""
    stem, _, version = static_id(name).rpartition("-")
    return f"{stem}Human-{version}"


def _import(module: str, name: str) -> None:
    """Import the module before an id's colon, unless it is the program that runs."""
    program = sys.modules["__main__"]
    running = (
        getattr(getattr(program, "__spec__", None), "name", None)
        or Path(getattr(program, "__file__", "")).stem
    )
    if module in ("", "agym_jax", running):
        return
    try:
        if not all(part.isidentifier() for part in module.split(".")):
            raise ModuleNotFoundError(name=module)
        importlib.import_module(module)
    except ModuleNotFoundError as error:
        if error.name is None or not f"{module}.".startswith(f"{error.name}."):
            raise  # the module is there, but something that it imports is not
        files = [p.stem for p in Path().glob("*.py")]
        advice = f"Is its folder on the Python path (PYTHONPATH), or the current one? It comes before the colon of {name!r}."
        raise UnknownNameError("module", module, files, advice) from None


def _advice(name: str, module: str) -> str:
    stem = name.rsplit("-", 1)[0].removesuffix("Human")
    task = next((t for t in TASKS if stem.startswith(t)), None)
    own = f"{module} was imported." if module else f"One of your own is my_module:{name}."
    if task and stem.removeprefix(task) not in ROBOTS:
        robot = stem.removeprefix(task)
        near = difflib.get_close_matches(robot, list(ROBOTS), n=1)
        guess = f" (did you mean {near[0]!r}?)" if near else ""
        return f"The task {task} exists, the robot {robot!r} does not{guess}; robots: {', '.join(ROBOTS)}. {own}"
    return f"Ids are task + robot + ('Human' for an active person) + '-{VERSION}'. {own}"
