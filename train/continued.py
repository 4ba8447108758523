"""Settings of trainings that start from a policy, which can do the task already."""

from __future__ import annotations

from typing import Any

NOISE_BOUNDS = ("noise_floor", "noise_ceiling", "noise_ceiling_from")
"""Settings that are 0 by default if training starts from a policy."""
WARM_UP = 0.05
"""Fraction of a run that starts from a policy in which only the value functions learn."""


def value_warm_up(config: Any) -> float:
    """Return the fraction of the run in which only the value functions learn, also where the settings leave it open."""
    if config.value_warm_up is not None:
        return config.value_warm_up
    goes_on = any(
        getattr(config, f"{agent}_policy", None) and not getattr(config, f"freeze_{agent}", False)
        for agent in ("robot", "human")
    )
    return WARM_UP if goes_on else 0.0
