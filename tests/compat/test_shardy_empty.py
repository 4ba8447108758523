# ruff: noqa: D103
"""Arrays without elements stay out of ``shard_map`` where jaxlib's partitioner crashes on them."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from agym_jax.compat import shardy_empty
from agym_jax.compat.shardy_empty import Empty, hide, own_constants, restore

TREE = {"none": jnp.zeros((2, 0), jnp.int32), "some": (jnp.arange(3.0), jnp.zeros((0, 2)))}
NOTHING = jnp.zeros((0, 2))


def add(x: jax.Array) -> jax.Array:
    """Reads a constant without elements."""
    return x + NOTHING.sum()


def empty_constants(function) -> list:
    return [x for x in jax.make_jaxpr(function)(jnp.ones(2)).consts if not np.size(x)]


def test_a_tree_comes_back_as_it_was():
    hidden = hide(TREE)
    assert [x.shape for x in jax.tree.leaves(hidden)] == [(3,)]
    assert hidden["none"] == Empty((2, 0), jnp.dtype("int32"))
    back = restore(hidden)
    assert jax.tree.structure(back) == jax.tree.structure(TREE)
    for ours, theirs in zip(jax.tree.leaves(back), jax.tree.leaves(TREE), strict=True):
        assert (ours.shape, ours.dtype) == (theirs.shape, theirs.dtype)
        np.testing.assert_array_equal(ours, theirs)


def test_marks_are_structure_which_tells_shapes_apart():
    same, other = hide({"x": jnp.zeros((0, 2))}), hide({"x": jnp.zeros((0, 3))})
    assert jax.tree.structure(hide({"x": jnp.ones((0, 2))})) == jax.tree.structure(same)
    assert jax.tree.structure(same) != jax.tree.structure(other)
    assert jax.jit(lambda tree: tree)(same) == same


def test_a_function_makes_its_own_empty_constants_and_computes_the_same():
    assert empty_constants(add) and not empty_constants(own_constants(add))
    np.testing.assert_array_equal(own_constants(add)(jnp.ones(2)), add(jnp.ones(2)))


def test_it_can_be_switched_off(monkeypatch: pytest.MonkeyPatch):
    assert shardy_empty.needed()
    monkeypatch.setenv("AGYM_JAX_COMPAT", "-shardy_empty")
    assert not shardy_empty.needed()
    assert hide(TREE) is TREE and own_constants(add) is add


def test_it_is_bounded_by_version_and_the_bound_is_in_sight(monkeypatch: pytest.MonkeyPatch):
    """When this fails JAX is newer than anybody has looked at.

    Run training on two GPUs with ``impl="warp"`` and ``AGYM_JAX_COMPAT=-shardy_empty`` there. If that no longer
    dies of a segmentation fault, delete ``agym_jax/compat/shardy_empty.py``; if it does, raise the bound.
    """
    assert shardy_empty.needed(), f"jax {jax.__version__} has not been looked at"
    for version, applies in (
        ("0.9.2", False),
        ("0.10.0", True),
        ("0.11.9", True),
        ("0.12.0", False),
    ):
        monkeypatch.setattr("importlib.metadata.version", lambda _, version=version: version)
        assert shardy_empty.needed() is applies, version
