"""How the person's joints are driven: muscles under a torque bound, tremor, the active person.

Assistive Gym's position motor asks for the velocity ``rate * (target - angle)`` with a torque of at
most ``max_torque * strength`` (reference humans.md section 7). A muscle is that motor, solved with the contacts as
the robot's are (``sim.motors``): a limb that is held stands still until it is pushed harder than the bound, and then gives way.

DEVIATION(girdle-support): a seated person's girdle bears the weight of the arm passively, as ligaments
do, whatever the strength. In AG's ScratchItch it is held by muscles of at most 1 N m: a man of full strength sinks
0.13 rad in it within 2 s, the wrist by 4 cm, until the arm lies on the armrest; a woman of full strength holds hers, a
weak one sinks 1.7 cm. With the mass where it belongs every arm would. ``Population(masses="ag")`` has no such support. It is
the torque of gravity alone (``sim.girdle``).
DEVIATION(tissue-damping): every joint of the person has 0.05 N m s/rad, from a model of the human arm (Li and Todorov 2004); AG has
none, but Bullet's drag. OpenSim's arm has twice as much at shoulder, elbow and forearm (Saul et al., Comput. Methods Biomech. Biomed.
Eng. 18, 2015, table 2: 0.001745 N m s/deg; a quarter of that for wrist deviation). Half and twice the value move the wrist of a limp arm that falls
by 2.0 and 3.0 cm (man) and 1.2 and 1.8 cm (woman) until it meets the bed, and by 1.7 to 3.7 cm where it comes to rest; none moves it by 3.6
and 2.6 cm until it meets the bed (medians of twelve drops, our masses). ``Population(masses="ag")`` has none either.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from agym_jax.spec import HumanSpec

TISSUE_DAMPING = 0.05
"""What even the weakest joint has [N m s/rad]. Shoulder and elbow of the arm model of Li and Todorov (ICINCO 2004; Li, PhD
thesis, UC San Diego 2006) have the joint friction matrix [[0.05, 0.025], [0.025, 0.05]]: read in two programs that implement it,
jeremiedecock/pyarm (model/arm/abstract_arm_model.py) and raklokesh/ILQR_TwoLinkArm_Reaching (Initialisation.m), not in the paper.
The coupling of the two joints, 0.025, is left out. See DEVIATION(tissue-damping) for another model's value."""
DRAG = 0.04
"""Of Bullet on every link: a link slows down at the rate ``DRAG * (1 + speed)`` [1/s]. AG v0.1 keeps the default."""
LIMIT_MARGIN = 1e-3
"""Before a joint limit, within which it already acts [rad]: one that stands at its limit is held there."""

FROZEN_DAMPING = 1e4
"""Of a person who does not move at all [N m s/rad]: a push of 10 N moves nothing by 1 mm in an episode."""


def is_moving(tremor: jax.Array, active: bool) -> jax.Array:
    """Whether the person drives the joints at the move rate: active, or trembling ()."""
    return jnp.logical_or(active, jnp.any(tremor != 0.0))


def damping(spec: HumanSpec, moving: jax.Array, at_joints: Any = 0.0) -> jax.Array:
    """Damping of every controllable joint [N m s/rad] ().

    Args:
        spec: what a person does who does not move.
        moving: from ``is_moving`` ().
        at_joints: 1 for a person with AG's masses, whose tissue does not damp ().
    """
    still = 0.0 if spec.passive_mode in ("hold", "limp") else FROZEN_DAMPING
    return (1.0 - at_joints) * TISSUE_DAMPING + jnp.where(moving, 0.0, still)


class Muscles(NamedTuple):
    """How one person pulls; constant throughout an episode."""

    rate: Any  # of the velocity asked for, per angle that is missing [1/s]   ()
    bound: Any  # of the torque [N m]                                         ()
    damping: Any  # of the joints [N m s/rad]                                 ()
    passive: Any  # 1 where ligaments bear the load                           (n,)
    limited: Any  # 1 if the limits of an arm depend on its pose              ()


def as_bullet(q: Any, v: Any, limits: Any, time_step: float, xp: Any = jnp) -> tuple[Any, Any]:
    """Joints of a person with AG's masses after a physics step: slowed by the drag, and stopped at limits.

    A joint limit of Bullet's acts only from the step on that begins at it or beyond it
    (btMultiBodyJointLimitConstraint), so that a joint swings through; AG env.py
    (``enforce_hard_human_joint_limits``) then puts it back with no velocity, and no other joint feels it. One that stands
    at its limit is held there by MuJoCo's limit. The drag is Bullet's of each link, taken joint by joint.

    Args:
        q: angles [rad] (n,).
        v: velocities [rad/s] (n,).
        limits: lower and upper [rad] (n, 2).
        time_step: of the physics [s].
        xp: numpy or jax.numpy.

    Returns:
        angles and velocities (n,).
    """
    within = xp.clip(q, limits[:, 0], limits[:, 1])
    v = xp.where(within != q, 0.0, v)
    return within, v * (1.0 - time_step * DRAG * (1.0 + abs(v)))


def muscles_of(
    spec: HumanSpec,
    strength: jax.Array,
    moving: jax.Array,
    at_joints: Any = 0.0,
    active: bool = False,
) -> Muscles:
    """A person's muscles, and what besides acts on the joints like them.

    Args:
        spec: rates and torque bound.
        strength: of the person ().
        moving: from ``is_moving`` ().
        at_joints: 1 for a person with AG's masses, whose girdle is borne by muscles alone, and whose arms have limits that depend on
            their pose only if the person is active ().
        active: whether the person is.
    """
    holds = 1.0 if spec.passive_mode == "hold" else 0.0
    seated = not spec.postures  # in bed the mattress bears the arm
    return Muscles(
        rate=jnp.where(moving, spec.move_rate, holds * spec.hold_rate),
        bound=spec.max_torque * strength * jnp.where(moving, 1.0, holds),
        damping=damping(spec, moving, at_joints),
        passive=(1.0 - at_joints)
        * np.array([seated and "clavicle" in name for name in spec.joints], np.float32),
        limited=jnp.ones_like(strength) if active else 1.0 - at_joints * jnp.ones_like(strength),
    )
