"""One patch to Warp: it knows a stream of JAX's for as long as any wrapper of that stream lives.

Called by JAX, Warp wraps JAX's stream in a ``warp.Stream``, which registers it, and unregisters it when it is
deleted. Mostly that is at the end of the call. But where Warp makes a new kernel in the call, as MuJoCo
Warp does for a new number of environments, ``warp.func`` keeps its own frame, and so the frames of all its callers,
until the garbage collector comes. If that is in a later call, the stream is unregistered under its hands:
"Warp error: unknown stream". So ended, on an H200, evaluations that followed a training in the same process (Warp
1.18). ``tests/compat/test_warp_streams.py`` fails when Warp no longer keeps frames; delete this file then.
"""

from __future__ import annotations

import functools
import threading
from typing import Any

from agym_jax.compat.switch import applies

_lock = threading.RLock()  # the collector may come while it is held
_wrappers: dict[int, set[int]] = {}


@functools.cache
def hold_streams() -> None:
    """Patch Warp, once, where it is needed and not switched off."""
    if not applies("warp_streams", "warp-lang", "1.12", "2.0"):
        return
    import warp

    begin, end = warp.Stream.__init__, warp.Stream.__del__

    def __init__(self: Any, *args: Any, **kwargs: Any) -> None:
        with _lock:
            if stream := kwargs.get("cuda_stream"):
                _wrappers.setdefault(stream, set()).add(id(self))
            begin(self, *args, **kwargs)

    def __del__(self: Any) -> None:
        with _lock:
            others = _wrappers.get(self.cuda_stream, set())
            others.discard(id(self))
            if self.owner or not others:
                end(self)

    warp.Stream.__init__, warp.Stream.__del__ = __init__, __del__
