"""Observation records and their flat vectors: the only place where fields become columns.

A record is a NamedTuple-like dataclass whose fields carry size, unit, frame and source:

    @observation
    class RobotObs:
        tool_pos_torso: Array = column(3, "m", "world axes, from the torso", "scratch_itch.py:74")
"""

from __future__ import annotations

import dataclasses
import hashlib
import sys
from dataclasses import dataclass, fields
from typing import Any, dataclass_transform

import jax
import jax.numpy as jnp

from agym_jax.errors import SpecError


@dataclass(frozen=True)
class Column:
    """What one field of an observation is."""

    size: int
    unit: str
    frame: str
    source: str


def column(size: int, unit: str, frame: str, source: str) -> Any:
    """Declare a field of an observation record."""
    return dataclasses.field(metadata={"column": Column(size, unit, frame, source)})


@dataclass_transform(frozen_default=True, field_specifiers=(column,))
def observation(cls: type) -> type:
    """Make a class of ``column`` fields a frozen record and a pytree."""
    return jax.tree_util.register_dataclass(dataclass(frozen=True)(cls))


def columns(record: type) -> dict[str, Column]:
    """Name -> column, in order."""
    return {f.name: f.metadata["column"] for f in fields(record)}


def size(record: type) -> int:
    """Length of the flat vector."""
    return sum(c.size for c in columns(record).values())


def layout(record: type) -> dict[str, slice]:
    """Name -> slice of the flat vector."""
    slices, start = {}, 0
    for name, c in columns(record).items():
        slices[name] = slice(start, start + c.size)
        start += c.size
    return slices


def flatten(obs: Any) -> jax.Array:
    """Record -> flat vector (size,).

    Raises:
        SpecError: a field does not have its declared size.
    """
    parts = []
    for name, c in columns(type(obs)).items():
        value = jnp.asarray(getattr(obs, name), jnp.float32).reshape(-1)
        if value.shape[0] != c.size:
            raise SpecError(
                f"{type(obs).__name__}.{name} is declared with {c.size} entries but has {value.shape[0]}."
            )
        parts.append(value)
    return jnp.concatenate(parts)


def layout_version(*records: type) -> str:
    """Short hash of names and sizes: policies of another layout do not fit."""
    text = repr([[(n, c.size, c.unit, c.frame) for n, c in columns(r).items()] for r in records])
    return hashlib.sha256(text.encode()).hexdigest()[:12]


def table(record: type) -> str:
    """The record as a Markdown table: columns, name, unit, frame, source."""
    lines = ["| columns | field | unit | frame | Assistive Gym v0.1 |", "|---|---|---|---|---|"]
    for name, where in layout(record).items():
        c = columns(record)[name]
        span = f"{where.start}" if c.size == 1 else f"{where.start}-{where.stop - 1}"
        lines.append(f"| {span} | `{name}` | {c.unit} | {c.frame} | {c.source} |")
    return "\n".join(lines)


def main(argv: list[str]) -> int:
    """``python -m agym_jax.observe ID``: print an environment's observation tables."""
    from agym_jax.errors import AgymError
    from agym_jax.registry import parse

    if len(argv) != 1:
        print(
            "usage: python -m agym_jax.observe ENV-ID, such as ScratchItchJaco-v0", file=sys.stderr
        )
        return 2
    try:
        recipe = parse(argv[0])
    except AgymError as error:
        print(error, file=sys.stderr)
        return 1
    records = {"Robot": recipe.task.robot_obs}
    if recipe.active:
        records["Person"] = recipe.task.person_obs
    for title, record in records.items():
        print(f"{title}: {size(record)} columns\n\n{table(record)}\n")
    return 0
