"""Variation of the robot between episodes: friction, motor strength, latency, sensor noise and start poses. Off by default.

A ``RobotVariation`` specifies the ranges; each reset draws a ``RobotDraw``, which is part of the episode's state. Quantities
that do not vary are None there, so that they add no cost and change nothing.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from agym_jax import observe
from agym_jax.errors import ArgumentError

RANGE = {
    "friction": (0.0, math.inf), "strength": (0.0, math.inf), "latency": (0, 20),
    "position_noise": (0.0, math.inf), "angle_noise": (0.0, math.inf), "force_noise": (0.0, math.inf),
}  # fmt: skip
"""Smallest and largest values that a range may have; strength must exceed the smallest."""
NOISE = {
    "m": "position_noise", "rad": "angle_noise", "1 (wxyz)": "angle_noise", "N": "force_noise", "AG's": "force_noise",
}  # fmt: skip
"""Unit of an observation column -> the noise added to it. Columns of other units have no noise."""
QUATERNION = "1 (wxyz)"
BEYOND = 0x0B07
"""Folded into an episode's key to draw the robot, so that the other draws are unaffected."""


@dataclass(frozen=True)
class RobotVariation:
    """Ranges (low, high) from which each episode draws its robot uniformly, and the fraction ``rare_starts``. By default robots do not vary.

    Attributes:
        friction: factor on the friction of the tool and the robot with everything they touch [1].
        strength: factor on the maximum torque of the motors [1].
        latency: delay of the robot's actions [control steps].
        position_noise: standard deviation of the noise on positions that the robot observes [m].
        angle_noise: standard deviation of the noise on observed joint angles and orientations [rad].
        force_noise: standard deviation of the noise on observed forces [N; on the gown's force, in AG's unit].
        rare_starts: fraction of episodes in which rare start poses of the arm are as likely as common ones [1].
    """

    friction: tuple[float, float] = (1.0, 1.0)
    strength: tuple[float, float] = (1.0, 1.0)
    latency: tuple[int, int] = (0, 0)
    position_noise: tuple[float, float] = (0.0, 0.0)
    angle_noise: tuple[float, float] = (0.0, 0.0)
    force_noise: tuple[float, float] = (0.0, 0.0)
    rare_starts: float = 0.0

    def __post_init__(self) -> None:
        """Reject ranges from which nothing can be drawn.

        Raises:
            ArgumentError: if a range is not two numbers in ascending order, or exceeds the allowed limits, or ``rare_starts`` is
                not a fraction.
        """
        for name in RANGE:
            _check_range(name, getattr(self, name))
        share = self.rare_starts
        if isinstance(share, bool) or not isinstance(share, (int, float)) or not 0 <= share <= 1:
            raise ArgumentError(f"rare_starts must be a number from 0 to 1, got {share!r}.")

    def varies(self, *names: str) -> bool:
        """Return whether any of the named ranges differs from its default; without names, whether any range does."""
        fields = [x for x in dataclasses.fields(self) if not names or x.name in names]
        return any(getattr(self, x.name) != x.default for x in fields)


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class RobotDraw:
    """The robot of one episode; quantities that do not vary are None."""

    friction: Any = None  # factor                                                    ()
    strength: Any = None  # factor                                                    ()
    latency: Any = None  # [control steps], int32                                    ()
    noise: Any = None  # standard deviations: position [m], angle [rad], force [N]    (3,)
    key: Any = None  # of the noise, uint32                                           (2,)
    longest: int = dataclasses.field(default=0, metadata={"static": True})  # latency there may be


def checked_variation(robot: Any) -> RobotVariation | None:
    """Return the given variation, or None if robots do not vary.

    Raises:
        ArgumentError: if it is not a ``RobotVariation``.
    """
    if robot is None:
        return None
    if not isinstance(robot, RobotVariation):
        raise ArgumentError(
            f"robot must be a RobotVariation, got {robot!r}. Write robot=agym_jax.RobotVariation(friction=(0.8, 1.2)); "
            f"the id says which robot it is."
        )
    return robot if robot.varies() else None


