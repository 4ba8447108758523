"""The two implementations of MJX: which one runs, and how it is set up."""

from __future__ import annotations

import copy
import importlib.util

import jax
import mujoco
from mujoco import mjx

from agym_jax.errors import ImplementationError, did_you_mean

IMPLEMENTATIONS = ("auto", "jax", "warp")
WARP_CONTACTS_PER_WORLD = 24
WARP_ROWS_PER_WORLD = 128
WARP_ITERATIONS, WARP_LS_ITERATIONS = 20, 20
"""Warp stops when it has converged, so generous limits cost nothing."""
WARP_LOST = 0b1001111
"""Bits of Warp's overflow flags that mean lost contacts or rows: NEFC, NJMAX_NNZ, BROADPHASE,
NARROWPHASE, CONTACT_MATCH (not: iteration limits). MuJoCo Warp 3.17, types.OverflowType."""


def choose_impl(impl: str) -> str:
    """The physics implementation that a name stands for on this machine.

    Raises:
        ImplementationError: there is no such implementation, or Warp is not installed.
    """
    if impl not in IMPLEMENTATIONS:
        raise ImplementationError(
            f"Unknown implementation {impl!r}. {did_you_mean(impl, IMPLEMENTATIONS)}"
        )
    has_warp = importlib.util.find_spec("warp") is not None
    if impl == "warp" and not has_warp:
        raise ImplementationError(
            "impl='warp' needs the package warp-lang: pip install 'agym_jax[cuda]' "
            "(or use impl='jax', which runs everywhere)."
        )
    if impl == "auto":
        return "warp" if has_warp and jax.default_backend() == "gpu" else "jax"
    return impl


def put_model(model: mujoco.MjModel, impl: str) -> mjx.Model:
    """A MuJoCo model on the device, with the solver limits of the implementation."""
    if impl != "warp":
        return mjx.put_model(model, impl=impl)
    model = copy.copy(model)
    model.opt.iterations, model.opt.ls_iterations = WARP_ITERATIONS, WARP_LS_ITERATIONS
    put = mjx.put_model(model, impl=impl)
    option = put.opt._impl.replace(warn_overflow=WARP_LOST)  # no print for iteration limits
    return put.replace(opt=put.opt.replace(_impl=option))
