"""Ids for which no policy ships."""

from __future__ import annotations

from agym_jax import list_envs
from agym_jax.policy.policy import shipped


def unshipped() -> str:
    """One whose person holds still."""
    return next(
        name for name in list_envs() if name not in shipped() and not name.endswith("Human-v0")
    )


def unshipped_pair() -> str:
    """One whose person acts."""
    return next(name for name in list_envs() if name not in shipped() and name.endswith("Human-v0"))
