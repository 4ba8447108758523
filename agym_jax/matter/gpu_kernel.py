"""GPU kernels with one program per environment: what the particle and the cloth kernels share.

Kernels are written in Pallas and compiled by Triton for NVIDIA GPUs. The threads of a program work on one
environment: its state stays in their registers, and what they have to read of each other they write to a scratch
array in GPU memory that only this program uses. ``jax.vmap`` over environments becomes the grid of programs.

Pallas takes half a second to import and only food, water and cloth need it, so it is imported at first use.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
from jax import Array

THREADS_PER_WARP = 32

Program = Callable[[Sequence[Any], Sequence[Any], Any, Callable[[], None]], None]
"""A kernel's program. Takes references to the inputs, the outputs and the scratch array, and a barrier: after it
every thread sees what all threads wrote before it."""


def run_kernel(
    program: Program,
    inputs: Sequence[Array],
    out_shape: Sequence[jax.ShapeDtypeStruct],
    scratch_shape: tuple[int, ...],
    *,
    num_warps: int,
    name: str | None = None,
    interpret: bool = False,
) -> list[Array]:
    """Run a program as one GPU kernel.

    Args:
        program: writes the outputs.
        inputs: arrays that the program reads.
        out_shape: shapes and types of the outputs.
        scratch_shape: of the float32 scratch array.
        num_warps: warps of 32 threads that work on one environment.
        name: of the kernel, for profilers.
        interpret: run the program operation by operation, on any device.

    Returns:
        the outputs.
    """
    from jax.experimental import pallas
    from jax.experimental.pallas import triton

    def barrier() -> None:
        if not interpret:
            triton.debug_barrier()

    def split(*refs: Any) -> None:
        program(refs[: len(inputs)], refs[len(inputs) : -1], refs[-1], barrier)

    *outputs, _ = pallas.pallas_call(
        split,
        out_shape=[*out_shape, jax.ShapeDtypeStruct(scratch_shape, jnp.float32)],
        compiler_params=triton.CompilerParams(num_warps=num_warps, num_stages=1),
        interpret=interpret,
        name=name,
    )(*inputs)
    return outputs


def block(start: Array | int, size: int) -> Any:
    """Index of ``size`` consecutive entries of a reference, from ``start`` on."""
    from jax.experimental import pallas

    return pallas.ds(start, size)


@partial(jax.custom_jvp, nondiff_argnums=(0, 1))
def kernel_or_xla(by_kernel: Callable[..., Any], by_xla: Callable[..., Any], *inputs: Any) -> Any:
    """Call one of two functions that compute the same: the first on NVIDIA GPUs, the second elsewhere.

    Derivatives are those of the second, on every device.
    """
    return jax.lax.platform_dependent(*inputs, cuda=by_kernel, default=by_xla)


@kernel_or_xla.defjvp
def _jvp_of_xla(
    _: Callable[..., Any], by_xla: Callable[..., Any], inputs: tuple, changes: tuple
) -> tuple:
    return jax.jvp(by_xla, inputs, changes)
