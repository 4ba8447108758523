"""Result tables, generated from ``benchmarks/results``: ``python -m benchmarks.tables [--check]``.

Each table is between ``<!-- table:NAME -->`` and ``<!-- /table:NAME -->``. If a configuration was measured
several times, the last line of the file is used. Results with lost contacts are left out.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

from benchmarks import (
    care_tables,
    continued_tables,
    cpu_tables,
    markdown,
    memory_tables,
    physics_tables,
    policy_tables,
    restart_tables,
    speed_tables,
    suite_tables,
    training_tables,
    trial_tables,
)
from benchmarks.markdown import DATES, RESULTS

ROOT = Path(__file__).resolve().parent.parent
PAGES = tuple(
    path
    for path in (ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md")))
    if "<!-- table:" in path.read_text()
)


class TableError(ValueError):
    """A table that a page names and nobody makes, or a broken marker."""


TABLES: dict[str, Callable[..., str]] = {
    "dates": markdown.dates,
    "success": policy_tables.success,
    "speed": speed_tables.speed,
    "training": training_tables.training,
    "throughput": speed_tables.throughput,
    "compile": speed_tables.compilation,
    "chosen-among": policy_tables.chosen_among,
    "policies": policy_tables.policies,
    "seeds-at-a-glance": restart_tables.at_a_glance,
    "selections": policy_tables.selections,
    "suite": suite_tables.suite,
    "suite-gentle": suite_tables.suite_gentle,
    "suite-pairs": suite_tables.suite_pairs,
    "memory-trainings": memory_tables.trainings,
    "memory-policies": memory_tables.policies,
    "restarts": restart_tables.trainings,
    "trials": trial_tables.trials,
    "sweeps": policy_tables.sweeps,
    "gentle": continued_tables.gentle,
    "continued": continued_tables.continued,
    "limits": care_tables.limits,
    "not-shipped": policy_tables.not_shipped,
    "together": policy_tables.together,
    "seeds": policy_tables.seeds,
    "training-speed": speed_tables.training_speed,
    "training-profile": speed_tables.profile,
    "seed-speed": speed_tables.seed_speed,
    "brax-ppo": training_tables.brax_ppo,
    "best-of": training_tables.best_of,
    "resume": training_tables.resume,
    "kills": training_tables.kills,
    "torch-overhead": speed_tables.torch_overhead,
    "viewer-speed": speed_tables.viewer_speed,
    "nan": physics_tables.nan,
    "met-starts": physics_tables.met_starts,
    "reach": physics_tables.reach,
    "reach-mouth": physics_tables.reach_mouth,
    "reach-pour": physics_tables.reach_pour,
    "inside": physics_tables.inside,
    "implementations": physics_tables.implementations,
    "causes": physics_tables.causes,
    "same-starts": physics_tables.same_starts,
    "pulls": physics_tables.pulls,
    "cpu": cpu_tables.summary,
    "cpu-speed": cpu_tables.speed,
    "cpu-latency": cpu_tables.latency,
    "laptop": cpu_tables.laptop,
    "in-assistive-gym": policy_tables.in_assistive_gym,
    "glance": care_tables.glance,
    "everybody": care_tables.everybody,
    "shortfalls": care_tables.shortfalls,
    "endings": care_tables.endings,
    "starts": care_tables.starts,
    "dressing-arms": care_tables.dressing_arms,
    "care": care_tables.care,
    "rough": care_tables.rough,
}


def fill(text: str, folder: Path = RESULTS) -> str:
    """The text with every table made anew.

    Raises:
        TableError: a marker names an unknown table, or is not closed.
    """
    for name in re.findall(r"<!-- table:(\S+) -->", text):
        if name not in TABLES:
            raise TableError(f"Unknown table {name!r}; there are: {', '.join(TABLES)}.")
        begin, end = f"<!-- table:{name} -->", f"<!-- /table:{name} -->"
        before, _, rest = text.partition(begin)
        _, closed, after = rest.partition(end)
        if not closed:
            raise TableError(f"{begin} is not followed by {end}.")
        text = f"{before}{begin}\n{TABLES[name](folder)}\n{end}{after}"
    return text


def page(text: str, commits: bool = True) -> str:
    """A page with every table made anew.

    Args:
        text: of the page.
        commits: whether its tables name the commits with which they were measured; they do in all pages but the README, which
            lies outside of the documentation's folder.

    Raises:
        TableError: see ``fill``.
    """
    made = fill(text)
    if commits:
        return made
    made = made.replace(f"({DATES})", f"(docs/{DATES})")
    return re.sub(r"; commit [0-9a-f]{7,}(, [0-9a-f]{7,})*(?=[;.])", "", made)


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; returns the exit status, 1 if ``--check`` finds a page out of date."""
    arguments = sys.argv[1:] if arguments is None else list(arguments)
    stale = False
    for path in PAGES:
        text = path.read_text()
        wanted = page(text, commits=path.name != "README.md")  # those are in docs/benchmarks.md
        if text != wanted and "--check" in arguments:
            print(f"{path.name} is out of date: python -m benchmarks.tables", file=sys.stderr)
            stale = True
        elif text != wanted:
            path.write_text(wanted)
    if stale:
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
