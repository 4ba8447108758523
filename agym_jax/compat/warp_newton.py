"""One patch to MuJoCo Warp: Newton's method builds the Hessian anew in every iteration.

MuJoCo Warp keeps it between iterations, and adds or subtracts the rows that an iteration switches on or off, in float32. Rows that
are switched off leave their rounding errors behind. In ArmManipulation, where the tool is pressed into a bed with rolling
friction, a step began with 116 active rows and a largest eigenvalue of 77,000, and ended with 20 rows and a smallest one
of 0.0014; float32 rounds the former by 0.009. So the matrix can be indefinite, its Cholesky factor NaN, and with it the state of the
environment (issue 1415 and pull request 1672 of google-deepmind/mujoco_warp). C MuJoCo computes in float64.

Policies find such states: an episode that ended so was spared all negative rewards to come. One of eight seeds of
ArmManipulationJaco learned to press until its simulation diverged (docs/benchmarks.md, "Numerical stability").

``tests/compat/test_warp_newton.py`` has the state of such a step; delete this file when its
``test_without_the_patch_it_diverges`` fails.
"""

from __future__ import annotations

import functools
from typing import Any

from agym_jax.compat.switch import applies


@functools.cache
def rebuild_hessians() -> None:
    """Patch MuJoCo Warp, once, where it is needed and not switched off. Before its kernels are compiled."""
    if not applies("warp_newton", "mujoco", "3.17", "3.18"):
        return
    from mujoco.mjx.third_party.mujoco_warp._src import solver

    solver._use_incremental = _never


def _never(_model: Any) -> bool:
    return False
