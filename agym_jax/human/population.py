"""The person of an episode: sex, size, impairment, strength, range of motion, tremor.

The distributions are those of Assistive Gym v0.1 ``world_creation.py`` (reference humans.md sections 1 and 6).
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp

from agym_jax.errors import ArgumentError, UnknownNameError
from agym_jax.human import anthropometry

IMPAIRMENTS = ("none", "limits", "weakness", "tremor")
MASSES = ("body", "ag", "both")
SIZES = ("ag", "continuous", "both")
LEAST = {"blend": -math.inf, "stature": 0.0, "girth": 0.0}
"""Exclusive lower bounds of the ranges of sizes."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Human:
    """The person of one episode. All leaves are float32 arrays, so a batch of them holds several people."""

    sex: jax.Array  # 0 male, 1 female                                         ()
    stature: jax.Array  # height_scale                                         ()
    girth: jax.Array  # radius_scale                                           ()
    strength: jax.Array  # multiplies the muscle torque bound, 0.25..1         ()
    limit_scale: jax.Array  # multiplies the joint limits, 0.5..1              ()
    tremor: jax.Array  # amplitude of each controllable joint [rad]            (n_joints,)
    at_joints: jax.Array | float = 0.0  # 1 if masses are AG's, at the joints        ()

    @property
    def impaired(self) -> dict[str, Any]:
        """Impairments of the person: name -> whether present (). A tremor requires a joint that moves."""
        return {
            "limits": self.limit_scale < 1,
            "weakness": self.strength < 1,
            "tremor": (abs(self.tremor) > 0).any(-1),
        }

    @property
    def dims(self) -> anthropometry.Dims:
        """Dimensions and mass of the body."""
        return anthropometry.dims(self.sex, self.stature, self.girth)


@dataclass(frozen=True)
class Population:
    """The population from which each episode draws its person.

    Attributes:
        sizes: "ag" draws Assistive Gym's 50th-percentile man or woman with equal probability;
            "continuous" interpolates between the two body tables and also scales stature and girth;
            "both" draws a person of either kind with equal probability.
        impairments: the impairments to draw from, uniformly: none, limits, weakness, tremor; None = the task's own.
        blend: range of sex (0 male, 1 female) of people whose size is continuous.
        stature: range of the height scale of people whose size is continuous.
        girth: range of the radius scale of people whose size is continuous.
        masses: "body" places the mass of each limb where the limb is. "ag" follows Assistive Gym, for comparisons
            and transfer: every centre of mass at its joint, the inertia of boxes, joints with no damping except Bullet's
            drag and with hard stops at their limits, and no support for a seated person's shoulder girdle.
            "both" draws a person of either kind with equal probability.
    """

    sizes: str = "ag"
    impairments: tuple[str, ...] | None = None
    blend: tuple[float, float] = (-0.2, 1.2)
    stature: tuple[float, float] = (0.92, 1.08)
    girth: tuple[float, float] = (0.9, 1.15)
    masses: str = "body"

    def __post_init__(self) -> None:
        """Reject populations from which nobody could be drawn.

        Raises:
            UnknownNameError: if a name does not exist.
            ArgumentError: if a range is empty or is ignored by ``sizes``, or there are no impairments.
        """
        if self.sizes not in SIZES:
            raise UnknownNameError("way to draw sizes", self.sizes, SIZES)
        if self.masses not in MASSES:
            raise UnknownNameError("distribution of masses", self.masses, MASSES)
        if self.impairments is not None:
            self._check_impairments(self.impairments)
        for field in dataclasses.fields(self):
            if field.name in LEAST:
                value = getattr(self, field.name)
                _check_range(field.name, value)
                if self.sizes == "ag" and value != field.default:
                    raise ArgumentError(
                        f'sizes="ag" has two sizes and ignores {field.name}={value}. Use '
                        f'sizes="continuous", or leave {field.name} out.'
                    )

    def _check_impairments(self, names: Any) -> None:
        if not isinstance(names, tuple) or not names:
            raise ArgumentError(
                f'impairments must be a tuple of names, such as ("none",) or ("none", "tremor"), or None for those '
                f"of the task; got {names!r}. There are: {', '.join(IMPAIRMENTS)}."
            )
        for name in names:
            if name not in IMPAIRMENTS:
                raise UnknownNameError("impairment", name, IMPAIRMENTS)


