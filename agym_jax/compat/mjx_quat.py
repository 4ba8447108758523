"""One patch to MJX: keep XLA's CPU compiler from recomputing a kinematic chain exponentially.

On the CPU, jaxlib 0.10 fuses the quaternion products of a whole arm into one loop in which every
link computes its parent anew: kinematics of Jaco and a person then takes 430 ms instead of 0.7 ms
for 8 environments, and 37 s instead of 8 s to compile (2 cores; jaxlib 0.10.2, MJX 3.17). A barrier around
each product, which changes no value, prevents that. ``tests/compat/test_mjx_quat.py`` fails when MJX no
longer has the function; delete both when kinematics is as fast without. ``sim.mjx`` applies it.
"""

from __future__ import annotations

import jax

from agym_jax.compat.mjx_print import mjx  # isort: skip (before MJX's parts)
from mujoco.mjx._src import math as mjx_math

from agym_jax.compat.switch import applies

__all__ = ["apply", "mjx"]

_original = mjx_math.quat_mul


def _quat_mul(u: jax.Array, v: jax.Array) -> jax.Array:
    product = _original(u, v)
    return jax.lax.optimization_barrier(product) if jax.default_backend() == "cpu" else product


def apply() -> None:
    """Patch MJX, once, where it is needed and not switched off."""
    if applies("mjx_quat", "mujoco-mjx", "3.17", "3.18"):
        mjx_math.quat_mul = _quat_mul
