"""Which products of matrices a function makes in full precision, by its program alone."""

from __future__ import annotations

from collections.abc import Callable

import jax


def _products(jaxpr) -> list:
    """All matrix products in a program, those of inner programs included."""
    found = []
    for equation in jaxpr.eqns:
        if equation.primitive.name == "dot_general":
            found.append(equation)
        for inner in jax.core.jaxprs_in_params(equation.params):
            found += _products(inner)
    return found


def full(function: Callable, *arguments) -> list[bool]:
    """For every product that a function makes, whether it is never rounded, whatever the caller has set."""
    with jax.default_matmul_precision("tensorfloat32"):
        return full_in(jax.make_jaxpr(function)(*arguments))


def full_in(program: jax.core.ClosedJaxpr) -> list[bool]:
    """For every product of a traced program, whether its own code asks for full precision."""
    highest = (jax.lax.Precision.HIGHEST,) * 2
    return [product.params["precision"] == highest for product in _products(program.jaxpr)]
