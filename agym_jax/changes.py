"""What of an environment is other than its id says: weights, people, robot, length. Part of what the environment is.

``agym_jax.make`` makes a changed task of ``config`` and ``episode_length``; ``changes_of`` names what differs from the
registered one. Checkpoints and policies carry it, so that those of different settings never mix.
"""

from __future__ import annotations

import dataclasses
import inspect
import math
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from numbers import Real
from typing import Any

from agym_jax.errors import ArgumentError, SpecError, UnknownNameError, checked_count
from agym_jax.human.population import Population
from agym_jax.spec import Task
from agym_jax.tasks import TASKS
from agym_jax.variation import RobotVariation

Changes = dict[str, Any]
"""Name, such as ``"task.scratch"`` or ``"humans.sizes"`` -> value that JSON can keep. Empty: as the id says."""
LENGTH = "episode_length"
CIRCUMSTANCES = ("humans.", LENGTH)
"""Beginnings of the names of changes that leave to a policy what its observations, actions and aims mean."""


@dataclass(frozen=True)
class Setting:
    """One thing that can be changed."""

    name: str  # "scratch", "preferences.velocity"
    default: Any
    unit: str
    meaning: str


def change_task(
    task: Task, config: Mapping[str, Any] | Any = None, episode_length: int | None = None
) -> Task:
    """A task with other weights, thresholds or length; the same task if nothing is other.

    Args:
        task: to be changed.
        config: names of fields of ``task.config`` -> values, nested or with dots (``{"preferences": {"velocity": 0.5}}``,
            ``{"preferences.velocity": 0.5}``); or a whole record of the same class; None for the task's own.
        episode_length: control steps; None for the task's own.

    Raises:
        UnknownNameError: the task has no such setting; the message has the nearest.
        ArgumentError: a value is no finite number, or a length is no whole number of at least 1.
        SpecError: the task refuses the value, or has no ``config``.
    """
    changed: dict[str, Any] = {}
    if config is not None:
        changed["config"] = _changed_record(task, "", _config_of(task), config)
    if episode_length is not None:
        changed[LENGTH] = checked_count(LENGTH, episode_length)
    changed = {name: x for name, x in changed.items() if x != getattr(task, name)}
    return dataclasses.replace(task, **changed) if changed else task  # pyrefly: ignore


def changes_of(task: Task, humans: Population, robot: RobotVariation | None = None) -> Changes:
    """What is other than in the environments of the registered task of this name.

    Args:
        task: of the environment.
        humans: its population.
        robot: how its robots vary, if they do.
    """
    usual = TASKS.get(task.name, task)
    found: Changes = {}
    config = getattr(task, "config", None)
    if dataclasses.is_dataclass(config) and usual is not task:
        found |= _differences("task", config, getattr(usual, "config", None))
    if task.episode_length != usual.episode_length:
        found[LENGTH] = task.episode_length
    found |= _differences("humans", humans, Population())
    return found | _differences("robot", robot or RobotVariation(), RobotVariation())


def describe(theirs: Changes, ours: Changes, whose: str = "there") -> str:
    """What differs between two environments of the same id, in words; empty if nothing does.

    Args:
        theirs: of the one.
        ours: of the other, which is "here".
        whose: what the first is called.
    """
    told = lambda changes, name: repr(changes[name]) if name in changes else "the default"  # noqa: E731
    return "; ".join(
        f"{name} is {told(theirs, name)} {whose}, {told(ours, name)} here"
        for name in sorted({*theirs, *ours})
        if theirs.get(name) != ours.get(name)
    )


def essential(changes: Changes) -> Changes:
    """Those without ``CIRCUMSTANCES``: of robot, weights and thresholds."""
    return {name: x for name, x in changes.items() if not name.startswith(CIRCUMSTANCES)}


def flags_of(changes: Changes) -> str:
    """The flags of the command lines that make these changes."""
    words = []
    for name, value in changes.items():
        values = value if isinstance(value, list) else [value]
        words.append(" ".join([f"--{name.replace('_', '-')}", *map(str, values)]))
    return " ".join(words)


def arguments_of(changes: Changes) -> dict[str, Any]:
    """The arguments of ``agym_jax.make`` that make these changes."""
    parts: dict[str, dict[str, Any]] = {}
    for name, value in changes.items():
        kind, _, field = name.partition(".")
        parts.setdefault(kind, {})[field] = tuple(value) if isinstance(value, list) else value
    found: dict[str, Any] = {}
    if "task" in parts:
        found["config"] = parts["task"]
    if LENGTH in parts:
        found[LENGTH] = parts[LENGTH][""]
    for kind, record in (("humans", Population), ("robot", RobotVariation)):
        if kind in parts:
            found[kind] = record(**parts[kind])
    return found


def settings_of(task: Task) -> list[Setting]:
    """What ``config`` can change of a task: its numbers, with units and meanings from the docstrings of their records."""
    config = getattr(task, "config", None)
    found = list(_settings("", config)) if dataclasses.is_dataclass(config) else []
    return [
        dataclasses.replace(x, meaning=f"{x.meaning} (none in this task)")
        if _idle(task, x.name)
        else x
        for x in found
    ]


