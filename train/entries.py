"""Entries of the form NAME=VALUE in flags."""

from __future__ import annotations

from collections.abc import Sequence

from .errors import ConfigError

AT_LEAST = "NAME=VALUE, such as held=0.9"
"""What ``--at-least`` takes."""


def entries(option: str, texts: Sequence[str], needed: str) -> dict[str, str]:
    """Read entries of the form NAME=VALUE.

    Args:
        option: that takes them, for the error message.
        texts: entries.
        needed: their form, with an example.

    Raises:
        ConfigError: if an entry is not of this form, or a NAME is given twice.
    """
    found = dict[str, str]()
    for text in texts:
        name, _, value = text.partition("=")
        if not (name and value):
            raise ConfigError(f"{option} takes {needed}; got {text!r}.")
        if name in found:
            raise ConfigError(f"{option} has {name} twice: {found[name]} and {value}.")
        found[name] = value
    return found


def numbers(option: str, texts: Sequence[str], needed: str) -> dict[str, float]:
    """Read entries as ``entries`` does, with values that are numbers.

    Raises:
        ConfigError: as for ``entries``; or if a value is not a number.
    """
    found = {}
    for name, value in entries(option, texts, needed).items():
        try:
            found[name] = float(value)
        except ValueError:
            raise ConfigError(f"{option} takes {needed}; got '{name}={value}'.") from None
    return found
