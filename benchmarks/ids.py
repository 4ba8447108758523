"""Environment ids on the command line of a benchmark."""

from __future__ import annotations

import sys
from collections.abc import Sequence

from agym_jax.errors import UnknownNameError


def asked_ids(
    arguments: Sequence[str] | None, there: Sequence[str], kind: str = "shipped policy"
) -> list[str]:
    """Return the ids that are asked for.

    Args:
        arguments: of the command line; None for those of this process.
        there: ids that exist.
        kind: of what exists, for the message.

    Raises:
        UnknownNameError: one does not exist.
    """
    names = sys.argv[1:] if arguments is None else list(arguments)
    for name in names:
        if name not in there:
            raise UnknownNameError(kind, name, there)
    return names
