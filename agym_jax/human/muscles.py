"""How the person's joints are driven: muscles under a torque bound, tremor, the active person.

Assistive Gym's position motor asks for the velocity ``rate * (target - angle)`` with a torque of at
most ``max_torque * strength`` (reference humans.md section 7). Here the muscle's torque, the one that
bears the limb's weight included, is clipped to the same bound, and the damping of that velocity
servo is the joint's own, which MuJoCo integrates implicitly.

DEVIATION(girdle-support): a seated person's girdle bears the weight of the arm passively, as ligaments
do, whatever the strength. In AG's ScratchItch it is held by muscles of at most 1 N m: a man of full strength sinks
0.13 rad in it within 2 s, the wrist by 4 cm, until the arm lies on the armrest; a woman of full strength holds hers, a
weak one sinks 1.7 cm. With the mass where it belongs every arm would. ``Population(masses="ag")`` has no such support: weak
people sink as in AG, a man of full strength by 6 mm in the same time, as muscles damp here.
DEVIATION(muscle-damping): a limb pushed by the robot yields like a damper instead of standing still
up to the torque bound and moving freely beyond it.
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

HOLD_STIFFNESS = 5.0
"""Of a still person of full strength [N m/rad]: the 1 N m bound is reached 0.2 rad off the pose."""
MOVE_DAMPING = 1.6
"""Of a moving person of full strength [N m s/rad]: a full action (0.25 rad at 2.5 /s) against a
blocked joint takes the 1 N m bound."""
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


def damping(
    spec: HumanSpec, strength: jax.Array, moving: jax.Array, at_joints: Any = 0.0
) -> jax.Array:
    """Damping of every controllable joint [N m s/rad] ().

    Args:
        spec: rates and torque bound.
        strength: of the person ().
        moving: from ``is_moving`` ().
        at_joints: 1 for a person with AG's masses, whose tissue does not damp ().
    """
    move = MOVE_DAMPING * spec.max_torque * strength
    still = {
        "hold": HOLD_STIFFNESS / spec.hold_rate * spec.max_torque * strength,
        "limp": 0.0,
    }.get(spec.passive_mode, FROZEN_DAMPING)
    return (1.0 - at_joints) * TISSUE_DAMPING + jnp.where(moving, move, still)


class Muscles(NamedTuple):
    """How one person pulls; constant throughout an episode."""

    gain: Any  # [N m/rad]                                                    ()
    bound: Any  # of the torque [N m]                                         ()
    passive: Any  # 1 where ligaments bear the load                           (n,)

    def torque(self, target: Any, angle: Any, load: Any, xp: Any = jnp) -> Any:
        """Torque without its damping [N m] (n,).

        Args:
            target: angles to reach [rad] (n,).
            angle: measured angles [rad] (n,).
            load: gravity and inertial torque that the joints bear (qfrc_bias) [N m] (n,).
            xp: numpy or jax.numpy.
        """
        passive = self.passive * load
        wanted = load - passive + self.gain * (target - angle)
        return passive + xp.minimum(xp.maximum(wanted, -self.bound), self.bound)


def as_bullet(
    q: Any, v: Any, inertia: Any, limits: Any, time_step: float, xp: Any = jnp
) -> tuple[Any, Any]:
    """Joints of a person with AG's masses after a physics step: slowed by the drag, and stopped at limits.

    Bullet's constraint lets a joint get as far as its limit in a physics step and no farther, with an impulse that the
    other joints feel; AG env.py (``enforce_hard_human_joint_limits``) puts back what is beyond it nevertheless. A step
    of MuJoCo that has led beyond limits is corrected to that. The drag is Bullet's of each link, taken joint by joint.

    Args:
        q: angles [rad] (n,).
        v: velocities, with which ``q`` was integrated [rad/s] (n,).
        inertia: of the joints [kg m2] (n, n).
        limits: lower and upper [rad] (n, 2).
        time_step: of the physics [s].
        xp: numpy or jax.numpy.

    Returns:
        angles and velocities (n,).
    """
    low, high = limits[:, 0], limits[:, 1]
    beyond = q - xp.clip(q, low, high)
    stopped = xp.where(beyond != 0.0, 1.0, 0.0)
    mobility = xp.linalg.inv(inertia)
    among = mobility * stopped[:, None] * stopped + xp.diag(1.0 - stopped)
    change = -mobility @ (stopped * xp.linalg.solve(among, beyond / time_step))
    v = v + change
    slowed = v * (1.0 - time_step * DRAG * (1.0 + abs(v)))
    return xp.clip(q + time_step * change, low, high), slowed


def muscles_of(
    spec: HumanSpec, strength: jax.Array, moving: jax.Array, at_joints: Any = 0.0
) -> Muscles:
    """A person's muscles.

    Args:
        spec: rates and torque bound.
        strength: of the person ().
        moving: from ``is_moving`` ().
        at_joints: 1 for a person with AG's masses, whose girdle is borne by muscles alone ().
    """
    holds = 1.0 if spec.passive_mode == "hold" else 0.0
    rate = jnp.where(moving, spec.move_rate, holds * spec.hold_rate)
    seated = not spec.postures  # in bed the mattress bears the arm
    return Muscles(
        gain=damping(spec, strength, moving, at_joints) * rate,
        bound=spec.max_torque * strength * jnp.where(moving, 1.0, holds),
        passive=(1.0 - at_joints)
        * np.array([seated and "clavicle" in name for name in spec.joints], np.float32),
    )
