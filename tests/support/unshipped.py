"""Environments without a policy: hardly an id lacks one, so tests hide those that ship."""

from __future__ import annotations

from typing import Any

import pytest

from agym_jax import list_envs
from agym_jax.data.assets import asset_path
from agym_jax.policy import files
from agym_jax.policy.policy import shipped


def hide_policies(monkeypatch: pytest.MonkeyPatch, *names: str) -> None:
    """Until the test ends, no policy ships for these ids."""

    def path(name: str) -> Any:
        hidden = name.removeprefix("policies/").removesuffix(".npz") in names
        return asset_path("policies/none.npz" if hidden else name)

    monkeypatch.setattr(files, "asset_path", path)
    monkeypatch.setattr(files, "shipped", lambda: [x for x in shipped() if x not in names])


def unshipped_pair() -> str:
    """An id for which no policy ships, and whose person acts."""
    return next(name for name in list_envs() if name not in shipped() and name.endswith("Human-v0"))
