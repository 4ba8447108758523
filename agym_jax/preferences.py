"""The human-preference terms that all tasks share.

Assistive Gym v0.1 ``env.py`` human_preferences (reference humans.md section 9): people prefer slow hand motion, no
contact where no help is needed, and only light contact where it is.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp

from agym_jax.spec import Preferences

PREFERENCE_TERMS = (
    "preference_velocity", "preference_force_nontarget", "preference_high_forces",
)  # fmt: skip
"""Names of the terms of ``preference_terms``."""
MEAL_TERMS = ("preference_food_hit", "preference_food_velocities")
"""Names of the terms of ``meal_terms``."""
DRESSING_TERMS = ("preference_velocity", "preference_dressing_force")
"""Names of the terms of ``dressing_terms``."""


def preference_terms(
    weights: Preferences,
    tool_speed: jax.Array,
    force_on_human: jax.Array,
    force_at_target: jax.Array,
) -> dict[str, jax.Array]:
    """Compute the weighted preference terms, each at most 0.

    Args:
        weights: weights of the terms.
        tool_speed: speed of the tool or end effector [m/s] ().
        force_on_human: total force of tool and robot on the person [N] ().
        force_at_target: force of the tool where help is needed [N] ().
    """
    high = jnp.where(force_at_target < 10.0, 0.0, force_at_target)
    return {
        "preference_velocity": -weights.velocity * tool_speed,
        "preference_force_nontarget": -weights.force_nontarget * (force_on_human - force_at_target),
        "preference_high_forces": -weights.high_forces * high,
    }


def meal_terms(weights: Preferences, hits: jax.Array, speed: jax.Array) -> dict[str, jax.Array]:
    """Compute the weighted preference terms of the meal tasks, each at most 0.

    Args:
        weights: weights of the terms.
        hits: number of particles that hit the person for the first time in this step ().
        speed: summed speed of the particles that entered the mouth in this step [m/s] ().
    """
    return {
        "preference_food_hit": -weights.food_hit * hits,
        "preference_food_velocities": -weights.food_velocities * speed,
    }


def dressing_terms(
    weights: Preferences, hand_speed: jax.Array, cloth_force: jax.Array
) -> dict[str, jax.Array]:
    """Compute the weighted preference terms of dressing, each at most 0. AG dressing.py passes no other force.

    Args:
        weights: weights of the terms.
        hand_speed: speed of the end effector [m/s] ().
        cloth_force: sum of the forces of the garment's contacts with the person [N] ().
    """
    return {
        "preference_velocity": -weights.velocity * hand_speed,
        "preference_dressing_force": -weights.dressing_force * cloth_force,
    }
