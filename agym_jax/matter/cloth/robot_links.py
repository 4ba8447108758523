"""The robot's links as AG's cloth finds them: by distances at the points of a grid, linear in between (see ``cloth.grid``).

The distances from the robots' collision shapes were recorded in Assistive Gym, by the function with which its cloth computes them
(``btSparseSdf::DistanceToShape``), as were the frames of the shapes in their links. Only shapes that the gown came near in
recorded episodes of Dressing are among them. Where that function fails, as it does at the very middle of a cylinder, the cloth
finds nothing in the eight cells around that point, there as here.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import lru_cache

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from agym_jax.data.assets import asset_path
from agym_jax.data.npz import read_arrays
from agym_jax.errors import SpecError
from agym_jax.matter.cloth.garment import GarmentError
from agym_jax.matter.cloth.grid import MARGIN, SPACING
from agym_jax.matter.cloth.kernel import Rows
from agym_jax.matter.shapes import Xyz, add, scale

LINKS = "garments/robot_links.npz"


@dataclass(frozen=True)
class Layout:
    """Where the distances of a shape are among those of all."""

    first: tuple[int, ...]  # index of the first point along x, y and z, 0 at the origin
    points: tuple[int, ...]  # number of points along x, y and z
    offset: int  # of the first point's distance

    @property
    def strides(self) -> tuple[int, int, int]:
        """From a distance to the next along x, y and z."""
        return self.points[1] * self.points[2], self.points[2], 1


@dataclass(frozen=True, eq=False)
class LinkGrids:
    """The r shapes of a robot that the gown may meet."""

    rows: np.ndarray  # of their links                                      (r,)
    pos: np.ndarray  # origin of the grid in the link [m]                   (r, 3)
    rot: np.ndarray  # axes of the grid in the link, in its columns         (r, 3, 3)
    layouts: tuple[Layout, ...]
    distances: np.ndarray  # at the points of all grids [m]                 (m,)

    def frames(self, pos_w: Array, rot_w: Array) -> Array:
        """Where the grids are at n moments: origin and the axes x, y and z, world (n, r, 12).

        Args:
            pos_w: origins of the l links that ``link_grids`` was given, world [m] (n, l, 3).
            rot_w: rotation matrices (n, l, 3, 3).
        """
        rot_w = rot_w[:, self.rows]
        pos_w = pos_w[:, self.rows] + jnp.einsum("nrij,rj->nri", rot_w, self.pos)
        axes = jnp.einsum("nrij,rjk->nrki", rot_w, self.rot)
        return jnp.concatenate([pos_w, axes.reshape(*pos_w.shape[:2], 9)], -1)


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Links:
    """The robot's links during a physics step."""

    start: Array  # ``LinkGrids.frames`` as it begins                       (r, 12)
    end: Array  # and as it ends                                            (r, 12)
    on: Array  # 1 where the cloth meets them, 0 where it does not          ()
    grids: LinkGrids = field(metadata={"static": True})


def read_off(local: Xyz, distances: Rows, layout: Layout) -> tuple[Array, Xyz, Array]:
    """Return the distance from a shape, its slopes, and whether the grid has the point.

    Args:
        local: points in the frame of the grid [m], each (n,).
        distances: of all shapes [m]; a row.
        layout: of the shape.

    Returns:
        distance [m] (n,), its slopes along x, y and z, times SPACING [m], each (n,), and bool (n,).
    """
    at, known, shares = layout.offset, jnp.isfinite(local[0]), []
    for x, first, points, stride in zip(
        local, layout.first, layout.points, layout.strides, strict=True
    ):
        place = x / SPACING - first
        known = known & (place >= 0.0) & (place <= points - 1.0)
        cell = jnp.clip(jnp.floor(place), 0.0, points - 2.0)
        shares.append(place - cell)
        at = at + stride * cell.astype(jnp.int32)
    u, v, w = shares
    sx, sy, _ = layout.strides
    # along z, from the four points below to those above
    low = [distances[0, at + dx + dy] for dx in (0, sx) for dy in (0, sy)]
    rise = [
        distances[0, at + dx + dy + 1] - x
        for x, (dx, dy) in zip(low, [(dx, dy) for dx in (0, sx) for dy in (0, sy)], strict=True)
    ]
    a, b, c, d = (x + w * dz for x, dz in zip(low, rise, strict=True))
    slopes = (
        (c - a) + v * ((d - c) - (b - a)),
        (b - a) + u * ((d - c) - (b - a)),
        _bilinear(rise, u, v),
    )
    return _bilinear((a, b, c, d), u, v), slopes, known


def _bilinear(corners: tuple[Array, ...] | list[Array], u: Array, v: Array) -> Array:
    """Between the corners (0, 0), (0, 1), (1, 0) and (1, 1) of a square."""
    a, b, c, d = corners
    low, high = a + v * (b - a), c + v * (d - c)
    return low + u * (high - low)


def moved(turned: list[Xyz], origin: Xyz, local: Xyz) -> Xyz:
    """Displacement of points of a shape [m], each (n,), from those of its grid's axes and origin."""
    for axis, x in zip(turned, local, strict=True):
        origin = add(origin, scale(x, axis))
    return origin


@lru_cache
def link_grids(robot: str, links: tuple[str, ...]) -> LinkGrids:
    """Return the shapes of a robot that the gown may meet.

    Args:
        robot: its name.
        links: those whose poses are known, in this order.

    Raises:
        SpecError: nothing was recorded of this robot.
        GarmentError: if the file is damaged.
    """
    shapes = {"pos": ("shapes", 3), "rot": ("shapes", 3, 3), "distances": ("shapes", "points", "points", "points")}  # fmt: skip
    arrays = read_arrays(
        asset_path(LINKS), "recorded shapes of robots", shapes, GarmentError, "Restore the file from the package."
    )  # fmt: skip
    names = list(zip(arrays["robot"].tolist(), arrays["link"].tolist(), strict=True))
    own = [i for i, (of, link) in enumerate(names) if of == robot and link in links]
    if not own:
        raise SpecError(
            f"Dressing's gown can meet the arm of {', '.join(sorted({of for of, _ in names}))} "
            f"(meets_robot); nothing was recorded of {robot}."
        )
    middle, layouts, distances = arrays["distances"].shape[1] // 2, [], []
    for i in own:
        found = arrays["distances"][i].astype(np.float32)
        cells = np.argwhere(_reached(found))
        first, last = cells.min(0), cells.max(0) + 1
        part = found[tuple(slice(a, b + 1) for a, b in zip(first, last, strict=True))]
        offset = sum(x.size for x in distances)
        layouts.append(Layout(tuple((first - middle).tolist()), part.shape, offset))
        distances.append(part.ravel())
    return LinkGrids(
        rows=np.array([links.index(names[i][1]) for i in own], np.int32),
        pos=arrays["pos"][own].astype(np.float32),
        rot=arrays["rot"][own].astype(np.float32),
        layouts=tuple(layouts),
        distances=np.concatenate(distances),
    )


def _reached(distances: np.ndarray) -> np.ndarray:
    """In which cells of a grid the cloth may come within AG's margin (n - 1, n - 1, n - 1)."""
    n = len(distances) - 1
    corners = [distances[i : i + n, j : j + n, k : k + n] for i in (0, 1) for j in (0, 1) for k in (0, 1)]  # fmt: skip
    return np.min(corners, 0) < MARGIN
