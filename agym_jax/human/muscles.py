"""How the person's joints are driven: muscles under a torque bound, tremor, the active person.

Assistive Gym's position motor asks for the velocity ``rate * (target - angle)`` with a torque of at
most ``max_torque * strength`` (reference humans.md section 7). Here the muscle's torque, the one that
bears the limb's weight included, is clipped to the same bound, and the damping of that velocity
servo is the joint's own, which MuJoCo integrates implicitly.

DEVIATION(girdle-support): a seated person's girdle bears the weight of the arm passively, as ligaments
do, whatever the strength. With AG's misplaced mass the girdle's load stays below the bound;
with the mass where it belongs every arm would sink 3 cm at the start of an episode.
DEVIATION(muscle-damping): a limb pushed by the robot yields like a damper instead of standing still
up to the torque bound and moving freely beyond it.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from agym_jax.spec import HumanSpec

HOLD_STIFFNESS = 5.0
"""Of a still person of full strength [N m/rad]: the 1 N m bound is reached 0.2 rad off the pose."""
MOVE_DAMPING = 1.6
"""Of a moving person of full strength [N m s/rad]: a full action (0.25 rad at 2.5 /s) against a
blocked joint takes the 1 N m bound."""
TISSUE_DAMPING = 0.4
"""What even the weakest joint has [N m s/rad]. An estimate."""


FROZEN_DAMPING = 1e4
"""Of a person who does not move at all [N m s/rad]: a push of 10 N moves nothing by 1 mm in an episode."""


def is_moving(tremor: jax.Array, active: bool) -> jax.Array:
    """Whether the person drives the joints at the move rate: active, or trembling ()."""
    return jnp.logical_or(active, jnp.any(tremor != 0.0))


def damping(spec: HumanSpec, strength: jax.Array, moving: jax.Array) -> jax.Array:
    """Damping of every controllable joint [N m s/rad] ()."""
    move = MOVE_DAMPING * spec.max_torque * strength
    still = {
        "hold": HOLD_STIFFNESS / spec.hold_rate * spec.max_torque * strength,
        "limp": 0.0,
    }.get(spec.passive_mode, FROZEN_DAMPING)
    return TISSUE_DAMPING + jnp.where(moving, move, still)


class Muscles(NamedTuple):
    """How one person pulls; constant throughout an episode."""

    gain: Any  # [N m/rad]                                                    ()
    bound: Any  # of the torque [N m]                                         ()
    passive: Any  # True where ligaments bear the load                        (n,)

    def torque(self, target: Any, angle: Any, load: Any, xp: Any = jnp) -> Any:
        """Torque without its damping [N m] (n,).

        Args:
            target: angles to reach [rad] (n,).
            angle: measured angles [rad] (n,).
            load: gravity and inertial torque that the joints bear (qfrc_bias) [N m] (n,).
            xp: numpy or jax.numpy.
        """
        passive = xp.where(self.passive, load, 0.0)
        wanted = load - passive + self.gain * (target - angle)
        return passive + xp.minimum(xp.maximum(wanted, -self.bound), self.bound)


def muscles_of(spec: HumanSpec, strength: jax.Array, moving: jax.Array) -> Muscles:
    """A person's muscles.

    Args:
        spec: rates and torque bound.
        strength: of the person ().
        moving: from ``is_moving`` ().
    """
    holds = 1.0 if spec.passive_mode == "hold" else 0.0
    rate = jnp.where(moving, spec.move_rate, holds * spec.hold_rate)
    seated = not spec.postures  # in bed the mattress bears the arm
    return Muscles(
        gain=damping(spec, strength, moving) * rate,
        bound=spec.max_torque * strength * jnp.where(moving, 1.0, holds),
        passive=np.array([seated and "clavicle" in name for name in spec.joints], bool),
    )