def checked_population(humans: Any, tremor_amplitude: float | None = None) -> Population:
    """Return the given population, or Assistive Gym's men and women if there is none.

    Args:
        humans: population.
        tremor_amplitude: of the task's people [rad], if it is known.

    Raises:
        ArgumentError: if it is not a ``Population``, or is to tremble where nobody does.
    """
    if humans is not None and not isinstance(humans, Population):
        raise ArgumentError(
            f"humans must be a Population, got {humans!r}. Write from agym_jax.human.population import Population, "
            f'and humans=Population(sizes="continuous") for people of every size.'
        )
    if humans and tremor_amplitude == 0.0 and "tremor" in (humans.impairments or ()):
        raise ArgumentError(
            'Nobody trembles in this task, as the arm is limp: impairments must not contain "tremor", '
            f"got {humans.impairments}. Leave it out, or use impairments=None for those of the task."
        )
    return humans or Population()


def _check_range(name: str, value: Any) -> None:
    """Raise unless a range is two finite numbers in ascending order."""
    least, numbers = LEAST[name], isinstance(value, tuple) and len(value) == 2
    numbers = numbers and all(
        isinstance(x, (int, float)) and not isinstance(x, bool) for x in value
    )
    if not numbers or not all(map(math.isfinite, value)) or not least < value[0] <= value[1]:
        raise ArgumentError(
            f"{name} must be a tuple of two finite numbers (low, high) with {least:g} < low <= high, got {value!r}."
        )


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
        n_joints: number of controllable joints, each with its own tremor amplitude.
        tremor_amplitude: largest tremor amplitude [rad].
        impairments: the task's impairments, used unless ``humans`` specifies its own.
    """
    keys = jax.random.split(key, 7)
    kinds = humans.impairments if humans.impairments is not None else impairments
    kind = jnp.array([IMPAIRMENTS.index(k) for k in kinds])[
        jax.random.randint(keys[0], (), 0, len(kinds))
    ]
    sex, stature, girth = _size(humans, *keys[1:4])
    limits = jax.random.uniform(keys[4], (), minval=0.5, maxval=1.0)
    strength = jax.random.uniform(keys[5], (), minval=0.25, maxval=1.0)
    at_joints = jnp.float32(humans.masses == "ag")
    if humans.masses == "both":  # a key of its own: everything else is drawn as without
        at_joints = jax.random.bernoulli(jax.random.fold_in(key, len(keys))).astype(jnp.float32)
    if humans.sizes == "both":  # so that either kind is drawn as if it were the only one
        average = jax.random.bernoulli(jax.random.fold_in(key, len(keys) + 1))
        ag = _size(Population(), *keys[1:4])
        sex, stature, girth = (
            jnp.where(average, a, b) for a, b in zip(ag, (sex, stature, girth), strict=True)
        )
    shake = jax.random.uniform(keys[6], (n_joints,), minval=-1.0, maxval=1.0)
    return Human(
        sex=sex,
        stature=stature,
        girth=girth,
        strength=jnp.where(kind == 2, strength, 1.0),
        limit_scale=jnp.where(kind == 1, limits, 1.0),
        tremor=jnp.where(kind == 3, shake * tremor_amplitude, 0.0),
        at_joints=at_joints,
    )


def _size(humans: Population, *keys: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Draw sex, stature and girth, () each: an average man or woman, or a person of continuous size."""
    if humans.sizes == "ag":
        return jax.random.bernoulli(keys[0]).astype(jnp.float32), jnp.float32(1.0), jnp.float32(1.0)
    ranges = (humans.blend, humans.stature, humans.girth)
    sex, stature, girth = (
        jax.random.uniform(key, (), minval=low, maxval=high)
        for key, (low, high) in zip(keys, ranges, strict=True)
    )
    return sex, stature, girth
