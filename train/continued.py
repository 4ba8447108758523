"""Settings of trainings that start from a policy, which can do the task already."""

from __future__ import annotations

from typing import Any

from .errors import ConfigError

NOISE_BOUNDS = ("noise_floor", "noise_ceiling", "noise_ceiling_from")
"""Settings that are 0 by default if training starts from a policy."""
WARM_UP = 0.05
"""Fraction of a run that starts from a policy in which only the value functions learn."""


def value_warm_up(config: Any) -> float:
    """Return the fraction of the run in which only the value functions learn, where the settings leave it open.

    Raises:
        ConfigError: if ``target_kl`` is given, and training does not start from a policy.
    """
    starts = any(
        getattr(config, f"{agent}_policy", None) and not getattr(config, f"freeze_{agent}", False)
        for agent in ("robot", "human")
    )
    if config.target_kl and not starts:
        raise ConfigError(
            f"--target-kl {config.target_kl:g} is for policies that training starts from, which must not change too fast. Add "
            f"--robot-policy FILE, or leave it out."
        )
    if config.value_warm_up is not None:
        return config.value_warm_up
    return WARM_UP if starts else 0.0
