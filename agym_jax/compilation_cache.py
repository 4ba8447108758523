"""JAX's compilation cache, on by default: MJX takes long to compile, once is enough."""

from __future__ import annotations

import os
from pathlib import Path

import jax


def enable() -> None:
    """Use a per-user folder for compiled programs, unless told otherwise.

    ``AGYM_JAX_CACHE`` names another folder, or switches this off with ``off``; a cache that the
    user configured in JAX itself is left alone.
    """
    wanted = os.environ.get("AGYM_JAX_CACHE", "")
    if wanted.lower() in ("off", "0", "no") or getattr(
        jax.config, "jax_compilation_cache_dir", None
    ):
        return
    base = os.environ.get("XDG_CACHE_HOME") or "~/.cache"
    folder = Path(wanted or Path(base) / "agym_jax" / "xla").expanduser()
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError:  # a read-only home: compile every time
        return
    jax.config.update("jax_compilation_cache_dir", str(folder))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.1)
