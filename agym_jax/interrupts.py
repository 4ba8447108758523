"""What an interrupt (Ctrl-C, SIGTERM) does while it must not end in the middle of something.

While a command imports its modules there is nothing to lose, and a traceback out of somebody else's package would say
nothing: the process ends at once. While a state is being saved, the interrupt waits until it is.
"""

from __future__ import annotations

import contextlib
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from types import FrameType

INTERRUPTED = 130
"""Exit status of a process that was interrupted, as shells have it."""


def _leave(*_: object) -> None:
    os._exit(
        INTERRUPTED
    )  # an exception could be caught, or turned into another, by what is imported


def is_program() -> bool:
    """Whether this package is being imported in order to run one of its commands."""
    if not sys.argv or sys.argv[0] != "-m":  # which it is while Python looks for the module
        return bool(sys.argv) and Path(sys.argv[0]).stem == "agym-jax"
    at = sys.orig_argv.index("-m") + 1 if "-m" in sys.orig_argv else 0
    module = sys.orig_argv[at]
    trainer = getattr(sys.modules.get("train"), "__file__", None)
    ours = trainer and Path(trainer).parents[1] == Path(__file__).parents[1]
    return module == "agym_jax" or module.startswith(
        ("agym_jax.train.", "train.") if ours else "agym_jax.train."
    )


def leave_quietly() -> None:
    """From now on, Ctrl-C ends the process without a word. Where it does something else already, it still does."""
    main = threading.current_thread() is threading.main_thread()
    if main and signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, _leave)


def raise_again() -> None:
    """The opposite of ``leave_quietly``: Ctrl-C raises ``KeyboardInterrupt``."""
    if signal.getsignal(signal.SIGINT) is _leave:
        signal.signal(signal.SIGINT, signal.default_int_handler)


@contextlib.contextmanager
def deferred() -> Iterator[None]:
    """Let SIGINT and SIGTERM wait until the block has ended; what they do, they do then.

    Only where Python handles them: a SIGTERM that ends the process still does. In other threads than the main one,
    which no handler interrupts, this does nothing.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    handlers: dict[int, Callable[[int, FrameType | None], object]] = {}
    came: list[int] = []
    active = True

    def wait(number: int, frame: FrameType | None) -> None:
        if active:
            came.append(number)
        else:
            handlers[number](number, frame)

    for number in (signal.SIGINT, signal.SIGTERM):
        handler = signal.getsignal(number)
        if callable(handler):
            handlers[number] = handler
            signal.signal(number, wait)
    try:
        yield
    finally:
        active = False
        for number, handler in handlers.items():
            signal.signal(number, handler)
        for number in came[:1]:
            handlers[number](number, None)
