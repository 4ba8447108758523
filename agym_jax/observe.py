"""Observation records and their flat vectors: the only place where fields become columns.

A record is a frozen dataclass whose fields declare size, unit and frame, and which states where in Assistive Gym
they come from. Columns shared by several records form a record of their own:

    @observation(source="scratch_itch.py:74")
    class RobotObs:
        tool_pos_torso: Array = column(3, "m", "world axes, from the torso")
        assisted_arm: ArmFromTorso = part(ArmFromTorso)
"""

from __future__ import annotations

import dataclasses
import hashlib
from dataclasses import dataclass, fields
from typing import Any, dataclass_transform

import jax
import jax.numpy as jnp

from agym_jax.errors import SpecError

_SOURCE = "__observation_source__"


@dataclass(frozen=True)
class Column:
    """Description of one field of an observation."""

    size: int
    unit: str
    frame: str
    source: str


def column(size: int, unit: str, frame: str, source: str = "") -> Any:
    """Declare a field of an observation record; its source defaults to the record's."""
    return dataclasses.field(metadata={"column": Column(size, unit, frame, source)})


def part(record: type) -> Any:
    """Declare a field that is itself a record: its columns are inserted here under their own names."""
    return dataclasses.field(metadata={"part": record})


@dataclass_transform(frozen_default=True, field_specifiers=(column, part))
def observation(cls: type | None = None, /, *, source: str = "") -> Any:
    """Turn a class of ``column`` and ``part`` fields into a frozen record and a pytree.

    Args:
        cls: the class, if the decorator is used without arguments.
        source: source of those columns that do not specify their own.

    Raises:
        SpecError: if a field is neither a column nor a part, or two columns have the same name.
    """

    def decorate(cls: type) -> type:
        setattr(cls, _SOURCE, source)
        record = jax.tree_util.register_dataclass(dataclass(frozen=True)(cls))
        _check_names(record)
        return record

    return decorate if cls is None else decorate(cls)


def _check_names(record: type) -> None:
    """Raise SpecError unless all fields are columns or parts and no name occurs twice."""
    names: list[str] = []
    for f in fields(record):
        if "column" in f.metadata:
            names.append(f.name)
        elif hasattr(f.metadata.get("part"), _SOURCE):
            names += columns(f.metadata["part"])
        else:
            raise SpecError(
                f"{record.__name__}.{f.name} is neither column(size, unit, frame) nor "
                "part(RECORD), where RECORD is an @observation."
            )
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise SpecError(f"{record.__name__} has two columns named {', '.join(twice)}.")


def columns(record: type, source: str = "") -> dict[str, Column]:
    """Map names to columns, in order; the columns of a part take its place.

    Args:
        record: an ``observation``.
        source: source of columns for which neither they nor the record specify one.
    """
    source = getattr(record, _SOURCE) or source
    found: dict[str, Column] = {}
    for f in fields(record):
        if "part" in f.metadata:
            found |= columns(f.metadata["part"], source)
        else:
            c = f.metadata["column"]
            found[f.name] = dataclasses.replace(c, source=c.source or source)
    return found


def values(obs: Any) -> dict[str, Any]:
    """Map names to values, in the order of ``columns``.

    Raises:
        SpecError: if the value of a part is not the declared record.
    """
    found: dict[str, Any] = {}
    for f in fields(obs):
        value, wanted = getattr(obs, f.name), f.metadata.get("part")
        if wanted is None:
            found[f.name] = value
        elif isinstance(value, wanted):
            found |= values(value)
        else:
            raise SpecError(
                f"{type(obs).__name__}.{f.name} is declared as {wanted.__name__} "
                f"but has a {type(value).__name__}."
            )
    return found


def size(record: type) -> int:
    """Return the length of the flat vector."""
    return sum(c.size for c in columns(record).values())


def layout(record: type) -> dict[str, slice]:
    """Map names to slices of the flat vector."""
    slices, start = {}, 0
    for name, c in columns(record).items():
        slices[name] = slice(start, start + c.size)
        start += c.size
    return slices


def flatten(obs: Any) -> jax.Array:
    """Flatten a record into a vector (size,).

    Raises:
        SpecError: if a field does not have its declared size, or is not the declared part.
    """
    flat, given = [], values(obs)
    for name, c in columns(type(obs)).items():
        value = jnp.asarray(given[name], jnp.float32).reshape(-1)
        if value.shape[0] != c.size:
            raise SpecError(
                f"{type(obs).__name__}.{name} is declared with {c.size} entries but has {value.shape[0]}."
            )
        flat.append(value)
    return jnp.concatenate(flat)


def layout_version(*records: type, former: bool = False) -> str:
    """Return a short hash of names and sizes, by which policies for another layout are recognised.

    Args:
        *records: records of the observation, in order.
        former: hash the former column names, which said "person" instead of "human"; policies from that time still fit.
    """
    rename = (lambda name: name.replace("human", "person")) if former else str
    text = repr(
        [[(rename(n), c.size, c.unit, c.frame) for n, c in columns(r).items()] for r in records]
    )
    return hashlib.sha256(text.encode()).hexdigest()[:12]


def table(record: type) -> str:
    """Format a record as a Markdown table: columns, name, unit, frame, source."""
    lines = ["| columns | field | unit | frame | Assistive Gym v0.1 |", "|---|---|---|---|---|"]
    for name, where in layout(record).items():
        c = columns(record)[name]
        span = f"{where.start}" if c.size == 1 else f"{where.start}-{where.stop - 1}"
        lines.append(f"| {span} | `{name}` | {c.unit} | {c.frame} | {c.source} |")
    return "\n".join(lines)
