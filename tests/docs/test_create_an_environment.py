# ruff: noqa: D103
"""``docs/create_an_environment.md`` shows the task file as it is, and commands that exist."""

from __future__ import annotations

import ast
import importlib
import importlib.util
import re
import textwrap
from pathlib import Path

import pytest
from paths import ROOT

import agym_jax
from agym_jax.__main__ import COMMANDS
from agym_jax.data import banks
from agym_jax.spec import RobotSpec

PAGE = ROOT / "docs" / "create_an_environment.md"
TEXT = PAGE.read_text()
TASK = (ROOT / "agym_jax" / "tasks" / "reaching.py").read_text()
BLOCKS = re.findall(r"^```([^\n]*)\n(.*?)^```$", TEXT, re.S | re.M)
EXCERPTS = [body.rstrip("\n") for kind, body in BLOCKS if kind == "python"]
SNIPPETS = {kind.split('"')[1]: body for kind, body in BLOCKS if kind.startswith("python title=")}
SHELL = "".join(body for kind, body in BLOCKS if kind == "bash")


def _public_pieces() -> dict[str, str]:
    """Every public class of the task file, and every field and method of the task: name -> line."""
    tree = ast.parse(TASK)
    lines = TASK.splitlines()
    classes = {n.name: n for n in tree.body if isinstance(n, ast.ClassDef)}
    pieces = {name: f"class {name}:" for name in classes}
    for node in classes["Reaching"].body:
        if isinstance(node, ast.FunctionDef) and not node.name.startswith("_"):
            pieces[f"Reaching.{node.name}"] = lines[node.lineno - 1]
        elif isinstance(node, ast.AnnAssign):
            pieces[f"Reaching.{ast.unparse(node.target)}"] = lines[node.lineno - 1]
    return pieces


def test_every_block_is_of_a_known_kind():
    assert {kind.split(" ")[0] for kind, _ in BLOCKS} == {"python", "bash"}
    assert TEXT.count("```") == 2 * len(BLOCKS)
    assert len(EXCERPTS) >= 7 and SHELL and set(SNIPPETS) >= {"look.py"}


@pytest.mark.parametrize("excerpt", EXCERPTS, ids=lambda x: x.strip().splitlines()[-1].strip()[:30])
def test_an_excerpt_is_a_part_of_the_task_file(excerpt: str):
    assert f"\n{excerpt}\n" in f"\n{TASK}", "copy it from agym_jax/tasks/reaching.py again"


def test_excerpts_are_in_the_files_order():
    where = [TASK.index(excerpt) for excerpt in EXCERPTS]
    assert where == sorted(where)


def test_every_public_piece_of_the_task_file_is_shown():
    shown = "\n".join(EXCERPTS)
    assert not [name for name, line in _public_pieces().items() if line not in shown]
    assert "REACHING = Reaching()" in TEXT and "REACHING = Reaching()" in TASK


def test_commands_and_links_exist():
    commands = set(re.findall(r"^agym-jax ([a-z-]+)", SHELL, re.M))
    assert {"placements", "observe", "enjoy", "train", "evaluate"} <= commands <= set(COMMANDS)
    links = re.findall(r"\]\(([^)#]+)\)", TEXT)
    assert links and not [path for path in links if not (PAGE.parent / path).resolve().is_file()]
    headings = {
        re.sub(r"[^\w -]", "", x).lower().replace(" ", "-") for x in re.findall(r"^#+ (.*)", TEXT, re.M)
    }  # fmt: skip
    assert set(re.findall(r"\]\(#([^)]+)\)", TEXT)) <= headings
    assert "docs/create_an_environment.md" in (ROOT / "CONTRIBUTING.md").read_text()


def test_ids_in_commands_exist():
    named = set(re.findall(r"\b[A-Z]\w+-v\d+\b", SHELL))
    robots = {name.removeprefix("Waving") for name in named if name.startswith("Waving")}
    wanted = {name for name in named if not name.startswith("Waving")}
    assert wanted and wanted | {f"Reaching{name}" for name in robots} <= set(agym_jax.list_envs())


def test_names_from_the_package_exist():
    """Dotted names in the text, and what the snippets import."""
    for name in set(re.findall(r"`(agym_jax(?:\.\w+)+)(?:\(\))?`", TEXT)):
        module, _, last = name.rpartition(".")
        known = hasattr(importlib.import_module(module), last) or importlib.util.find_spec(name)
        assert known, name
    for module, names in re.findall(r"^from (agym_jax[\w.]*) import (.+)$", TEXT, re.M):
        for name in names.split(", "):
            there = hasattr(importlib.import_module(module), name)
            assert there or importlib.util.find_spec(f"{module}.{name}"), f"{module} {name}"
    rows = re.findall(r"^\| `(\w+)(?:\[[\w ]+\])?`[^|]*\| (?:the (?:base|hand|tool)|nothing)", TEXT, re.M)  # fmt: skip
    assert len(rows) >= 6 and set(rows) <= set(RobotSpec.__dataclass_fields__)


def test_the_variable_exists():
    assert set(re.findall(r"AGYM_JAX_\w+", TEXT)) == {banks.VARIABLE}


def test_snippets_are_python():
    for body in SNIPPETS.values():
        ast.parse(textwrap.dedent(body))


def test_the_scene_can_be_looked_at(tmp_path: Path, monkeypatch, raycast):
    monkeypatch.chdir(tmp_path)
    exec(compile(SNIPPETS["look.py"], "look.py", "exec"), {})
    assert (tmp_path / "scene.png").stat().st_size > 5000
