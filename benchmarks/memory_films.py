"""Films of the shipped policies with a memory, and of episodes in which they fail: ``python -m benchmarks.memory_films [ID ...]``.

Writes ``docs/images/memory/ID.webp`` as ``benchmarks.clips`` does, ``ID.jpg`` as ``benchmarks.failures`` does, and shows them in
``docs/memory.md``. Without ids: all of these policies.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Sequence

import jax

from agym_jax.memory import SHIPPED
from agym_jax.policy.policy import shipped
from benchmarks import clips, failures
from benchmarks.ids import asked_ids
from train.errors import reports_errors

PAGE = clips.DOCS / "memory.md"
FOLDER = clips.DOCS / "images" / "memory"


def gallery() -> str:
    """The films in rows of three, and below them the strips of failures, in Markdown."""
    films = sorted(path.stem for path in FOLDER.glob("*.webp"))
    lines = []
    for row in (films[i : i + 3] for i in range(0, len(films), 3)):
        lines += [f"| {' | '.join(row)} |", "|---" * len(row) + "|"]
        lines += [f"| {' | '.join(f'![{x}](images/memory/{x}.webp)' for x in row)} |", ""]
    for name in sorted(path.stem for path in FOLDER.glob("*.jpg")):
        lines += [f"**{name}**, failures", "", f"![{name} fails](images/memory/{name}.jpg)", ""]
    return "\n".join(lines)


def fill(page: str) -> str:
    """The page with the present films."""
    begin, end = "<!-- films -->", "<!-- /films -->"
    return re.sub(f"(?s){begin}.*{end}", lambda _: f"{begin}\n{gallery()}{end}", page)


@reports_errors
def main(arguments: Sequence[str] | None = None) -> int:
    """The command line: environment ids, if not all that have a policy with a memory."""
    jax.config.update("jax_platforms", "cpu")
    there = shipped(memory=True)
    names = asked_ids(arguments, there, "shipped policy with a memory") or there
    FOLDER.mkdir(parents=True, exist_ok=True)
    for i, name in enumerate(names, 1):
        print(f"{i}/{len(names)} {name}", flush=True)
        clips.draw(name, FOLDER, SHIPPED)
        (FOLDER / f"{name}.jpg").unlink(missing_ok=True)
        if not failures.strip(name, FOLDER, SHIPPED):
            print(f"{name} does not fail with the seeds that are looked through")
    PAGE.write_text(fill(PAGE.read_text()))
    print(PAGE)
    return 0


if __name__ == "__main__":
    sys.exit(main())
