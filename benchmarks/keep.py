"""What every benchmark does with a result: show it and keep it, or say what went wrong."""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from agym_jax.errors import AgymError


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
