"""Errors that say what was asked, what exists, the nearest match, and what to do next."""

from __future__ import annotations

import difflib
from collections.abc import Iterable


def did_you_mean(name: str, options: Iterable[str]) -> str:
    """A sentence with the nearest of ``options``, and all of them if they are few.

    Args:
        name: what was asked for.
        options: what exists.
    """
    known = sorted(set(options))
    if not known:
        return "There are none."
    folded = {option.lower(): option for option in known}
    near = difflib.get_close_matches(name.lower(), list(folded), n=1, cutoff=0.5)
    nearest = f"Did you mean {folded[near[0]]!r}? " if near else ""
    shown = ", ".join(known[:12]) + (f", ... ({len(known)} in all)" if len(known) > 12 else "")
    return f"{nearest}There are: {shown}."


class AgymError(Exception):
    """Base of every error that agym_jax raises on purpose."""


class UnknownNameError(AgymError, KeyError):
    """A name that does not exist: an environment, robot, joint, site or task."""

    def __init__(self, kind: str, name: str, options: Iterable[str], advice: str = ""):
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
