"""Compare with Assistive Gym: ``python -m benchmarks.parity [SECTION ...] [--check]``.

Measures every section (or those named), keeps the rows in ``benchmarks/results/parity.json`` and writes
``docs/parity.md`` from them. ``--check`` measures nothing: it fails if the page is not what the kept rows give.
"""

from __future__ import annotations

import argparse
import importlib
import json
import sys
import time
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

from benchmarks.parity.row import Row

ROOT = Path(__file__).resolve().parents[2]
RESULTS = ROOT / "benchmarks" / "results" / "parity.json"
PAGE = ROOT / "docs" / "parity.md"
SECTIONS = (
    "starts", "outline", "shapes", "friction", "pressing", "pushed_arm", "bed", "limp_arm", "lying_arm", "beside_bed", "scooper", "wiper", "head", "motors", "forces", "matter", "gown", "cuff", "dressing", "robot_arm",
)  # fmt: skip
"""Modules of this package, in the order of the page. The first line of each docstring is its heading,
the rest of the docstring its text."""
HEAD = """# Parity with Assistive Gym v0.1

Measured by `python -m benchmarks.parity` from arrays that were recorded in Assistive Gym (AG) itself
(`benchmarks/parity/traces`) and from the code; do not edit this page. Where a difference is larger than the
tolerance, the last column names the [deviation](deviations.md) that says why.
"""


def page(kept: dict[str, list[Row]]) -> str:
    """The page, from the rows of every section."""
    parts = [HEAD]
    for name in SECTIONS:
        if name not in kept:
            continue
        heading, _, text = (
            importlib.import_module(f"benchmarks.parity.{name}").__doc__ or ""
        ).partition("\n")
        parts.append(
            f"\n## {heading.rstrip('.')}\n\n{text.strip()}\n\n".replace("\n\n\n\n", "\n\n")
        )
        parts.append(
            "| quantity | AG | agym_jax | tolerance | within | deviation |\n|---|---|---|---|---|---|\n"
        )
        parts += [_line(row) for row in kept[name]]
    return "".join(parts)


def _line(row: Row) -> str:
    show = lambda x: f"{x:.4g}"  # noqa: E731
    quantity = f"{row.quantity} [{row.unit}]" if row.unit else row.quantity
    why = f"`{row.deviation}`" if row.deviation else ""
    within = "yes" if row.holds else "no"
    return f"| {quantity} | {show(row.ag)} | {show(row.ours)} | {show(row.tolerance)} | {within} | {why} |\n"


def read() -> dict[str, list[Row]]:
    """The rows that were kept."""
    if not RESULTS.is_file():
        return {}
    kept = json.loads(RESULTS.read_text())
    return {name: [Row(**row) for row in rows] for name, rows in kept.items()}


def main(argv: Sequence[str] | None = None) -> int:
    """The command line; returns the exit status."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.parity", description=__doc__)
    parser.add_argument(
        "sections", nargs="*", choices=(*SECTIONS, []), default=[], metavar="SECTION"
    )
    parser.add_argument(
        "--check", action="store_true", help="measure nothing; is the page up to date?"
    )
    args = parser.parse_args(argv)
    kept = read()
    if args.check:
        current = PAGE.is_file() and PAGE.read_text() == page(kept)
        if not current:
            print(
                "docs/parity.md is not what the results give: python -m benchmarks.parity",
                file=sys.stderr,
            )
        return 0 if current else 1
    for name in args.sections or SECTIONS:
        begin = time.monotonic()
        kept[name] = importlib.import_module(f"benchmarks.parity.{name}").rows()
        apart = [row for row in kept[name] if not row.holds]
        print(
            f"{name}: {len(kept[name])} rows, {len(apart)} apart, {time.monotonic() - begin:.0f} s"
        )
        for row in apart:
            print(f"  {_line(row).strip()}")
        RESULTS.write_text(
            json.dumps({k: [asdict(r) for r in v] for k, v in kept.items()}, indent=1) + "\n"
        )
        PAGE.write_text(page(kept))
    return 0


if __name__ == "__main__":
    sys.exit(main())
