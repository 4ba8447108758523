"""Thin-walled vessels that hold particles: the cup and the bowl of the spoon.

A vessel is a mid-surface with a wall of constant thickness and a round rim. In its own frame z points out of the
opening. The cup is a surface of revolution about z; the spoon's bowl is one too, cut in half and extended
along y by a straight trough, which gives the oval outline of a spoon. Both are described by
their inside, in metres, and all distances are exact: no facets, no meshes.

The frames are Assistive Gym's mesh frames rotated by ``AG_TO_VESSEL``: AG's x is x, its y (up) is z, its
z (along the spoon's handle) is -y.

DEVIATION(vessel-shape): AG's convex pieces (reference furniture.md sections 6 and 7) become a cone with
a flat floor and a spherical dish with a trough; their inner faces differ by up to 2 mm. A spoon that is turned loses half
of its food within 11 degrees of AG's angle, but the last piece 18 to 31 degrees later; a cup half of its water within 7
degrees, and all of it within 15.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any

import jax.numpy as jnp

from agym_jax.math3d import TINY

Array = Any

AG_TO_VESSEL = (0.5**0.5, 0.5**0.5, 0.0, 0.0)
"""Rotation wxyz that takes coordinates in AG's mesh frame to the vessel's frame."""


@dataclass(frozen=True)
class Vessel(ABC):
    """Base class of cup and bowl. Points are given by coordinates in the vessel's frame [m].

    A new vessel implements the abstract members, which define its mid-surface.

    Attributes:
        thickness: of the wall [m].
    """

    thickness: float

    @property
    def trough(self) -> float:
        """Half length of the straight part along y [m]; 0 for a surface of revolution."""
        return 0.0

    @property
    @abstractmethod
    def brim(self) -> tuple[float, float]:
        """Radius and height of the rim of the mid-surface [m]."""

    @property
    @abstractmethod
    def depth(self) -> float:
        """Height of the rim's inner edge above the lowest point of the inside [m]."""

    @property
    @abstractmethod
    def volume(self) -> float:
        """Of the inside, up to the rim [m^3]."""

    @property
    @abstractmethod
    def mouth_area(self) -> float:
        """Of the opening [m^2]."""

    @abstractmethod
    def nearest(self, radius: Array, height: Array) -> tuple[Array, Array]:
        """Radius and height of the nearest point of the mid-surface [m] (...)."""

    @abstractmethod
    def reach(self, height: Array) -> Array:
        """Radius of the mid-surface at a height [m]; negative below its lowest point (...)."""

    def polar(self, x: Array, y: Array) -> tuple[Array, Array, Array]:
        """Radius and its unit direction (x, y) from the axis, or from the trough's middle line (...)."""
        along = y - jnp.clip(y, -self.trough, self.trough)
        radius = jnp.sqrt(jnp.maximum(x * x + along * along, TINY))
        return radius, x / radius, along / radius

    def wall(self, x: Array, y: Array, z: Array) -> tuple[Array, tuple[Array, Array, Array]]:
        """Distance from the mid-surface [m], and the unit vector away from it.

        The distance from the material is this less half the thickness.

        Args:
            x: coordinate [m] (...).
            y: coordinate [m] (...).
            z: coordinate [m] (...).
        """
        radius, ux, uy = self.polar(x, y)
        near_radius, near_z = self.nearest(radius, z)
        out, up = radius - near_radius, z - near_z
        dist = jnp.sqrt(jnp.maximum(out * out + up * up, TINY))
        return dist, (ux * out / dist, uy * out / dist, up / dist)

    def holds(self, x: Array, y: Array, z: Array) -> Array:
        """Whether points are inside: within the mid-surface and below its rim (...)."""
        radius, _, _ = self.polar(x, y)
        return (z < self.brim[1]) & (radius < self.reach(z))

    def passes(self, start: tuple[Array, ...], end: tuple[Array, ...]) -> Array:
        """Whether straight paths cross the plane of the opening within the opening.

        Args:
            start: coordinates of the paths' starts [m], each (...).
            end: coordinates of their ends [m], each (...).
        """
        radius, height = self.brim
        rise = end[2] - start[2]
        share = (height - start[2]) / jnp.where(jnp.abs(rise) < TINY, TINY, rise)
        x, y = (a + share * (b - a) for a, b in zip(start[:2], end[:2], strict=True))
        return (share >= 0) & (share <= 1) & (self.polar(x, y)[0] < radius)


