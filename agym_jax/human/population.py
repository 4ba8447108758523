"""Who the person of an episode is: sex, size, impairment, strength, range of motion, tremor.

Distributions of Assistive Gym v0.1 ``world_creation.py`` (reference humans.md sections 1 and 6).
"""

from __future__ import annotations

from dataclasses import dataclass

import jax
import jax.numpy as jnp

from agym_jax.errors import UnknownNameError
from agym_jax.human import anthropometry

IMPAIRMENTS = ("none", "limits", "weakness", "tremor")
MASSES = ("body", "ag")


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Human:
    """The person of one episode. All leaves are float32, so a batch holds as many people."""

    sex: jax.Array  # 0 male, 1 female                                         ()
    stature: jax.Array  # height_scale                                         ()
    girth: jax.Array  # radius_scale                                           ()
    strength: jax.Array  # multiplies the muscle torque bound, 0.25..1         ()
    limit_scale: jax.Array  # multiplies the joint limits, 0.5..1              ()
    tremor: jax.Array  # amplitude of each controllable joint [rad]            (n_joints,)
    at_joints: jax.Array | float = 0.0  # 1 if masses are AG's, at the joints        ()

    @property
    def dims(self) -> anthropometry.Dims:
        """Sizes and mass of the body."""
        return anthropometry.dims(self.sex, self.stature, self.girth)


@dataclass(frozen=True)
class Population:
    """The population that episodes draw from.

    Attributes:
        sizes: ``"ag"`` draws Assistive Gym's 50th-percentile man or woman with equal chance;
            ``"continuous"`` blends the two tables and scales stature and girth as well.
        impairments: which of none, limits, weakness, tremor are drawn, uniformly; None = the task's.
        blend: range of ``sex`` when continuous (0 male, 1 female).
        stature: range of the height scale when continuous.
        girth: range of the radius scale when continuous.
        masses: ``"body"`` has the mass of a limb where the limb is; ``"ag"`` is as Assistive Gym: every centre of mass
            at its joint, the inertia of boxes, joints without damping but for Bullet's drag, which stop dead at
            their limits, and no support of a seated person's girdle. For comparisons and for transfer.
    """

    sizes: str = "ag"
    impairments: tuple[str, ...] | None = None
    blend: tuple[float, float] = (-0.2, 1.2)
    stature: tuple[float, float] = (0.92, 1.08)
    girth: tuple[float, float] = (0.9, 1.15)
    masses: str = "body"

    def __post_init__(self) -> None:
        if self.sizes not in ("ag", "continuous"):
            raise UnknownNameError("way to draw sizes", self.sizes, ("ag", "continuous"))
        if self.masses not in MASSES:
            raise UnknownNameError("distribution of masses", self.masses, MASSES)
        for name in self.impairments or ():
            if name not in IMPAIRMENTS:
                raise UnknownNameError("impairment", name, IMPAIRMENTS)


def sample_human(
    key: jax.Array,
    humans: Population,
    n_joints: int,
    tremor_amplitude: float,
    impairments: tuple[str, ...],
) -> Human:
    """Draw one person.

    Args:
        key: PRNG key.
        humans: the population.
        n_joints: controllable joints, each with a tremor amplitude of its own.
        tremor_amplitude: bound of the amplitudes [rad].
        impairments: the task's, used unless ``humans`` names its own.
    """
    keys = jax.random.split(key, 7)
    kinds = humans.impairments if humans.impairments is not None else impairments
    kind = jnp.array([IMPAIRMENTS.index(k) for k in kinds])[
        jax.random.randint(keys[0], (), 0, len(kinds))
    ]
    if humans.sizes == "ag":
        sex = jax.random.bernoulli(keys[1]).astype(jnp.float32)
        stature = girth = jnp.float32(1.0)
    else:
        sex = jax.random.uniform(keys[1], (), minval=humans.blend[0], maxval=humans.blend[1])
        low, high = humans.stature
        stature = jax.random.uniform(keys[2], (), minval=low, maxval=high)
        low, high = humans.girth
        girth = jax.random.uniform(keys[3], (), minval=low, maxval=high)
    limits = jax.random.uniform(keys[4], (), minval=0.5, maxval=1.0)
    strength = jax.random.uniform(keys[5], (), minval=0.25, maxval=1.0)
    shake = jax.random.uniform(keys[6], (n_joints,), minval=-1.0, maxval=1.0)
    return Human(
        sex=sex,
        stature=stature,
        girth=girth,
        strength=jnp.where(kind == 2, strength, 1.0),
        limit_scale=jnp.where(kind == 1, limits, 1.0),
        tremor=jnp.where(kind == 3, shake * tremor_amplitude, 0.0),
        at_joints=jnp.float32(humans.masses == "ag"),
    )
