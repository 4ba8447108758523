"""Defaults of trainings that start from a policy, which can do the task already and must not be spoiled."""

from __future__ import annotations

from typing import Any

from .errors import ConfigError

NOISE_BOUNDS = ("noise_floor", "noise_ceiling", "noise_ceiling_from")
"""Settings that are 0 by default if training starts from a policy."""
DEFAULTS = {"value_warm_up": 0.05, "target_kl": 0.01}
"""Settings that are 0 by default if it does not."""


def starts_from_a_policy(config: Any) -> bool:
    """Return whether a policy that training starts from, the robot's or the person's, is trained further."""
    return any(
        getattr(config, f"{agent}_policy", None) and not getattr(config, f"freeze_{agent}", False)
        for agent in ("robot", "human")
    )


def settings_of_start(config: Any) -> dict[str, float]:
    """Return the values of ``DEFAULTS`` that the settings leave open.

    Raises:
        ConfigError: if ``target_kl`` is given, and training does not start from a policy.
    """
    starts = starts_from_a_policy(config)
    if config.target_kl and not starts:
        raise ConfigError(
            f"--target-kl {config.target_kl:g} is for policies that training starts from, which must not change too fast. Add "
            f"--robot-policy FILE, or leave it out."
        )
    unset = [name for name in DEFAULTS if getattr(config, name) is None]
    return {name: DEFAULTS[name] if starts else 0.0 for name in unset}
