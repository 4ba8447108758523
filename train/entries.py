"""Entries of the form NAME=VALUE in flags."""

from __future__ import annotations

from collections.abc import Sequence

from .errors import ConfigError


def entries(option: str, texts: Sequence[str], needed: str) -> dict[str, str]:
    """Read entries of the form NAME=VALUE.

    Args:
        option: that takes them, for the error message.
        texts: entries.
        needed: their form, with an example.

    Raises:
        ConfigError: if an entry is not of this form.
    """
    found = {}
    for text in texts:
        name, _, value = text.partition("=")
        if not (name and value):
            raise ConfigError(f"{option} takes {needed}; got {text!r}.")
        found[name] = value
    return found
