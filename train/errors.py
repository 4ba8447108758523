"""Errors raised by training; messages state what was requested, what is valid, and what to do next."""

from __future__ import annotations

import functools
import sys
from collections.abc import Callable
from typing import ParamSpec

from agym_jax.errors import AgymError
from agym_jax.interrupts import INTERRUPTED, raise_again

P = ParamSpec("P")


class ConfigError(AgymError, ValueError):
    """Training settings that are invalid or inconsistent."""


class ActiveHumanError(AgymError, ValueError):
    """Single-agent training with an active person, or two-agent training with a passive one."""


class DivergedError(AgymError, ArithmeticError):
    """Training produced a NaN or infinite loss."""


class CheckpointMismatchError(AgymError, ValueError):
    """A checkpoint for a different environment, observation layout or network."""


class CheckpointWarning(UserWarning):
    """A checkpoint was skipped because it is damaged, or a run cannot be locked."""


class RunInUseError(AgymError, RuntimeError):
    """A run's folder in which another process is training."""


def check_save_dir(save_dir: str | None) -> None:
    """Reject an empty folder name, which would mean the current folder.

    Raises:
        ConfigError: if the name is empty; the message says what to use instead.
    """
    if save_dir is not None and not save_dir.strip():
        raise ConfigError(
            "--save-dir is empty. Name a folder; the current one is --save-dir . (train, coop and sweep write nothing "
            "with --save-dir None)."
        )


def reports_errors(main: Callable[P, int]) -> Callable[P, int]:
    """Wrap a command line so that errors print a message instead of a traceback: exit status 2, or 130 if interrupted."""

    @functools.wraps(main)
    def run(*args: P.args, **kwargs: P.kwargs) -> int:
        raise_again()
        try:
            return main(*args, **kwargs)
        except AgymError as error:
            print(f"{type(error).__name__}: {error}", file=sys.stderr)
            return 2
        except KeyboardInterrupt:
            return INTERRUPTED

    return run
