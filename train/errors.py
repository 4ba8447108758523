"""Errors of training, checkpoints and policies: what was asked, what fits, what to do next."""

from __future__ import annotations

from agym_jax.errors import AgymError


class ConfigError(AgymError, ValueError):
    """Training settings that do not fit together."""


class SaveFolderError(AgymError, OSError):
    """A folder that results cannot be written to."""


class ActiveHumanError(AgymError, ValueError):
    """Single-agent training of an environment in which the person acts too."""


class DivergedError(AgymError, ArithmeticError):
    """Training produced NaN or infinite losses."""


class DamagedFileError(AgymError, ValueError):
    """A file whose content does not match its checksum, or that is not ours."""


class CheckpointMismatchError(AgymError, ValueError):
    """A checkpoint of another environment, observation layout or network."""


class CheckpointWarning(UserWarning):
    """A checkpoint was skipped because it is damaged."""


class PolicyNotFoundError(AgymError, FileNotFoundError):
    """No policy file where one was asked for."""


class PolicyDamagedError(DamagedFileError):
    """A policy file that cannot be read."""


class PolicyEnvironmentError(AgymError, ValueError):
    """A policy that was trained in another environment."""


class PolicyLayoutError(AgymError, ValueError):
    """A policy that reads another observation layout or has other sizes."""
