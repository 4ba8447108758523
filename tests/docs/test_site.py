# ruff: noqa: D103
"""The documentation site, as far as it is ours: generated pages say what there is, and every page has a place."""

from __future__ import annotations

import ast
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from paths import PROCESS_SECONDS, ROOT

import agym_jax
from agym_jax import observe
from agym_jax.registry import parse
from benchmarks.site import environments, pages, reference

MADE = pages.generated()
TUTORIALS = sorted((ROOT / "docs" / "tutorials").glob("*.py"))
YOURS = (ROOT / "docs" / "make_it_yours.md").read_text()
CREATE = (ROOT / "docs" / "create_an_environment.md").read_text()


def flat(entries: list) -> list[str]:
    found: list[str] = []
    for entry in entries:
        values = entry.values() if isinstance(entry, dict) else [entry]
        for value in values:
            found += flat(value) if isinstance(value, list) else [value]
    return found


@pytest.mark.parametrize("name", agym_jax.list_envs())
def test_every_environment_has_a_page_with_all_about_it(name):
    text, recipe = MADE[f"environments/{name}.md"], parse(name)
    records = [recipe.task.robot_obs, *([recipe.task.human_obs] if recipe.active else [])]
    for record in records:
        assert f"{observe.size(record)} columns" in text
        assert all(f"`{column}`" in text for column in observe.columns(record))
    assert all(f"| `{term}` |" in text for term in recipe.task.reward_terms)
    assert "## Success" in text and "## Settings" in text


@pytest.mark.parametrize("path", sorted(MADE))
def test_links_of_a_generated_page_lead_somewhere(path):
    """Before the site is built, which takes minutes."""
    for target in re.findall(r"\]\(([\w./-]+)(?:#[\w-]+)?\)", MADE[path]):
        there = os.path.normpath(Path(path).parent / target)
        assert there in MADE or (ROOT / "docs" / there).is_file(), target


def test_what_was_measured_is_told(monkeypatch):
    text = MADE["environments/ScratchItchJaco-v0.md"]
    assert "success of all 8 seeds" in text and "gentle success" in text
    monkeypatch.setattr(environments, "read_results", lambda *_, **__: [])
    assert "No policy has been measured" in environments.page("ScratchItchJaco-v0")


def test_replays_are_linked_where_they_are_asked_for(monkeypatch):
    name, link = "ReachingJaco-v0", 'href="../replays/ReachingJaco-v0.html"'
    assert environments.replayed() == [] and link not in MADE[f"environments/{name}.md"]
    monkeypatch.setenv("DOCS_REPLAYS", name)
    assert environments.replayed() == [name] and link in environments.page(name)
    monkeypatch.setenv("DOCS_REPLAYS", "all")
    assert name in environments.replayed()
    monkeypatch.setattr(environments, "shipped", lambda: [name])
    assert environments.replayed() == [name]


def test_every_page_has_one_place():
    placed = flat(pages.navigation())
    written = {str(p.relative_to(ROOT / "docs")) for p in (ROOT / "docs").rglob("*.md")}
    tutorials = {f"tutorials/{path.name}" for path in TUTORIALS}
    assert sorted(placed) == sorted({*written, *MADE, *tutorials})


def test_pages_of_other_authors_find_a_place(tmp_path: Path, monkeypatch):
    (tmp_path / "new_thing.md").write_text("# New")
    monkeypatch.setattr(pages, "DOCS", tmp_path)
    assert "new_thing.md" in flat(pages.navigation())


@pytest.mark.parametrize(
    ("text", "folder", "shown"),
    [
        ("[a](docs/care.md#x)", ROOT, "[a](care.md#x)"),
        ("![a](docs/images/all_pairs.jpg)", ROOT, "![a](images/all_pairs.jpg)"),
        ("[c](../CONTRIBUTING.md)", ROOT / "docs", "[c](contributing.md)"),
        ("[env.py](../agym_jax/env.py)", ROOT / "docs", "`env.py`"),
        ("[`env`](../agym_jax/env.py)", ROOT / "docs", "`env`"),
        ("[x](https://a.b/c.md)", ROOT, "[x](https://a.b/c.md)"),
        ("[x](#here)", ROOT, "[x](#here)"),
    ],
)
def test_links_stay_within_the_site(text, folder, shown):
    assert pages.relink(text, folder) == shown


def test_what_changes_results_comes_first():
    text = MADE["versions.md"]
    assert text.index("what changes results\n") < text.index("## All changes")
    assert "nightstand" in text[: text.index("## All changes")]


def test_the_reference_has_what_users_import():
    text = "\n".join(reference.pages().values())
    for module in ("agym_jax", "agym_jax.wrappers", "agym_jax.adapters.gymnasium", "train.ppo"):
        assert f"::: {module}\n" in text


@pytest.mark.parametrize("path", TUTORIALS, ids=lambda path: path.stem)
def test_tutorials_begin_with_a_title(path: Path):
    text = path.read_text()
    assert re.match(r"# %% \[markdown\]\n# # \w", text) and ast.parse(text)


@pytest.mark.jit
def test_make_it_yours_runs():
    names: dict = {}
    blocks = re.findall(r"^```python\n(.*?)^```$", YOURS, re.S | re.M)
    assert len(blocks) == 2
    exec(compile(blocks[0], "make_it_yours.md", "exec"), names)
    assert names["env"].changes == names["one"].unwrapped.core.changes
    exec(compile(blocks[1], "make_it_yours.md", "exec"), names)
    assert set(names["env"].changes) == {
        f"robot.{x}"
        for x in (
            "friction", "strength", "latency", "position_noise", "angle_noise", "force_noise", "rare_starts",
        )
    }  # fmt: skip


@pytest.mark.slow
@pytest.mark.jit
def test_the_complete_task_runs_as_the_page_says(tmp_path: Path):
    """In programs of their own: build, observe, train, evaluate."""
    code = re.search(r'```python title="waving.py"\n(.*?)^```$', CREATE, re.S | re.M)
    shell = re.search(r"^In its folder.*?```bash\n(.*?)^```$", CREATE, re.S | re.M)
    assert code and shell
    (tmp_path / "waving.py").write_text(code[1])
    tool = f'agym-jax() {{ "{sys.executable}" -m agym_jax "$@"; }}'
    done = subprocess.run(
        ["bash", "-euc", f"{tool}\n{shell[1]}"],
        cwd=tmp_path, capture_output=True, text=True, check=False, timeout=PROCESS_SECONDS,
        env={**os.environ, "PYTHONPATH": str(ROOT), "JAX_PLATFORMS": "cpu"},
    )  # fmt: skip
    said = done.stdout + done.stderr
    assert done.returncode == 0, said
    assert "16 kept" in said and "`hand_pos_goal`" in said and "trained 20,480 steps" in said
    assert (tmp_path / "trained_models" / "WavingJaco-v0" / "policy.npz").is_file()
