"""Named tasks or robots, each imported when it is first accessed."""

from __future__ import annotations

import importlib
from collections.abc import Iterator, Mapping, MutableMapping
from typing import Any, Generic, TypeVar

T = TypeVar("T")


class Catalogue(MutableMapping[str, T], Generic[T]):
    """A dictionary whose values are imported when they are first read; its names are known without importing them.

    Args:
        places: name -> ``"package.module:ATTRIBUTE"``.
    """

    def __init__(self, places: Mapping[str, str]):
        self._entries: dict[str, Any] = dict(places)

    def __getitem__(self, name: str) -> T:
        entry = self._entries[name]
        if isinstance(entry, str):
            module, _, attribute = entry.partition(":")
            entry = self._entries[name] = getattr(importlib.import_module(module), attribute)
        return entry

    def __setitem__(self, name: str, value: T) -> None:
        self._entries[name] = value

    def __delitem__(self, name: str) -> None:
        del self._entries[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._entries)

    def __len__(self) -> int:
        return len(self._entries)

    def __contains__(self, name: object) -> bool:
        return name in self._entries  # without importing it
