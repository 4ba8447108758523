"""The human-preference terms that every task shares.

Assistive Gym v0.1 ``env.py`` human_preferences (reference humans.md section 9): people like slow
hands, no touch where no help is needed, and no hard touch where it is.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp

from agym_jax.spec import Preferences

PREFERENCE_TERMS = (
    "preference_velocity", "preference_force_nontarget", "preference_high_forces",
)  # fmt: skip
"""Names of ``preference_terms``."""
MEAL_TERMS = ("preference_food_hit", "preference_food_velocities")
"""Names of ``meal_terms``."""
DRESSING_TERMS = ("preference_velocity", "preference_dressing_force")
"""Names of ``dressing_terms``."""


def preference_terms(
    weights: Preferences,
    tool_speed: jax.Array,
    force_on_human: jax.Array,
    force_at_target: jax.Array,
) -> dict[str, jax.Array]:
    """Weighted preference terms, each at most 0.

    Args:
        weights: of the terms.
        tool_speed: of the tool or end effector [m/s] ().
        force_on_human: of tool and robot together [N] ().
        force_at_target: of the tool where help is wanted [N] ().
    """
    high = jnp.where(force_at_target < 10.0, 0.0, force_at_target)
    return {
        "preference_velocity": -weights.velocity * tool_speed,
        "preference_force_nontarget": -weights.force_nontarget * (force_on_human - force_at_target),
        "preference_high_forces": -weights.high_forces * high,
    }


def meal_terms(weights: Preferences, hits: jax.Array, speed: jax.Array) -> dict[str, jax.Array]:
    """Weighted preference terms of meals, each at most 0.

    Args:
        weights: of the terms.
        hits: particles that newly hit the person in this step ().
        speed: sum over the particles that the mouth took in this step [m/s] ().
    """
    return {
        "preference_food_hit": -weights.food_hit * hits,
        "preference_food_velocities": -weights.food_velocities * speed,
    }


def dressing_terms(
    weights: Preferences, hand_speed: jax.Array, cloth_force: jax.Array
) -> dict[str, jax.Array]:
    """Weighted preference terms of dressing, each at most 0. AG dressing.py passes no other force.

    Args:
        weights: of the terms.
        hand_speed: of the end effector [m/s] ().
        cloth_force: sum over the garment's contacts with the person [N] ().
    """
    return {
        "preference_velocity": -weights.velocity * hand_speed,
        "preference_dressing_force": -weights.dressing_force * cloth_force,
    }
