"""Settings of an environment that differ from the defaults of its id: weights, population, robot, memory and episode length.

``agym_jax.make`` applies ``config`` and ``episode_length`` to the task; ``changes_of`` lists what differs from the
registered task. Checkpoints and policies store these changes, so that those with different settings are never mixed up.
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
from agym_jax.memory import MEMORY, Memory
from agym_jax.spec import Task
from agym_jax.tasks import TASKS
from agym_jax.variation import RobotVariation

Changes = dict[str, Any]
"""Name, such as ``"task.scratch"`` or ``"humans.sizes"`` -> JSON-serialisable value. Empty if nothing was changed."""
LENGTH = "episode_length"
CIRCUMSTANCES = ("humans.", LENGTH)
"""Prefixes of the names of changes that do not alter the meaning of a policy's observations, actions and goals."""


@dataclass(frozen=True)
class Setting:
    """One setting that can be changed."""

    name: str  # "scratch", "preferences.velocity"
    default: Any
    unit: str
    meaning: str


def change_task(
    task: Task, config: Mapping[str, Any] | Any = None, episode_length: int | None = None
) -> Task:
    """Return a task with different weights, thresholds or length, or the same task if nothing changes.

    Args:
        task: the task to change.
        config: field names of ``task.config`` -> values, nested or with dots (``{"preferences": {"velocity": 0.5}}``,
            ``{"preferences.velocity": 0.5}``); or a complete record of the same class; None for the task's own.
        episode_length: control steps per episode; None for the task's own.

    Raises:
        UnknownNameError: if the task has no such setting; the message suggests the closest match.
        ArgumentError: if a value is not a finite number, or the length is not a whole number of at least 1.
        SpecError: if the task rejects the value, or has no ``config``.
    """
    changed: dict[str, Any] = {}
    if config is not None:
        changed["config"] = _changed_record(task, "", _config_of(task), config)
    if episode_length is not None:
        changed[LENGTH] = checked_count(LENGTH, episode_length)
    changed = {name: x for name, x in changed.items() if x != getattr(task, name)}
    return dataclasses.replace(task, **changed) if changed else task  # pyrefly: ignore


def changes_of(
    task: Task, humans: Population, robot: RobotVariation | None = None, memory: Memory = ()
) -> Changes:
    """Return the settings that differ from those of the registered task of the same name.

    Args:
        task: the environment's task.
        humans: its population.
        robot: its robot variation, if any.
        memory: its memory.
    """
    usual = TASKS.get(task.name, task)
    found: Changes = {}
    config = getattr(task, "config", None)
    if dataclasses.is_dataclass(config) and usual is not task:
        found |= _differences("task", config, getattr(usual, "config", None))
    if task.episode_length != usual.episode_length:
        found[LENGTH] = task.episode_length
    if memory:
        found[MEMORY] = list(memory)
    found |= _differences("humans", humans, Population())
    return found | _differences("robot", robot or RobotVariation(), RobotVariation())


def describe(theirs: Changes, ours: Changes, whose: str = "there") -> str:
    """Describe the differences between two environments of the same id in words; empty if there are none.

    Args:
        theirs: changes of the first environment.
        ours: changes of the second environment, which is called "here".
        whose: what the first environment is called.
    """
    told = lambda changes, name: repr(changes[name]) if name in changes else "the default"  # noqa: E731
    return "; ".join(
        f"{name} is {told(theirs, name)} {whose}, {told(ours, name)} here"
        for name in sorted({*theirs, *ours})
        if theirs.get(name) != ours.get(name)
    )


def essential(changes: Changes) -> Changes:
    """Return the changes except ``CIRCUMSTANCES``: those of robot, weights and thresholds."""
    return {name: x for name, x in changes.items() if not name.startswith(CIRCUMSTANCES)}


def flags_of(changes: Changes) -> str:
    """Return the command-line flags that make these changes."""
    words = []
    for name, value in changes.items():
        scope, dot, field = name.replace("_", "-").rpartition(".")
        if isinstance(value, bool):
            words.append(f"--{scope}{dot}{'' if value else 'no-'}{field}")
            continue
        values = value if isinstance(value, list) else [value]
        words.append(" ".join([f"--{scope}{dot}{field}", *map(str, values)]))
    return " ".join(words)


def arguments_of(changes: Changes) -> dict[str, Any]:
    """Return the arguments of ``agym_jax.make`` that make these changes."""
    parts: dict[str, dict[str, Any]] = {}
    for name, value in changes.items():
        kind, _, field = name.partition(".")
        parts.setdefault(kind, {})[field] = tuple(value) if isinstance(value, list) else value
    found: dict[str, Any] = {}
    if "task" in parts:
        found["config"] = parts["task"]
    if LENGTH in parts:
        found[LENGTH] = parts[LENGTH][""]
    if MEMORY in parts:
        found[MEMORY] = parts[MEMORY][""]
    for kind, record in (("humans", Population), ("robot", RobotVariation)):
        if kind in parts:
            found[kind] = record(**parts[kind])
    return found


def settings_of(task: Task) -> list[Setting]:
    """List the settings of a task that ``config`` can change, with units and meanings from the records' docstrings."""
    config = getattr(task, "config", None)
    found = list(_settings("", config)) if dataclasses.is_dataclass(config) else []
    return [
        dataclasses.replace(x, meaning=f"{x.meaning} (none in this task)")
        if _idle(task, x.name)
        else x
        for x in found
    ]


def _idle(task: Task, name: str) -> bool:
    """Return whether a setting is the weight of a preference that the task does not use."""
    kind, _, term = name.partition(".")
    return bool(term) and f"{kind.removesuffix('s')}_{term}" not in task.reward_terms


def settings_tables(task: Task) -> dict[str, list[Setting]]:
    """List all settings of a task's environments, by the ``agym_jax.make`` argument and the flag that change them."""
    unit, meaning = "control steps", f"of {task.control.period:g} s that an episode has"
    return {
        "config={name: value}, --task.NAME": settings_of(task),
        f"{LENGTH}=, --episode-length": [Setting(LENGTH, task.episode_length, unit, meaning)],
        f"{MEMORY}=, --memory": [
            Setting(MEMORY, (), "s", "time constants of averages that are appended to observations")
        ],
        "humans=Population(name=value), --humans.NAME": list(_settings("", Population())),
        "robot=RobotVariation(name=value), --robot.NAME": list(_settings("", RobotVariation())),
    }


def settings_table(settings: list[Setting]) -> str:
    """Format settings as a Markdown table."""
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
    """Read unit and meaning of a record's fields from its docstring's ``Attributes:``, written ``name: meaning [unit]``."""
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
    """Return a record with some fields changed."""
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
    """Check and convert a value for a field with this default."""
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
    """Return the fields that differ, by their dotted names."""
    found: Changes = {}
    for field in dataclasses.fields(record):
        value, other = getattr(record, field.name), getattr(usual, field.name, None)
        name = f"{prefix}.{field.name}"
        if dataclasses.is_dataclass(value):
            found |= _differences(name, value, other)
        elif value != other:
            found[name] = list(value) if isinstance(value, tuple) else value
    return found
