"""What every benchmark does with a result: show it and keep it, or say what went wrong."""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import tyro

from agym_jax.errors import AgymError
from agym_jax.policy.policy import shipped
from train.suites.plan import named


@dataclass(frozen=True)
class ShippedConfig:
    """Flags of every benchmark of policies that ship; base class for those of one."""

    only: Annotated[tuple[str, ...], tyro.conf.arg(metavar="NAME ...")] = ()
    """Parts of ids, such as Jaco or ScratchItchPR2-v0; without them, all whose policies ship."""
    json: Path | None = None
    """File to which each result is added as a JSON line."""


def keep(
    kind: str, measure: Callable[[], Mapping[str, Any]], json: Path | None
) -> Mapping[str, Any] | None:
    """Measure, print the fields and add them to a file.

    Args:
        kind: of the result line.
        measure: gives its fields.
        json: the file; None keeps nothing.

    Returns:
        The fields; None if something was wrong, which then has been said.
    """
    try:
        fields = measure()
    except AgymError as error:
        print(f"{type(error).__name__}: {error}", file=sys.stderr)
        return None
    print("\n".join(f"{name:<24} {value}" for name, value in fields.items()))
    if json:
        from train.runs.record import append_record, record  # asks JAX for its devices

        append_record(json, record(kind, **fields))
    return fields


def keep_of_shipped(
    kind: str, only: Sequence[str], measure: Callable[[str], Mapping[str, Any]], json: Path | None
) -> int:
    """Measure policies that ship, one after another, and keep each result as ``keep`` does.

    Args:
        kind: of the result lines.
        only: parts of ids; without them, all.
        measure: gives the fields of an environment's line.
        json: the file; None keeps nothing.

    Returns:
        The exit status: 2 if a name is wrong, or something could not be measured.
    """
    try:
        ids = named(only, shipped(), "shipped policy")
    except AgymError as error:
        print(f"{type(error).__name__}: {error}", file=sys.stderr)
        return 2
    results = [keep(kind, partial(measure, name), json) for name in ids]
    return 2 if None in results else 0
