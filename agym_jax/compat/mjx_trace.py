"""MJX's kinematics are traced once, however often a program computes them.

MJX writes kinematics out link by link: 0.7 to 1.2 s of tracing (2 cores; MJX 3.17), for the step and again for the
end of a control step and the beginning of an episode. As a compiled function of its own it is traced once for
arguments of the same shapes, and what XLA compiles is the same. ``tests/compat/test_mjx_trace.py`` fails when MJX
does so itself. Warp's kinematics are one call and stay as they are.
"""

from __future__ import annotations

from typing import Any

import jax

from agym_jax.compat.mjx_print import mjx  # isort: skip (before MJX's parts)
from mujoco.mjx._src import smooth

from agym_jax.compat.switch import applies

_original = smooth.kinematics
_traced_once = jax.jit(_original)


def kinematics(model: Any, data: Any) -> Any:
    """``mjx.kinematics``."""
    return (_original if model.impl.value == "warp" else _traced_once)(model, data)


def apply() -> None:
    """Patch MJX, once, where it is needed and not switched off."""
    if applies("mjx_trace", "mujoco-mjx", "3.17", "3.18"):
        smooth.kinematics = mjx.kinematics = kinematics  # pyrefly: ignore
