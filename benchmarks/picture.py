"""Pictures of results that know what they show, so that ``--check`` can tell whether they are out of date.

The file carries a checksum of its results: pixels differ between versions of matplotlib.
"""

from __future__ import annotations

import hashlib
import json
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from PIL import Image

from benchmarks.markdown import Line

MARK = "shows"
"""Key of the checksum in the file."""
Draw = Callable[[Path, Sequence[Line], Mapping[str, str]], None]
"""Draws results into a PNG file, with texts to keep in it."""


def command(
    arguments: Sequence[str] | None, output: Path, lines: Sequence[Line], draw: Draw, module: str
) -> int:
    """The command line of a picture: draws it anew if it does not show these results; with ``--check``, only says so.

    Args:
        arguments: words; None for those of the program.
        output: the PNG file.
        lines: the results. Without any, there need be no picture.
        draw: see ``Draw``.
        module: the program.

    Returns:
        The exit status: 1 if a check finds it out of date.
    """
    shown = hashlib.sha256(json.dumps(lines, sort_keys=True).encode()).hexdigest()
    if _mark(output) == (shown if lines else None):
        return 0
    if "--check" in (sys.argv[1:] if arguments is None else arguments):
        print(f"{output.name} is out of date: python -m {module}", file=sys.stderr)
        return 1
    draw(output, lines, {MARK: shown})
    print(output)
    return 0


def _mark(output: Path) -> str | None:
    """The checksum in a file; None if there is no file."""
    if not output.is_file():
        return None
    with Image.open(output) as picture:
        return str(picture.info.get(MARK))