def _idle(task: Task, name: str) -> bool:
    """Whether a setting is the weight of a preference that a task does not have."""
    kind, _, term = name.partition(".")
    return bool(term) and f"{kind.removesuffix('s')}_{term}" not in task.reward_terms


def settings_tables(task: Task) -> dict[str, list[Setting]]:
    """All that can be changed of a task's environments, by the arguments of ``agym_jax.make`` and the flags that do."""
    unit, meaning = "control steps", f"of {task.control.period:g} s that an episode has"
    return {
        "config={name: value}, --task.NAME": settings_of(task),
        f"{LENGTH}=, --episode-length": [Setting(LENGTH, task.episode_length, unit, meaning)],
        "humans=Population(name=value), --humans.NAME": list(_settings("", Population())),
        "robot=RobotVariation(name=value), --robot.NAME": list(_settings("", RobotVariation())),
    }


def settings_table(settings: list[Setting]) -> str:
    """Settings as a Markdown table."""
    lines = ["| name | default | unit | meaning |", "|---|---|---|---|"]
    lines += [f"| `{x.name}` | `{x.default!r}` | {x.unit} | {x.meaning} |" for x in settings]
    return "\n".join(lines).replace("``", "`")


def _settings(prefix: str, record: Any) -> Iterator[Setting]:
    documented = _documented(type(record))
    for field in dataclasses.fields(record):
        value = getattr(record, field.name)
        if dataclasses.is_dataclass(value):
            yield from _settings(f"{prefix}{field.name}.", value)
        else:
            unit, meaning = documented.get(field.name, ("", ""))
            yield Setting(f"{prefix}{field.name}", value, unit, meaning)


def _documented(record: type) -> dict[str, tuple[str, str]]:
    """Unit and meaning of the fields of a record, by its docstring's ``Attributes:``, as ``name: meaning [unit]``."""
    _, _, section = inspect.cleandoc(record.__doc__ or "").partition("Attributes:\n")
    entries = re.findall(r"^    (\w+): (.*(?:\n     +.*)*)", section, re.M)
    found = {}
    for name, text in entries:
        text = " ".join(text.split()).rstrip(".")
        unit = re.search(r"\s*\[([^]]+)\]$", text)
        found[name] = (unit[1] if unit else "", text[: unit.start()] if unit else text)
    return found


def _config_of(task: Task) -> Any:
    config = getattr(task, "config", None)
    if not dataclasses.is_dataclass(config):
        raise SpecError(
            f"{task.name} has no settings to change: its task has no field config, a frozen dataclass of numbers."
        )
    return config


def _changed_record(task: Task, prefix: str, record: Any, asked: Any) -> Any:
    """A record with some fields changed."""
    if isinstance(asked, type(record)):
        return asked
    if not isinstance(asked, Mapping):
        raise ArgumentError(
            f"config{prefix and '.' + prefix[:-1]} of {task.name} must be a dictionary of settings, such as "
            f'{{"{dataclasses.fields(record)[0].name}": 2.0}}, got {asked!r}.'
        )
    known = {field.name: getattr(record, field.name) for field in dataclasses.fields(record)}
    nested: dict[str, Any] = {}
    for name, value in asked.items():
        first, dot, rest = str(name).partition(".")
        if first not in known or (dot and not dataclasses.is_dataclass(known[first])):
            options = [setting.name for setting in settings_of(task)]
            raise UnknownNameError(f"setting of {task.name}:", f"{prefix}{name}", options)
        if dot:
            value = {**nested.get(first, {}), rest: value}
        nested[first] = value
    for name, value in nested.items():
        where = f"{prefix}{name}"
        if dataclasses.is_dataclass(known[name]):
            nested[name] = _changed_record(task, f"{where}.", known[name], value)
        else:
            nested[name] = _number(f"{task.name}'s setting {where}", value, known[name])
    return dataclasses.replace(record, **nested)


def _number(what: str, value: Any, default: Any) -> Any:
    """A value for a field with this default."""
    if isinstance(default, bool) or not isinstance(default, (int, float)):
        if type(value) is not type(default):
            raise ArgumentError(
                f"{what} must be a {type(default).__name__} such as {default!r}, got {value!r}."
            )
        return value
    number: float | None = None
    if isinstance(value, Real) and not isinstance(value, bool):
        number = float(value)
    whole = isinstance(default, int)
    if number is None or not math.isfinite(number) or (whole and number != int(number)):
        kind = "whole" if whole else "finite"
        raise ArgumentError(f"{what} must be a {kind} number such as {default}, got {value!r}.")
    return type(default)(number)


def _differences(prefix: str, record: Any, usual: Any) -> Changes:
    """Fields that differ, by their names with dots."""
    found: Changes = {}
    for field in dataclasses.fields(record):
        value, other = getattr(record, field.name), getattr(usual, field.name, None)
        name = f"{prefix}.{field.name}"
        if dataclasses.is_dataclass(value):
            found |= _differences(name, value, other)
        elif value != other:
            found[name] = list(value) if isinstance(value, tuple) else value
    return found
