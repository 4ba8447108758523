"""Errors of training: what was asked, what fits, what to do next."""

from __future__ import annotations

import functools
import sys
from collections.abc import Callable
from typing import ParamSpec

from agym_jax.errors import AgymError
from agym_jax.interrupts import INTERRUPTED, raise_again

P = ParamSpec("P")


class ConfigError(AgymError, ValueError):
    """Training settings that do not fit together."""


class ActiveHumanError(AgymError, ValueError):
    """Single-agent training of an environment in which the person acts too."""


class DivergedError(AgymError, ArithmeticError):
    """Training produced NaN or infinite losses."""


class CheckpointMismatchError(AgymError, ValueError):
    """A checkpoint of another environment, observation layout or network."""


class CheckpointWarning(UserWarning):
    """A checkpoint was skipped because it is damaged, or a run cannot be locked."""


class RunInUseError(AgymError, RuntimeError):
    """The folder of a run in which another process is training."""


def check_save_dir(save_dir: str | None) -> None:
    """Refuse a folder without a name, which would be the current one.

    Raises:
        ConfigError: says what to write instead.
    """
    if save_dir is not None and not save_dir.strip():
        raise ConfigError(
            "--save-dir is empty. Name a folder; the current one is --save-dir . (train, coop and sweep write nothing "
            "with --save-dir None)."
        )


def reports_errors(main: Callable[P, int]) -> Callable[P, int]:
    """A command line that says what is wrong instead of showing where it was noticed: exit status 2, interrupted 130."""

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
