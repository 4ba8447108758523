"""Where agym_jax differs from Assistive Gym on purpose: ``python -m benchmarks.deviations [--check]``.

Every such difference is a note ``DEVIATION(slug): reason`` in a docstring or comment of the code that
makes it; it ends at a blank line, the end of the docstring or the next note. This writes all of them
to ``docs/deviations.md``.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
OUTPUT = ROOT / "docs" / "deviations.md"
SOURCES = ("agym_jax", "train")
NOTE = re.compile(r"^\W*DEVIATION\((?P<slug>[a-z0-9-]+)\):\s*(?P<text>.*)$")
HEAD = """# Deviations from Assistive Gym v0.1

All intended differences from Assistive Gym (AG) v0.1. Any other difference is a bug. This page is generated from the
notes in the code by `python -m benchmarks.deviations`; do not edit it.

| name | difference and reason | source |
|---|---|---|
"""


class DeviationError(ValueError):
    """Two notes of one name, or a note without a reason."""


@dataclass(frozen=True)
class Deviation:
    """One note."""

    slug: str
    text: str
    file: str  # from the top of the repository
    line: int


def notes_in(text: str, file: str) -> list[Deviation]:
    """The notes in one file's text."""
    found: list[Deviation] = []
    lines = text.splitlines()
    for number, line in enumerate(lines, start=1):
        match = NOTE.match(line)
        if not match:
            continue
        is_comment, words = line.lstrip().startswith("#"), []
        for part in (match["text"], *lines[number:]):
            left_comment = is_comment and not part.lstrip().startswith("#")
            if words and (NOTE.match(part) or left_comment):
                break
            part, *closing = part.strip().lstrip("#").strip().split('"""')
            words.append(part)
            if closing or not part:
                break
        reason = " ".join(words).strip()
        if not reason:
            raise DeviationError(f"{file}:{number}: DEVIATION({match['slug']}) has no reason.")
        found.append(Deviation(match["slug"], reason, file, number))
    return found


def collect(root: Path = ROOT) -> list[Deviation]:
    """All notes under ``SOURCES``, by name.

    Raises:
        DeviationError: a name is used twice, or a note has no reason.
    """
    found: dict[str, Deviation] = {}
    for source in SOURCES:
        for path in sorted((root / source).rglob("*.py")):
            for note in notes_in(path.read_text(), path.relative_to(root).as_posix()):
                if note.slug in found:
                    other = found[note.slug]
                    raise DeviationError(
                        f"DEVIATION({note.slug}) is in {other.file}:{other.line} and in "
                        f"{note.file}:{note.line}; give one of them another name."
                    )
                found[note.slug] = note
    return [found[slug] for slug in sorted(found)]


def page(notes: Sequence[Deviation]) -> str:
    """The Markdown page. Files are linked without line numbers, which change too often."""
    rows = (
        f"| `{n.slug}` | {n.text.replace('|', '&#124;')} | [{n.file}](../{n.file}) |" for n in notes
    )
    return HEAD + "\n".join(rows) + "\n"


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; returns the exit status, 1 if ``--check`` finds the page out of date."""
    arguments = sys.argv[1:] if arguments is None else list(arguments)
    wanted = page(collect())
    if "--check" in arguments:
        if OUTPUT.is_file() and OUTPUT.read_text() == wanted:
            return 0
        print(f"{OUTPUT} is out of date: python -m benchmarks.deviations", file=sys.stderr)
        return 1
    OUTPUT.parent.mkdir(exist_ok=True)
    OUTPUT.write_text(wanted)
    print(OUTPUT)
    return 0


if __name__ == "__main__":
    sys.exit(main())