def _check_range(name: str, value: Any) -> None:
    kind = int if name == "latency" else (int, float)
    least, most = RANGE[name]
    numbers = isinstance(value, tuple) and len(value) == 2
    numbers = numbers and all(isinstance(x, kind) and not isinstance(x, bool) for x in value)
    numbers = numbers and all(map(math.isfinite, value)) and (name != "strength" or value[0] > 0)
    if numbers and least <= value[0] <= value[1] <= most:
        return
    sort = "whole" if name == "latency" else "finite"
    above = "<" if name == "strength" else "<="
    below = "" if math.isinf(most) else f" <= {most}"
    raise ArgumentError(
        f"{name} must be a tuple of two {sort} numbers (low, high) with {least:g} {above} low <= high{below}, got {value!r}."
    )


def sample_robot(key: jax.Array, variation: RobotVariation | None) -> RobotDraw | None:
    """Draw the robot of an episode.

    Args:
        key: key of the episode, typed or raw; it is not consumed.
        variation: the ranges; None for robots that do not vary.
    """
    if variation is None:
        return None
    keys = jax.random.split(jax.random.fold_in(key, BEYOND), 5)

    def draw(i: int, name: str) -> Any:
        low, high = getattr(variation, name)
        return jax.random.uniform(keys[i], (), minval=low, maxval=high)

    found: dict[str, Any] = {
        name: draw(i, name)
        for i, name in enumerate(("friction", "strength"))
        if variation.varies(name)
    }
    if variation.varies("latency"):
        low, high = variation.latency
        found |= {"latency": jax.random.randint(keys[2], (), low, high + 1), "longest": high}
    kinds = tuple(dict.fromkeys(NOISE.values()))
    if variation.varies(*kinds):
        low, high = np.array([getattr(variation, x) for x in kinds], np.float32).T
        noise = low + (high - low) * jax.random.uniform(keys[3], (len(kinds),))
        found |= {"noise": noise, "key": jax.random.bits(keys[4], (2,), jnp.uint32)}
    return RobotDraw(**found)


def nothing_sent(robot: RobotDraw | None, n_arm: int, xp: Any = jnp) -> Any:
    """Return the delayed actions at the start of an episode, all zero (longest, n_arm); None without latency."""
    if robot is None or robot.latency is None:
        return None
    return xp.zeros((robot.longest, n_arm), np.float32)


def delayed(robot: RobotDraw | None, sent: Any, action: jax.Array) -> tuple[jax.Array, Any]:
    """Return the robot action that takes effect now, and the actions that are still delayed.

    Args:
        robot: robot of the episode.
        sent: the most recent actions, newest first (longest, n_arm); None without latency.
        action: action sent now (n_arm,).
    """
    if robot is None or sent is None:
        return action, sent
    line = jnp.concatenate([action[None], sent])
    return line[robot.latency], line[:-1]


def sensed_by(robot: RobotDraw | None, record: type, obs: jax.Array, step: Any) -> jax.Array:
    """Add sensor noise to the robot's observation.

    Args:
        robot: robot of the episode.
        record: record of the observation.
        obs: observation without noise (n_obs,).
        step: control steps taken; each step has different noise ().
    """
    if robot is None or robot.noise is None:
        return obs
    kinds = tuple(dict.fromkeys(NOISE.values()))
    share, turned = np.zeros((observe.size(record), len(kinds)), np.float32), []
    where = observe.layout(record)
    for name, column in observe.columns(record).items():
        if column.unit in NOISE:
            # a turn by a small angle changes a quaternion by half of it
            is_turn = column.unit == QUATERNION
            share[where[name], kinds.index(NOISE[column.unit])] = 0.5 if is_turn else 1.0
            turned += [where[name]] if is_turn else []
    key = jax.random.wrap_key_data(robot.key, impl="threefry2x32")
    noise = jax.random.normal(jax.random.fold_in(key, step), obs.shape)
    seen = obs + noise * (share @ robot.noise)
    for part in turned:
        seen = seen.at[part].divide(jnp.linalg.norm(seen[part]))
    return seen
