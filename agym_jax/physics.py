"""The two implementations of MJX: which one runs, and how it is set up."""

from __future__ import annotations

import copy
import importlib.util
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
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


def place_static_geoms(static: np.ndarray, model: mjx.Model, data: Any) -> Any:
    """Put geoms that no joint moves where this world's bodies are.

    MuJoCo Warp computes them once, in ``make_data``, from the shared model (``_geom_local_to_global``
    in its ``smooth.py``), although ``body_pos``, ``body_quat`` and ``geom_pos`` differ from world to
    world here. Call it once an episode, after ``mjx.kinematics``.

    Args:
        static: geoms on bodies that are welded to the world (n,).
        model: with this world's fields.
        data: of one world, ``xpos`` and ``xmat`` up to date.
    """
    bodies = np.asarray(model.geom_bodyid)[static]
    turn = data.xmat[bodies].reshape(-1, 3, 3)
    pos = data.xpos[bodies] + jnp.einsum("nij,nj->ni", turn, model.geom_pos[static])
    mat = turn @ _matrices(model.geom_quat[static])
    xmat = data.geom_xmat.at[static].set(mat.reshape(-1, *data.geom_xmat.shape[1:]))
    return data.replace(geom_xpos=data.geom_xpos.at[static].set(pos), geom_xmat=xmat)


def _matrices(quats: jax.Array) -> jax.Array:
    """Rotation matrices (n, 3, 3) of unit quaternions wxyz (n, 4)."""
    w, x, y, z = jnp.moveaxis(quats, -1, 0)
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return jnp.moveaxis(jnp.array(rows), -1, 0)
