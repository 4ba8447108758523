"""What the site is made of: generated pages, the navigation, and links that leave the documentation."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

from agym_jax import list_envs
from agym_jax.registry import static_id
from agym_jax.tasks import TASKS
from benchmarks.site import environments, reference

ROOT = Path(__file__).resolve().parents[2]
DOCS = ROOT / "docs"
ELSEWHERE = {
    "README.md": "index.md",
    "CONTRIBUTING.md": "contributing.md",
    "CHANGELOG.md": "versions.md",
}
"""Files of the repository that are pages of the site."""
GUIDES = (
    "make_it_yours",
    "create_an_environment",
    "runs",
    "viewer",
    "torch",
    "brax",
    "onnx",
    "care",
    "gentle_training",
    "memory",
    "rare_success",
)
RESULTS = (
    "benchmarks",
    "transfer",
    "seeds",
    "training_notes",
    "sweeps",
    "speed",
    "parity",
    "deviations",
)
HELP = ("troubleshooting", "versions", "contributing")
LINK = re.compile(r"(!?)\[((?:[^\[\]]|!\[[^]]*\]\([^)]*\))*)\]\(([^)\s#:]+)(#[^)\s]*)?\)")


def generated() -> dict[str, str]:
    """Path below ``docs`` -> Markdown of the pages that are not files there."""
    pages = {page: relink((ROOT / name).read_text(), ROOT) for name, page in ELSEWHERE.items()}
    pages["versions.md"] = versions((ROOT / "CHANGELOG.md").read_text())
    return pages | environments.pages() | reference.pages()


def versions(changelog: str) -> str:
    """What changes results first, then the whole change log."""
    releases = re.split(r"^(?=## )", changelog, flags=re.M)
    lines = ["# Versions and what changes results", "", "The version of an environment (`-v0`) is raised whenever a "
             "change could affect learning. What affected trained policies since they were first released:"]  # fmt: skip
    for release in releases[1:]:
        affected = re.search(
            r"^### Affects trained policies\n(.*?)(?=^### |\Z)", release, re.M | re.S
        )
        if affected:
            lines += [
                "",
                "## " + release.splitlines()[0].removeprefix("## ") + ": what changes results",
                affected[1].rstrip(),
            ]
    rest = re.sub(r"^# .*\n", "", changelog, count=1)
    body = re.sub(r"^(#+) ", r"#\1 ", rest, flags=re.M)
    return relink("\n".join([*lines, "", "## All changes", body]), ROOT)


def relink(text: str, folder: Path) -> str:
    """Links from a file of the repository as links of the site; what is no page of it becomes plain text.

    Args:
        text: Markdown.
        folder: where its links start.
    """

    def link(match: re.Match[str]) -> str:
        picture, shown, target, anchor = match[1], match[2], match[3], match[4] or ""
        path = (folder / target).resolve()
        shown = LINK.sub(link, shown)
        if path.is_relative_to(DOCS) and path.exists():
            return f"{picture}[{shown}]({path.relative_to(DOCS)}{anchor})"
        if path.is_relative_to(ROOT) and str(path.relative_to(ROOT)) in ELSEWHERE:
            return f"[{shown}]({ELSEWHERE[str(path.relative_to(ROOT))]}{anchor})"
        return shown if "`" in shown or not path.suffix else f"`{shown}`"

    return LINK.sub(link, text)


def navigation() -> list[Any]:
    """What stands where; pages that nobody has placed come last among the guides."""
    placed = {*GUIDES, *RESULTS, *HELP, "concepts", "clips"}
    others = sorted(path.stem for path in DOCS.glob("*.md") if path.stem not in placed)
    there = lambda names: [f"{x}.md" for x in names if (DOCS / f"{x}.md").is_file()]  # noqa: E731
    tutorials = [f"tutorials/{path.name}" for path in sorted((DOCS / "tutorials").glob("*.py"))]
    ids = [
        {task: [f"{environments.SECTION}/{x}.md" for x in list_envs() if _is_of(x, task)]}
        for task in TASKS
    ]
    return [
        {"Start": "index.md"},
        {"Concepts": "concepts.md"},
        {"Environments": [f"{environments.SECTION}/index.md", "clips.md", *ids]},
        {"Tutorials": tutorials},
        {"Guides": there((*GUIDES, *others))},
        {"Results": there(RESULTS)},
        {"Reference": sorted(reference.pages())},
        {"Help": [f"{x}.md" for x in HELP]},
    ]


def _is_of(name: str, task: str) -> bool:
    robots = static_id(name).removeprefix(task).removesuffix("-v0")
    return name.startswith(task) and robots in {"PR2", "Jaco", "Baxter", "Sawyer"}
