# ruff: noqa: D103
"""What the repository says about itself: generated pages, commands, names, no machine's secrets."""

from __future__ import annotations

import ast
import importlib.util
import io
import json
import re
import subprocess
import tomllib
from contextlib import redirect_stdout, suppress
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from paths import ROOT

import agym_jax
from agym_jax.__main__ import ALIASES, COMMANDS, find
from benchmarks import deviations, tables
from benchmarks.markdown import EARLIER

README = (ROOT / "README.md").read_text()
CONTRIBUTING = (ROOT / "CONTRIBUTING.md").read_text()
PAGES = [
    "README.md",
    "CONTRIBUTING.md",
    *sorted(f"docs/{p.name}" for p in (ROOT / "docs").glob("*.md")),
]
RESULT = {
    "env": "ScratchItchJaco-v0",
    "impl": "warp",
    "num_envs": 4096,
    "steps_per_s": 1234567,
    "steps_per_s_min": 1200000,
    "steps_per_s_max": 1300000,
    "compile_seconds": 2.0,
    "first_call_seconds": 40.0,
    "nan": 0,
    "overflow": 0,
    "device": {"kind": "Some GPU", "cpu_cores": 2},
    "commit": "0123456789abcdef",
}


def repository_files() -> list[Path]:
    """What git would publish; without git, every text file of the known folders."""
    command = ["git", "-C", str(ROOT), "ls-files", "--cached", "--others", "--exclude-standard"]
    listed = subprocess.run(command, capture_output=True, text=True)
    if listed.returncode == 0:
        return [ROOT / name for name in listed.stdout.splitlines() if (ROOT / name).is_file()]
    folders = ("agym_jax", "train", "benchmarks", "tests", "docs", ".ci", "assets")
    found = [p for folder in folders for p in (ROOT / folder).rglob("*") if p.is_file()]
    top = [p for p in ROOT.iterdir() if p.is_file()]
    return [p for p in found + top if "__pycache__" not in p.parts]


def sources(*folders: str) -> list[Path]:
    return sorted(path for folder in folders for path in (ROOT / folder).rglob("*.py"))


def commands(text: str) -> list[str]:
    """Shell lines of the fenced blocks."""
    blocks = re.findall(r"```bash\n(.*?)```", text, re.S)
    return [line for block in blocks for line in block.splitlines() if line.strip()]


@pytest.mark.parametrize("page", tables.PAGES, ids=lambda page: page.name)
def test_tables_are_up_to_date(page):
    text, commits = page.read_text(), page.name != "README.md"
    assert tables.page(text, commits) == text, "run: python -m benchmarks.tables"
    assert (
        bool(re.search(r"commit [0-9a-f]{7}", text)) == commits
    )  # who reads the README needs none


def test_a_matrix_has_tasks_as_rows_and_robots_as_columns(tmp_path):
    (tmp_path / "throughput.jsonl").write_text(json.dumps(RESULT))
    shown = tables.fill("<!-- table:speed -->\n<!-- /table:speed -->", tmp_path)
    head, _, row, *_ = shown.splitlines()[1:]
    column = head.split("|").index(" Jaco ")
    assert row.split("|")[1] == " ScratchItch " and row.split("|")[column] == " 1,235 k "


@pytest.mark.parametrize("name", ["speed", "throughput"])
def test_tables_say_what_was_measured_before_the_present_physics(tmp_path, name):
    def shown(*times: str) -> str:
        envs = ("ScratchItchJaco-v0", "FeedingJaco-v0")
        lines = [{**RESULT, "env": e, "time": t} for e, t in zip(envs, times, strict=True)]
        (tmp_path / "throughput.jsonl").write_text("\n".join(map(json.dumps, lines)))
        return tables.TABLES[name](tmp_path)

    new, old = "2126-01-02T00:00:00+00:00", "2026-01-02T00:00:00+00:00"
    assert EARLIER not in shown(new, new) and "before" not in shown(new, new)
    assert "Measured before the present physics" in shown(old, old)
    mixed = shown(new, old)
    rows = [row for row in mixed.splitlines() if EARLIER in row]
    assert len(rows) == 2 and "Feeding" in rows[0] and "2026-01-02 to 2126-01-02" in rows[1]


def test_list_of_deviations_is_up_to_date():
    wanted = deviations.page(deviations.collect())
    assert deviations.OUTPUT.read_text() == wanted, "run: python -m benchmarks.deviations"


def test_first_command_of_the_readme_comes_early_and_helps_a_person():
    line = README.splitlines().index(commands(README)[0]) + 1
    assert line <= 20
    assert "train.demo" in commands(README)[0]
    assert len(README.splitlines()) <= 200


@pytest.mark.parametrize("name", PAGES)
def test_commands_in_the_documents_exist(name):
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    text = (ROOT / name).read_text()
    for module in re.findall(r"python -m ([a-z_.]+)", text):
        known = module in ("venv", "pytest", "mkdocs") or importlib.util.find_spec(
            module.rstrip(".")
        )
        assert known, f"python -m {module}"
    commands_named = re.findall(r"agym-jax ([a-z-]+)", "\n".join(code_in(text)))
    assert set(commands_named) <= {*COMMANDS, *ALIASES}
    for group in re.findall(r"\[([a-z,]+)\]\"", text):
        assert set(group.split(",")) <= set(extras["optional-dependencies"]), group


