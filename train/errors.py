"""Errors of training: what was asked, what fits, what to do next."""

from __future__ import annotations

from agym_jax.errors import AgymError


class ConfigError(AgymError, ValueError):
    """Training settings that do not fit together."""


class ActiveHumanError(AgymError, ValueError):
    """Single-agent training of an environment in which the person acts too."""


class DivergedError(AgymError, ArithmeticError):
    """Training produced NaN or infinite losses."""


class CheckpointMismatchError(AgymError, ValueError):
    """A checkpoint of another environment, observation layout or network."""


class CheckpointWarning(UserWarning):
    """A checkpoint was skipped because it is damaged."""
