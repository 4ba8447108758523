"""What agym_jax asks of JAX: full float32 in matrix products, and a cache of compiled programs.

GPUs round the factors of a product to TF32's 10 bits unless they are told not to: up to half a
millimetre in a metre. Environments, policies and learning are guarded by ``full_precision``.
"""

from __future__ import annotations

import functools
import os
from collections.abc import Callable
from pathlib import Path
from typing import ParamSpec, TypeVar

import jax
from jax.experimental.compilation_cache import compilation_cache

P = ParamSpec("P")
R = TypeVar("R")


def full_precision(function: Callable[P, R]) -> Callable[P, R]:
    """A function that is traced with full precision, inside of any ``jax.jit``."""

    @functools.wraps(function)
    def traced(*args: P.args, **kwargs: P.kwargs) -> R:
        with jax.default_matmul_precision("highest"):
            return function(*args, **kwargs)

    return traced


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