@pytest.mark.parametrize("name", [*PAGES, "CHANGELOG.md"])
def test_links_and_pictures_in_the_documents_exist(name):
    text = (ROOT / name).read_text()
    for path in re.findall(r"\]\(([^)#:]+)(?:#[^)]*)?\)", text):
        assert ((ROOT / name).parent / path).resolve().exists(), path
    for path, heading in re.findall(r"\]\(([^)#:]*\.md)#([^)]+)\)", text):
        assert heading in headings(((ROOT / name).parent / path).read_text()), f"{path}#{heading}"
    for heading in re.findall(r"\]\(#([^)]+)\)", text):
        assert heading in headings(text), f"#{heading}"


def test_every_picture_is_shown_by_a_page():
    """So that none stays that shows what is no longer so."""
    shown = {
        ((ROOT / name).parent / path).resolve()
        for name in PAGES
        for path in re.findall(r"!\[[^]]*\]\(([^)]+)\)", (ROOT / name).read_text())
    }
    there = {path for path in (ROOT / "docs" / "images").rglob("*") if path.is_file()}
    assert not {str(path.relative_to(ROOT)) for path in there - shown}


def code_in(text: str) -> list[str]:
    """Commands in a page: lines of shell blocks, and what stands between single backticks."""
    prose = re.sub(r"^```.*?^```$", "", text, flags=re.S | re.M)
    inline = [" ".join(code.split()) for code in re.findall(r"`([^`]+)`", prose)]
    return [line.partition(" #")[0] for line in commands(text)] + inline


def headings(text: str) -> set[str]:
    """Anchors that GitHub gives to a page's headings."""
    found = re.findall(r"^#+ (.*)", text, re.M)
    return {re.sub(r"[^\w -]", "", x).lower().replace(" ", "-") for x in found}


TOOL = re.compile(
    r"(?:agym-jax|python -m agym_jax|python (?:-m )?(train|benchmarks)[./]) ?([a-z_-]+)"
)


@cache
def flags(tool: str) -> set[str]:
    """What ``--help`` of a command lists: of ``agym-jax evaluate``, or of ``benchmarks.nan``."""
    run = importlib.import_module(tool).main if "." in tool else find(tool)
    said = io.StringIO()
    with redirect_stdout(said), suppress(SystemExit):
        run(["build", "--help"] if tool == "placements" else ["--help"])
    return set(re.findall(r"--[a-z][a-z-]*", said.getvalue()))


@pytest.mark.parametrize("name", PAGES)
def test_flags_in_the_documents_exist(name, monkeypatch):
    """Of the command that they are given to; those without one, of any command."""
    monkeypatch.setenv("COLUMNS", "200")
    for code in code_in((ROOT / name).read_text()):
        used = set(re.findall(r"(?<!\S)--[a-z][a-z-]*", code))
        if not used or re.match(r"(python3|ruff|pytest|tensorboard|trackio|.*--check)\b", code):
            continue
        named = TOOL.search(code)
        tools = set(COMMANDS) - {"list", "observe"}
        if named:
            tools = {f"benchmarks.{named[2]}" if named[1] == "benchmarks" else named[2]}
        assert used <= set().union(*map(flags, tools)), code


def test_environments_in_the_readme_exist():
    named = set(re.findall(r"(?<![\w.])[A-Z]\w+-v\d+\b", README))
    assert named and named <= set(agym_jax.list_envs())


MANY, GYMNASIUM = re.findall(r"^```python\n(.*?)^```$", README, re.S | re.M)


@pytest.mark.slow
@pytest.mark.jit
def test_the_first_example_of_the_readme_runs(capsys):
    assert "64" in MANY
    names: dict[str, Any] = {}
    exec(compile(MANY.replace("64", "2"), "README.md", "exec"), names)
    assert np.isfinite(float(capsys.readouterr().out.split()[0]))
    assert names["states"].obs.shape == (2, names["env"].observation_size)


@pytest.mark.jit
def test_the_gymnasium_example_of_the_readme_runs(raycast):
    names: dict[str, Any] = {}
    exec(compile(GYMNASIUM, "README.md", "exec"), names)
    assert names["image"].shape == (360, 480, 3) and np.ptp(names["image"]) > 0
    names["env"].close()


def test_contributing_shows_every_folder():
    """And no folder that there is not."""
    tree = re.search(r"^```\n(agym_jax/.*?)^```$", CONTRIBUTING, re.S | re.M)
    assert tree
    shown: dict[str, set[str]] = {}
    for block in re.split(r"^(?=\w)", tree[1], flags=re.M)[1:]:
        top, *folders = re.findall(r"(\w+)/(?=\s)", block)
        shown[top] = set(folders)
    for top in ("agym_jax", "train", "tests"):
        assert shown[top] == {path.parent.name for path in (ROOT / top).glob("*/*.py")}, top
    assert {"benchmarks", "assets"} <= set(shown)


