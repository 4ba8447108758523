# ruff: noqa: D103
"""Catalogues: names are known at once, what they stand for is imported when it is read."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from agym_jax.catalogue import Catalogue
from agym_jax.robots import ROBOTS
from agym_jax.tasks import TASKS


@pytest.fixture
def things(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Catalogue[int]:
    """Two entries; the module of the second is broken."""
    (tmp_path / "a_thing.py").write_text("THING = [1]\n")
    (tmp_path / "b_thing.py").write_text("raise RuntimeError('broken')\n")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, "a_thing", raising=False)
    return Catalogue({"a": "a_thing:THING", "b": "b_thing:THING"})


def test_names_are_known_without_an_import(things: Catalogue):
    assert list(things) == ["a", "b"] and len(things) == 2
    assert "b" in things and "c" not in things
    assert "a_thing" not in sys.modules


def test_a_value_is_imported_once(things: Catalogue):
    assert things["a"] == [1] and things["a"] is things["a"] is sys.modules["a_thing"].THING
    with pytest.raises(RuntimeError, match="broken"):
        things["b"]
    with pytest.raises(KeyError):
        things["c"]


def test_entries_are_added_and_removed_as_in_a_dictionary(things: Catalogue):
    things["c"] = 3
    assert things["c"] == 3 and list(things) == ["a", "b", "c"]
    del things["b"]
    assert things.pop("c") == 3 and dict(things) == {"a": [1]}


@pytest.mark.parametrize("catalogue", [TASKS, ROBOTS])
def test_what_is_listed_has_the_name_it_is_listed_under(catalogue: Catalogue):
    assert {name: entry.name for name, entry in catalogue.items()} == {n: n for n in catalogue}
