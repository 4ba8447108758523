"""What agym_jax asks of JAX: full float32 in matrix products, a cache of compiled programs, threads that do not wait.

GPUs round the factors of a product to TF32's 10 bits unless they are told not to: up to half a
millimetre in a metre. Environments, policies and learning are guarded by ``full_precision``.
"""

from __future__ import annotations

import functools
import os
import threading
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
from typing import Any, ParamSpec, TypeVar

import jax
from jax.experimental.compilation_cache import compilation_cache
from jaxlib import xla_client

P = ParamSpec("P")
R = TypeVar("R")


def full_precision(function: Callable[P, R]) -> Callable[P, R]:
    """A function that is traced with full precision, inside of any ``jax.jit``."""

    @functools.wraps(function)
    def traced(*args: P.args, **kwargs: P.kwargs) -> R:
        with jax.default_matmul_precision("highest"):
            return function(*args, **kwargs)

    return traced


def own_stream() -> AbstractContextManager[Any]:
    """A context in which compiled programs run beside those that other threads call.

    On a CPU, JAX begins a program when the last one of its execution stream is done, and all threads have the same
    stream unless they say otherwise: two threads that step environments took turns.
    """
    stream = getattr(xla_client, "execution_stream_id", None)  # not part of JAX's promises
    return nullcontext() if stream is None else stream(threading.get_ident())


def run_inline() -> None:
    """Let programs on a CPU run on the thread that calls them, if JAX has not begun to compute yet.

    Otherwise every call wakes a thread of JAX's and waits for it; a control step on C MuJoCo makes seven, of a tenth of a
    millisecond each. Nothing else changes but that a call returns when its result is there. Called where an environment
    is built, never on import.
    """
    jax.config.update("jax_cpu_enable_async_dispatch", False)


ONE_THREAD = {"xla_cpu_scheduler_type": "CPU_SCHEDULER_TYPE_MEMORY_OPTIMIZED"}
"""How XLA is to compile what runs beside other threads on a CPU: one operation after the other on the thread that calls. Otherwise it
shares them with other threads, at ten microseconds each."""
SMALL = ONE_THREAD | {"xla_cpu_experimental_ynn_fusion_type": ""}
"""The same for programs of microseconds: without YNNPACK, which is fast with large sums and takes long to begin small ones."""


@functools.cache
def known_options(small: bool) -> dict[str, str]:
    """``SMALL`` or ``ONE_THREAD``, or nothing where this version of XLA does not know them."""
    options = SMALL if small else ONE_THREAD
    try:
        jax.jit(lambda: 0, compiler_options=options).lower().compile()
    except jax.errors.JaxRuntimeError:
        return {}
    return options


def enable_compilation_cache() -> None:
    """Keep compiled programs in a folder of the user's: MJX takes long to compile, once is enough.

    ``AGYM_JAX_CACHE`` names another folder, or switches this off with ``off``; a cache that was
    configured in JAX itself is left alone. Called where an environment is built or a command
    starts, never on import; calling it again changes nothing.
    """
    wanted = os.environ.get("AGYM_JAX_CACHE", "")
    configured = getattr(jax.config, "jax_compilation_cache_dir", None)
    if wanted.lower() in ("off", "0", "no") or configured:
        return
    base = os.environ.get("XDG_CACHE_HOME") or "~/.cache"
    folder = Path(wanted or Path(base) / "agym_jax" / "xla").expanduser()
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError:  # a read-only home: compile every time
        return
    jax.config.update("jax_compilation_cache_dir", str(folder))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.1)
    # JAX decides at its first compilation whether there is a cache; that may lie behind us.
    compilation_cache.reset_cache()
