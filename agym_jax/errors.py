"""Errors whose messages state what was requested, what exists, the closest match, and what to do next."""

from __future__ import annotations

import difflib
import operator
import re
from collections.abc import Iterable
from typing import Any


def did_you_mean(name: Any, options: Iterable[str]) -> str:
    """Return a sentence that suggests the closest of ``options``, and lists them all if there are few.

    Args:
        name: the requested name.
        options: the names that exist.
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
    """Split a name into its words, regardless of order: JacoScratchItch has the same words as ScratchItchJaco."""
    return tuple(sorted(re.findall(r"[A-Z]+[a-z0-9]*|[a-z0-9]+", name)))


class AgymError(Exception):
    """Base class of every error that agym_jax raises deliberately."""


class UnknownNameError(AgymError, KeyError):
    """A name that does not exist, such as that of an environment, robot, joint, site or task."""

    def __init__(self, kind: str, name: Any, options: Iterable[str], advice: str = ""):
        self.kind, self.name = kind, name
        super().__init__(f"Unknown {kind} {name!r}. {did_you_mean(name, options)} {advice}".strip())

    def __str__(self) -> str:
        return str(self.args[0])


class MissingAssetError(AgymError, FileNotFoundError):
    """A packaged file that is missing."""


class MissingExtraError(AgymError, ImportError):
    """A required optional Python package is not installed."""


class MeshError(AgymError, RuntimeError):
    """A robot's meshes do not exist, cannot be read, or do not fit the robot."""


class ArgumentError(AgymError, ValueError):
    """An argument of the wrong type, or out of range."""


def checked_count(name: str, value: Any, at_least: int = 1, advice: str = "") -> int:
    """Check that an argument is a whole number and return it.

    Args:
        name: name of the argument.
        value: value of the argument.
        at_least: smallest valid value.
        advice: what to do instead, for the error message.

    Raises:
        ArgumentError: if it is not a whole number, or is too small.
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
    """A Brax wrapper around an environment it cannot wrap, or one that requires something the environment lacks."""


class SpecError(AgymError, ValueError):
    """An inconsistent description of a robot, tool, seat or task."""


class DamagedFileError(AgymError, ValueError):
    """A file whose content does not match its checksum, or that does not belong to this project."""


class SaveFolderError(AgymError, OSError):
    """A folder to which results cannot be written."""


class MissingPlacementError(AgymError, FileNotFoundError):
    """A pair of task and robot without a bank of start poses."""


class MissingPostureError(AgymError, FileNotFoundError):
    """A bed task whose bank of lying postures is missing or damaged."""


class MissingFillError(AgymError, FileNotFoundError):
    """A vessel whose bank of settled particles is missing or damaged."""


class PolicyNotFoundError(AgymError, FileNotFoundError):
    """A requested policy file does not exist."""


class PolicyDamagedError(DamagedFileError):
    """A policy file that cannot be read."""


class PolicyEnvironmentError(AgymError, ValueError):
    """A policy that was trained in a different environment."""


class PolicyLayoutError(AgymError, ValueError):
    """A policy that expects a different observation layout or different sizes."""
