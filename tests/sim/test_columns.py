# ruff: noqa: D103
"""Trees in the columns of one array: what comes out is what went in, bit by bit."""

from __future__ import annotations

import threading
from typing import Any

import jax
import numpy as np
import pytest
from jaxlib import xla_client

from agym_jax.jax_settings import own_stream
from agym_jax.sim import columns
from agym_jax.sim.columns import ALIGNMENT, Columns, Program


def _tree(n: int) -> dict[str, Any]:
    rng = np.random.default_rng(n)
    return {
        "pose": rng.normal(size=(n, 2, 3)).astype(np.float32),
        "who": (rng.integers(-9, 9, n, np.int32), rng.integers(0, 2, (n, 4)).astype(bool), None),
        "key": rng.integers(0, 2**32, (n, 2), np.uint32),
        "nothing": np.zeros((n, 0), np.float32),
    }


def _same(mine: Any, theirs: Any) -> None:
    assert jax.tree.structure(mine) == jax.tree.structure(theirs)
    for a, b in zip(jax.tree.leaves(mine), jax.tree.leaves(theirs), strict=True):
        assert a.dtype == b.dtype
        np.testing.assert_array_equal(a, b)


def test_a_tree_comes_back():
    tree = _tree(5)
    tree["pose"][0, 0] = np.nan, np.inf, -0.0
    _same(Columns.of(tree, 5).tree(), tree)
    assert Columns.of(tree, 5).layout is Columns.of(_tree(3), 8).layout


def test_missing_rows_are_as_the_first():
    tree, few = _tree(5), Columns.of(_tree(5), 8, part=slice(1, 4))
    _same(few.tree(3), jax.tree.map(lambda x: x[1:4], tree))
    np.testing.assert_array_equal(few.array[3:], few.array[[0] * 5])


@pytest.mark.parametrize("rows", [[0, 1, 2], [6, 0, 3], [2, 1, 0]])
def test_rows_are_where_they_are_asked_to_be(rows: list[int]):
    tree = _tree(3)
    found = Columns.of(tree, 8, rows=np.array(rows))
    _same(jax.tree.map(lambda x: x[rows], found.tree()), tree)
    rest = np.setdiff1d(np.arange(8), rows)
    np.testing.assert_array_equal(found.array[rest], found.array[[rows[0]] * len(rest)])


def test_wide_numbers_become_narrow_without_a_word():
    wide = {"x": np.array([[1e300], [1.5]]), "n": np.array([[7], [8]])}
    found = Columns.of(wide, 2).tree()
    np.testing.assert_array_equal(found["x"], np.float32([[np.inf], [1.5]]))
    assert found["x"].dtype == np.float32 and found["n"].dtype == np.int32


def test_a_program_gives_what_its_function_gives():
    def function(tree: Any, add: Any) -> Any:
        return {"sum": tree["pose"].sum() + add[0], "same": tree["who"], "key": tree["key"]}

    tree, add = _tree(4), np.arange(8, dtype=np.float32).reshape(4, 2)
    program = Program(function)
    given = Columns.of(tree, 4), add
    expected = jax.tree.map(np.asarray, jax.vmap(function)(tree, add))
    _same(jax.tree.map(np.zeros_like, expected), program.shapes(*given))
    found = program(*given)
    np.testing.assert_allclose(found.tree()["sum"], expected.pop("sum"), rtol=1e-6)
    _same({k: v for k, v in found.tree().items() if k != "sum"}, expected)
    _same(program(given[0].on_device(), add).tree(), found.tree())  # of the device as of NumPy


def test_arrays_for_programs_lie_where_programs_read_them():
    for shape in ((3, 5), (1, 1), (32, 1000)):
        array = columns.aligned(shape)
        assert array.shape == shape and array.ctypes.data % ALIGNMENT == 0


def test_every_thread_has_a_stream_of_its_own():
    """JAX lets a program of a stream wait for the last one."""
    found = []

    def run() -> None:
        with own_stream():
            found.append(xla_client._xla.get_execution_stream_id())
            barrier.wait(20.0)

    barrier = threading.Barrier(3)
    threads = [threading.Thread(target=run) for _ in range(2)]
    for thread in threads:
        thread.start()
    run()
    for thread in threads:
        thread.join()
    assert len({*found, xla_client._xla.get_execution_stream_id()}) == 4
