"""Arrays without elements stay out of ``shard_map``, where XLA's partitioner crashes on them.

jaxlib 0.11.2 on GPUs dies of a segmentation fault in Shardy's ``ManualComputationUnusedInputsPattern`` when an
input, output or constant of a manual computation has no elements, as some of Warp's buffers have. ``hide`` puts a
mark in their place that is part of the tree's structure, ``restore`` makes them anew inside, and ``own_constants``
does the same for those that a function closes over. ``tests/compat/test_shardy_empty.py`` says for which versions
this is known.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
from jax.extend.core import ClosedJaxpr, jaxpr_as_fun

from agym_jax.compat.switch import applies


def needed() -> bool:
    """Whether this JAX is one of those that crash, and nobody has switched the repair off."""
    return applies("shardy_empty", "jax", "0.10", "0.12")


@jax.tree_util.register_static
@dataclass(frozen=True)
class Empty:
    """Stands for an array without elements where such arrays must not be."""

    shape: tuple[int, ...]
    dtype: Any


def hide(tree: Any) -> Any:
    """The tree with a mark in place of every array without elements."""
    if not needed():
        return tree
    return jax.tree.map(lambda x: x if x.size else Empty(x.shape, x.dtype), tree)


def restore(tree: Any) -> Any:
    """The reverse of ``hide``."""

    def array(leaf: Any) -> Any:
        return jnp.zeros(leaf.shape, leaf.dtype) if isinstance(leaf, Empty) else leaf

    return jax.tree.map(array, tree, is_leaf=lambda leaf: isinstance(leaf, Empty))


def own_constants(function: Callable[..., Any]) -> Callable[..., Any]:
    """The function, with arrays without elements made in it that it would otherwise be given."""
    if not needed():
        return function

    def traced(*inputs: Any) -> Any:
        closed, out = jax.make_jaxpr(function, return_shape=True)(*inputs)
        constants = [x if x.size else jnp.zeros(x.shape, x.dtype) for x in closed.consts]
        run = jaxpr_as_fun(ClosedJaxpr(closed.jaxpr, constants))
        return jax.tree.unflatten(jax.tree.structure(out), run(*jax.tree.leaves(inputs)))

    return traced