@dataclass(frozen=True)
class Cup(Vessel):
    """A flat floor and a conical wall. Origin: centre of the bottom.

    Attributes:
        floor: height of the inner floor [m].
        floor_radius: of the inside at the floor [m].
        rim_radius: of the inside at the rim [m].
        rim_height: top of the rim [m].
    """

    floor: float
    floor_radius: float
    rim_radius: float
    rim_height: float

    @property
    def _slope(self) -> float:
        return (self.rim_radius - self.floor_radius) / (self.rim_height - self.floor)

    @property
    def _base(self) -> tuple[float, float]:
        """Where the mid-surfaces of floor and wall meet: radius and height [m]."""
        half = self.thickness / 2
        outwards = half * math.hypot(1.0, self._slope)
        return self.floor_radius + outwards - half * self._slope, self.floor - half

    @property
    def brim(self) -> tuple[float, float]:
        """Radius and height of the rim of the mid-surface [m]."""
        radius, z = self._base
        top = self.rim_height - self.thickness / 2
        return radius + self._slope * (top - z), top

    @property
    def depth(self) -> float:
        """From the inner floor up to the rim [m]."""
        return self.rim_height - self.floor

    @property
    def volume(self) -> float:
        """Of the inside, up to the rim [m^3]."""
        a, b = self.floor_radius, self.rim_radius
        return math.pi * self.depth * (a * a + a * b + b * b) / 3

    @property
    def mouth_area(self) -> float:
        """Of the opening [m^2]."""
        return math.pi * self.rim_radius**2

    def nearest(self, radius: Array, height: Array) -> tuple[Array, Array]:
        """Radius and height of the nearest point of the mid-surface [m] (...)."""
        (r0, z0), (r1, z1) = self._base, self.brim
        dr, dz = r1 - r0, z1 - z0
        share = ((radius - r0) * dr + (height - z0) * dz) / (dr * dr + dz * dz)
        share = jnp.clip(share, 0.0, 1.0)
        wall_r, wall_z = r0 + share * dr, z0 + share * dz
        floor_r = jnp.minimum(radius, r0)
        to_wall = (radius - wall_r) ** 2 + (height - wall_z) ** 2
        to_floor = (radius - floor_r) ** 2 + (height - z0) ** 2
        on_wall = to_wall < to_floor
        return jnp.where(on_wall, wall_r, floor_r), jnp.where(on_wall, wall_z, z0)

    def reach(self, height: Array) -> Array:
        """Radius of the mid-surface at a height [m]; negative below its lowest point (...)."""
        radius, z = self._base
        return jnp.where(height > z, radius + self._slope * (height - z), -1.0)


@dataclass(frozen=True)
class Bowl(Vessel):
    """A spherical dish, extended along y. Origin: lowest point of the inside, in the middle.

    Attributes:
        half_width: of the inside at the rim's inner edge, along x [m].
        half_length: the same along y [m].
        rim_depth: the rim's inner edge above the origin [m].
    """

    half_width: float
    half_length: float
    rim_depth: float

    @property
    def trough(self) -> float:
        """Half length of the straight part along y [m]."""
        return self.half_length - self.half_width

    @property
    def curvature(self) -> float:
        """Radius of the inner face, and height of its centre above the origin [m]."""
        return (self.half_width**2 + self.rim_depth**2) / (2 * self.rim_depth)

    @property
    def brim(self) -> tuple[float, float]:
        """Radius and height of the rim of the mid-surface [m]."""
        inner, half = self.curvature, self.thickness / 2
        grown = (inner + half) / inner
        return self.half_width * grown, inner - (inner - self.rim_depth) * grown

    @property
    def rim_height(self) -> float:
        """Top of the rim [m]."""
        return self.brim[1] + self.thickness / 2

    @property
    def depth(self) -> float:
        """From the origin up to the rim's inner edge [m]."""
        return self.rim_depth

    @property
    def volume(self) -> float:
        """Of the inside, up to the rim [m^3]."""
        r, d, w = self.curvature, self.rim_depth, self.half_width
        cap = math.pi * d * d * (3 * r - d) / 3
        half_angle = math.asin(w / r)
        section = r * r * half_angle - w * (r - d)
        return cap + 2 * self.trough * section

    @property
    def mouth_area(self) -> float:
        """Of the opening [m^2]."""
        return math.pi * self.half_width**2 + 4 * self.trough * self.half_width

    def nearest(self, radius: Array, height: Array) -> tuple[Array, Array]:
        """Radius and height of the nearest point of the mid-surface [m] (...)."""
        middle, mid = self.curvature, self.curvature + self.thickness / 2
        end_r, end_z = self.brim
        below = middle - height
        length = jnp.sqrt(jnp.maximum(radius * radius + below * below, TINY))
        # within the arc's angle: on the inner side of the ray from its centre to its end
        on_arc = radius * (middle - end_z) < below * end_r
        scale = mid / length
        return (
            jnp.where(on_arc, radius * scale, end_r),
            jnp.where(on_arc, middle - below * scale, end_z),
        )

    def reach(self, height: Array) -> Array:
        """Radius of the mid-surface at a height [m]; negative below its lowest point (...)."""
        mid = self.curvature + self.thickness / 2
        square = mid * mid - (height - self.curvature) ** 2
        return jnp.where(square > 0, jnp.sqrt(jnp.maximum(square, TINY)), -1.0)


CUP = Cup(floor=0.0074, floor_radius=0.0298, rim_radius=0.0412, rim_height=0.125, thickness=0.006)
"""Assistive Gym's coffee cup (reference furniture.md section 6). Its origin is AG's: the mesh origin.

Inner radius 0.0310 at z = 0.02, 0.0349 at 0.06, 0.0388 at 0.10 (AG's hulls 0.0311, 0.0360, 0.0406);
outer radius at the rim 0.047 (AG 0.0477). Underside of the floor at z = 0.0014."""

SPOON = Bowl(half_width=0.017, half_length=0.024, rim_depth=0.0105, thickness=0.003)
"""Bowl of Assistive Gym's spoon (reference furniture.md section 7): radius of curvature 0.019, depth
0.0105 (AG's inner surface: about 0.020, and 0.008 at the sides to 0.0117 at the tip). Top of the rim at
z = 0.0113, underside at -0.003, outer half axes 0.0198 x 0.0268 (AG's 0.018 x 0.025)."""

SPOON_ORIGIN_IN_AG = (0.0, 0.0053, -0.004)
"""Origin of ``SPOON`` in AG's mesh frame [m]. AG's spoon position is its mesh origin: in the vessel's frame
(0, -0.004, -0.0053)."""
