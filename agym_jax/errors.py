"""Errors that say what was asked, what exists, the nearest match, and what to do next."""

from __future__ import annotations

import difflib
import operator
import re
from collections.abc import Iterable
from typing import Any


def did_you_mean(name: Any, options: Iterable[str]) -> str:
    """A sentence with the nearest of ``options``, and all of them if they are few.

    Args:
        name: what was asked for.
        options: what exists.
    """
    known = sorted(set(options))
    if not known:
        return "There are none."
    folded = {option.lower(): option for option in known}
    words = {_words(option): option.lower() for option in known}
    near = [words[_words(str(name))]] if _words(str(name)) in words else []
    near = near or difflib.get_close_matches(str(name).lower(), list(folded), n=1, cutoff=0.5)
    nearest = f"Did you mean {folded[near[0]]!r}? " if near else ""
    shown = ", ".join(known[:12]) + (f", ... ({len(known)} in all)" if len(known) > 12 else "")
    return f"{nearest}There are: {shown}."


def _words(name: str) -> tuple[str, ...]:
    """The words that a name is written of, in no order: those of JacoScratchItch are those of ScratchItchJaco."""
    return tuple(sorted(re.findall(r"[A-Z]+[a-z0-9]*|[a-z0-9]+", name)))


class AgymError(Exception):
    """Base of every error that agym_jax raises on purpose."""


class UnknownNameError(AgymError, KeyError):
    """A name that does not exist: an environment, robot, joint, site or task."""

    def __init__(self, kind: str, name: Any, options: Iterable[str], advice: str = ""):
        self.kind, self.name = kind, name
        super().__init__(f"Unknown {kind} {name!r}. {did_you_mean(name, options)} {advice}".strip())

    def __str__(self) -> str:
        return str(self.args[0])


class MissingAssetError(AgymError, FileNotFoundError):
    """A packaged file that is not there."""


class MissingExtraError(AgymError, ImportError):
    """An optional Python package that this needs is not installed."""


class MeshError(AgymError, RuntimeError):
    """Meshes that a robot does not have, that cannot be read, or that do not fit it."""


class ArgumentError(AgymError, ValueError):
    """An argument of the wrong kind, or out of range."""


def checked_count(name: str, value: Any, at_least: int = 1, advice: str = "") -> int:
    """A whole number.

    Args:
        name: of the argument.
        value: of the argument.
        at_least: the smallest that makes sense.
        advice: what to do, for the error.

    Raises:
        ArgumentError: it is no whole number, or too small.
    """
    try:
        count = None if isinstance(value, bool) else operator.index(value)
    except TypeError:
        count = None
    if count is None or count < at_least:
        raise ArgumentError(
            f"{name} must be a whole number of at least {at_least}, got {value!r}. {advice}".strip()
        )
    return count


class ActionError(AgymError, ValueError):
    """An action of the wrong shape, or with NaN or infinite entries."""


class ImplementationError(AgymError, ValueError):
    """A physics implementation that does not exist or cannot run here."""


class BufferOverflowError(AgymError, RuntimeError):
    """Warp's contact or constraint buffers were too small, so contacts were lost."""


class WrapperError(AgymError, AttributeError):
    """A wrapper of Brax around what it cannot wrap, or one that asks for what there is not."""


class SpecError(AgymError, ValueError):
    """A robot, tool, seat or task whose description does not fit together."""


class DamagedFileError(AgymError, ValueError):
    """A file whose content does not match its checksum, or that is not one of this project."""


class SaveFolderError(AgymError, OSError):
    """A folder that results cannot be written to."""


class MissingPlacementError(AgymError, FileNotFoundError):
    """A task-robot pair without a bank of start poses."""


class MissingPostureError(AgymError, FileNotFoundError):
    """A task on the bed without its bank of people who lie there, or with a damaged one."""


class MissingFillError(AgymError, FileNotFoundError):
    """A vessel without its bank of settled particles, or with a damaged one."""


class PolicyNotFoundError(AgymError, FileNotFoundError):
    """No policy file where one was asked for."""


class PolicyDamagedError(DamagedFileError):
    """A policy file that cannot be read."""


class PolicyEnvironmentError(AgymError, ValueError):
    """A policy that was trained in another environment."""


class PolicyLayoutError(AgymError, ValueError):
    """A policy that reads another observation layout or has other sizes."""
