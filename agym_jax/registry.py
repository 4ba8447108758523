"""Environment ids: every combination of task, robot and person, including those that users register.

``my_module:WavingJaco-v0`` first imports ``my_module``, which registers its tasks and robots, and then stands for
``WavingJaco-v0``. This makes environments from outside the package available to every command line.
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
    """The task, robot and kind of person that an id stands for."""

    name: str
    task: Task
    robot: RobotSpec
    active: bool


def register_task(task: Task) -> None:
    """Register a task from outside the package; its ids become available for every robot.

    Raises:
        SpecError: if a task of that name already exists, or the name cannot be part of an id.
    """
    _check_name("task", task.name)
    if task.name in TASKS:
        raise SpecError(f"There is a task {task.name!r} already.")
    TASKS[task.name] = task


def register_robot(robot: RobotSpec) -> None:
    """Register a robot from outside the package; its ids become available for every task.

    Raises:
        SpecError: if a robot of that name already exists, or the name cannot be part of an id.
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
            f"and digits, begin with a letter, and do not end with Human."
        )


def list_envs() -> list[str]:
    """Return every environment id, those with a static person first."""
    return [
        f"{task}{robot}{human}-{VERSION}"
        for human in ("", "Human")
        for task in TASKS
        for robot in ROBOTS
    ]


def parse(name: str) -> Recipe:
    """Parse an id, such as ``ScratchItchJaco-v0`` or ``my_module:WavingJacoHuman-v0``.

    Args:
        name: an id. If a module precedes it, that module is imported first; the recipe's name does not include it.

    Raises:
        UnknownNameError: if there is no such module or id; the message suggests the closest match and says whether
            it is the task or the robot that does not exist.
    """
    if not isinstance(name, str):
        raise UnknownNameError("environment", name, list_envs(), _advice("", ""))
    module, plain = name.removeprefix("agym_jax/").rpartition(":")[0], plain_id(name)
    _import(module, name)
    for task in TASKS:
        for robot in ROBOTS:
            for active in (False, True):
                if plain == f"{task}{robot}{'Human' if active else ''}-{VERSION}":
                    return Recipe(plain, TASKS[task], ROBOTS[robot], active)
    raise UnknownNameError("environment", name, list_envs(), _advice(plain, module))


def plain_id(name: str) -> str:
    """Return an id without what may precede it: the module of a plug-in (``my_module:``), or Gymnasium's namespace (``agym_jax/``)."""
    return name.removeprefix("agym_jax/").rpartition(":")[2]


def static_id(name: str) -> str:
    """Return the id of the same task and robot with a person who holds still."""
    return name.replace("Human-", "-")


def active_id(name: str) -> str:
    """Return the id of the same task and robot with a person who acts."""
    stem, _, version = static_id(name).rpartition("-")
    return f"{stem}Human-{version}"


def _import(module: str, name: str) -> None:
    """Import the module before an id's colon, unless it is the running program itself."""
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
