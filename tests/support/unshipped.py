"""Environments without a policy: tests hide policies that ship, because in the end every id has one."""

from __future__ import annotations

from typing import Any

import pytest

from agym_jax.data.assets import asset_path
from agym_jax.policy import files
from agym_jax.policy.policy import shipped


def hide_policies(monkeypatch: pytest.MonkeyPatch, *names: str) -> None:
    """Until the test ends, no policy ships for these ids."""

    def path(name: str) -> Any:
        hidden = name.removeprefix("policies/").removesuffix(".npz") in names
        return asset_path("policies/none.npz" if hidden else name)

    monkeypatch.setattr(files, "asset_path", path)
    monkeypatch.setattr(
        files, "shipped", lambda memory=False: [x for x in shipped(memory) if x not in names]
    )
