# ruff: noqa: D103
"""Result lines say by which commit they were measured, and claim nobody else's."""

from __future__ import annotations

import subprocess
from pathlib import Path

import pytest

import agym_jax
from train.runs import record


@pytest.fixture
def repository(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A repository with one commit, which is taken for the checkout."""
    git = ["git", "-C", str(tmp_path), "-c", "user.name=a", "-c", "user.email=a@b.c"]
    (tmp_path / "pyproject.toml").write_text("")
    for words in (["init", "-q"], ["add", "."], ["commit", "-q", "-m", "first"]):
        subprocess.run([*git, *words], check=True)
    monkeypatch.setattr(record, "ROOT", tmp_path)
    return tmp_path


def test_a_checkout_names_its_commit_and_changes(repository: Path):
    commit = record.commit()
    assert commit is not None and len(commit) == 40
    (repository / "pyproject.toml").write_text("changed")
    assert record.commit() == f"{commit}+changes"


def test_an_installation_inside_of_somebodys_repository_has_no_commit(repository, monkeypatch):
    package = repository / "lib" / "agym_jax"
    package.mkdir(parents=True)
    monkeypatch.setattr(record, "ROOT", package)
    assert record.commit() is None


def test_versions_are_the_packages():
    assert record.versions()["agym_jax"] == agym_jax.__version__
    assert {"python", "jax", "mujoco"} <= set(record.versions())