def test_contributing_shows_the_layers_that_the_linter_checks():
    contracts = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["importlinter"][
        "contracts"
    ]
    shown = re.search(r"^```\n(benchmarks\n.*?)^```$", CONTRIBUTING, re.S | re.M)
    assert shown
    _, train, package = re.split(r"^(?:train|agym_jax):", shown[1], flags=re.M)
    for container, layers in (("train", train), ("agym_jax", package)):
        rows = [set(re.findall(r"\w+", row)) for row in layers.strip().splitlines()]
        wanted = next(x["layers"] for x in contracts if x.get("containers") == [container])
        assert rows == [set(re.findall(r"\w+", layer)) for layer in wanted]


def test_ci_runs_the_readmes_test_command():
    """The script takes the command from the README, so a reader's and CI's are the same."""
    script = (ROOT / ".ci" / "run").read_text()
    pattern = re.search(r"grep -m1 '(.+)' README\.md", script)
    assert pattern
    found = [line for line in commands(README) if re.match(pattern[1], line)]
    assert len(found) == 1 and found[0].endswith("-m pytest -n 2 --dist loadgroup")
    assert found[0].count(" && ") == 2


def test_no_file_names_a_registry_or_a_machine():
    machine = "|".join((r"/wo" + r"rk/", r"/ro" + r"ot/", r"/ho" + r"me/", r"/opt/py" + r"pi"))
    hosts = "|".join(
        ("files.python" + "hosted", "pypi" + r"\.org", "index-" + "url", "--hash" + "=")
    )
    forbidden = re.compile(f"({machine}|{hosts})")
    found = []
    for path in repository_files():
        try:
            text = path.read_text()
        except UnicodeDecodeError:
            continue
        found += [f"{path.relative_to(ROOT)}: {m[0]}" for m in forbidden.finditer(text)]
    assert not found


def test_constraints_are_names_and_versions():
    lines = (ROOT / "constraints.txt").read_text().splitlines()
    assert lines and all(re.fullmatch(r"[A-Za-z0-9_.-]+==[0-9][\w.]*", line) for line in lines)
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    extras = project["optional-dependencies"]
    wanted = project["dependencies"] + extras["train"] + extras["test"] + extras["lint"]
    pinned = {line.split("==")[0].lower().replace("_", "-") for line in lines}
    for requirement in wanted:
        name = re.match(r"[\w.-]+", requirement)
        assert name and name[0].lower().replace("_", "-") in pinned, requirement


def test_every_public_name_has_a_docstring():
    """Names in ``__all__``, and every public function and class of the package and the tools."""
    missing = []
    for path in sources("agym_jax", "train", "benchmarks"):
        tree = ast.parse(path.read_text())
        if not ast.get_docstring(tree):
            missing.append(str(path.relative_to(ROOT)))
        kinds = (ast.FunctionDef, ast.AsyncFunctionDef, ast.ClassDef)
        for node in tree.body:
            public = isinstance(node, kinds) and not node.name.startswith("_")
            if public and not ast.get_docstring(node):
                missing.append(f"{path.relative_to(ROOT)}: {node.name}")
    assert not missing
    for name in agym_jax.__all__:
        assert getattr(agym_jax, name).__doc__, name


def test_notes_end_where_they_end():
    text = '''"""What it does.

DEVIATION(one-thing): it differs
in two lines.
DEVIATION(other-thing): differs too."""

# DEVIATION(in-comment): also
# here.
x = 1
'''
    found = {note.slug: note.text for note in deviations.notes_in(text, "x.py")}
    assert found == {
        "one-thing": "it differs in two lines.",
        "other-thing": "differs too.",
        "in-comment": "also here.",
    }
    with pytest.raises(deviations.DeviationError, match="no reason"):
        deviations.notes_in("# DEVIATION(empty):\n", "x.py")


def test_a_table_shows_the_newest_result_and_leaves_out_lost_contacts(tmp_path):
    old, lost = RESULT | {"steps_per_s": 1}, RESULT | {"num_envs": 8, "overflow": 3}
    lines = "\n".join(json.dumps(line) for line in (old, RESULT, lost))
    (tmp_path / "throughput.jsonl").write_text(lines)
    text = "a\n<!-- table:throughput -->\nold\n<!-- /table:throughput -->\nb"
    filled = tables.fill(text, tmp_path)
    assert "**1,234,567** (1,200,000 to 1,300,000)" in filled and "| 42 s |" in filled
    assert "old" not in filled and "| 8 |" not in filled and "01234567." in filled
    assert tables.fill(filled, tmp_path) == filled
    with pytest.raises(tables.TableError, match="Unknown table"):
        tables.fill("<!-- table:haste -->", tmp_path)
    with pytest.raises(tables.TableError, match="not followed"):
        tables.fill("<!-- table:nan -->", tmp_path)
