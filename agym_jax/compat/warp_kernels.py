"""Kernels of MuJoCo Warp, compiled side by side.

Warp compiles a kernel when it is first launched, and so one after another: on a machine that has
none in its cache, the first step of a GPU waited 44 to 60 s for them (Warp's own log of 18 trainings
on an H200). ``compile_kernels`` goes through a step of MuJoCo Warp without launching anything, notes
what it would launch, and compiles that on all cores. MJX adds two small modules of its own, its FFI and
a variant of the broad phase, which are still compiled when they are first launched.
"""

from __future__ import annotations

import contextlib
import math
import os
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any

import jax
import mujoco

from agym_jax.compat.switch import applies

Build = tuple[Any, int]  # a module of kernels, and threads in a block
BLOCK = 256  # Warp's default of the latter on a GPU


_pending: list[Future[Any]] = []
_in_background = False


def compile_kernels(
    model: mujoco.MjModel, rows: int, contacts: int, options: Mapping[str, int]
) -> None:
    """Begin to compile and load what stepping a model takes on JAX's first device.

    ``wait_for_kernels`` says when it is done. Where the repair is switched off, Warp compiles each kernel when it
    is first launched.

    Args:
        model: with the solver's limits as they will be.
        rows: of constraints, for each environment.
        contacts: for each environment.
        options: of MuJoCo Warp, by name, that are not its defaults.
    """
    if not applies("warp_kernels", "warp-lang", "1.12", "2.0"):
        return
    import warp

    device = warp.device_from_jax(jax.local_devices()[0])
    with warp.ScopedDevice(device):
        builds = launched(model, rows, contacts, options)
    pool = ThreadPoolExecutor(os.cpu_count())
    _pending.extend(pool.submit(module.load, device, block) for module, block in builds)
    pool.shutdown(wait=False)


def wait_for_kernels() -> None:
    """Return when all kernels that were begun are loaded; at once within ``kernels_in_background``."""
    while _pending and not _in_background:
        _pending.pop().result()


@contextlib.contextmanager
def kernels_in_background() -> Iterator[None]:
    """Trace and compile JAX's programs while kernels are still compiling; waits for them at the end."""
    global _in_background
    before, _in_background = _in_background, True
    try:
        yield
    finally:
        _in_background = before
    wait_for_kernels()


def launched(
    model: mujoco.MjModel, rows: int, contacts: int, options: Mapping[str, int]
) -> dict[Build, None]:
    """What a step of MuJoCo Warp would launch on Warp's current device, in order. See ``compile_kernels``."""
    from mujoco.mjx.third_party import mujoco_warp

    builds: dict[Build, None] = {}
    with _noting(builds):
        put = mujoco_warp.put_model(model)
        for name, value in options.items():
            setattr(put.opt, name, value)
        mujoco_warp.step(put, mujoco_warp.make_data(model, 1, naconmax=contacts, njmax=rows))
    return builds


@contextlib.contextmanager
def _noting(builds: dict[Build, None]) -> Iterator[None]:
    """In this thread, note kernels instead of launching them, and go once through every loop."""
    import warp

    here = threading.get_ident()

    def launch(
        kernel: Any, dim: int | Sequence[int], inputs: Sequence = (), outputs: Sequence = (),
        device: Any = None, block_dim: int | None = None, **_: Any,
    ) -> None:  # fmt: skip
        if math.prod(dim if isinstance(dim, Sequence) else (dim,)) == 0:
            return
        if kernel.is_generic:
            kernel = kernel.add_overload(kernel.infer_argument_types([*inputs, *outputs]))
        threads = 1 if warp.get_device(device).is_cpu else block_dim or BLOCK
        builds[kernel.module, threads] = None

    def once(
        condition: Any, while_body: Callable | None = None, on_true: Callable | None = None,
        on_false: Callable | None = None, **arguments: Any,
    ) -> None:  # fmt: skip
        for body in (while_body, on_true, on_false):
            if body:
                body(**arguments)

    instead = {
        "launch": launch, "launch_tiled": launch, "capture_while": once, "capture_if": once,
    }  # fmt: skip
    originals = {name: getattr(warp, name) for name in instead}

    def chosen(name: str) -> Callable:
        def call(*args: Any, **kwargs: Any) -> Any:
            ours = threading.get_ident() == here
            return (instead if ours else originals)[name](*args, **kwargs)

        return call

    try:
        for name in instead:
            setattr(warp, name, chosen(name))
        yield
    finally:
        for name, original in originals.items():
            setattr(warp, name, original)
