"""The robot's links as AG's cloth finds them: by distances at the points of a grid, linear in between (see ``cloth.grid``).

The distances from the robots' collision shapes were recorded in Assistive Gym, by the function with which its cloth computes them
(``btSparseSdf::DistanceToShape``; of a few shapes near the shoulder, which its cloth never asked for, by ``getClosestPoints``), as were the
frames of the shapes in the links. They are the shapes of all that the joints of the left arm move, but for PR2's upper arm roll
link, which is nowhere within the margin, and a point at its palm. What is fixed to a link, such as the hand with its fingers as they
hold the gown, belongs to that link. Trunk, head, base and the other arm have no shapes: the gown passes through them.
"""

from __future__ import annotations

from collections.abc import Sequence
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
from agym_jax.matter.shapes import Xyz

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
    """The s shapes of a robot that the gown may meet."""

    rows: np.ndarray  # of their links                                      (s,)
    pos: np.ndarray  # origin of the grid in the link [m]                   (s, 3)
    rot: np.ndarray  # axes of the grid in the link, in its columns         (s, 3, 3)
    layouts: tuple[Layout, ...]
    distances: np.ndarray  # at the points of all grids [m]                 (m,)

    def frames(self, pos_w: Array, rot_w: Array) -> Array:
        """Where the grids are at n moments: origin and the axes x, y and z, world (n, s, 12).

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

    start: Array  # ``LinkGrids.frames`` as it begins                       (s, 12)
    end: Array  # and as it ends                                            (s, 12)
    meets: Array  # 1 where the cloth meets them, 0 where it does not       ()
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
    at, known, shares = layout.offset, jnp.ones_like(local[0], bool), []
    for x, first, points, stride in zip(
        local, layout.first, layout.points, layout.strides, strict=True
    ):
        place = x / SPACING - first
        inside = (place >= 0.0) & (place <= points - 1.0)
        known = known & inside
        cell = jnp.where(inside, jnp.clip(jnp.floor(place), 0.0, points - 2.0), 0.0)
        shares.append(place - cell)
        at = at + stride * cell.astype(jnp.int32)
    u, v, w = shares
    sx, sy, sz = layout.strides
    below, above = (
        [distances[0, at + dx + dy + dz] for dx in (0, sx) for dy in (0, sy)] for dz in (0, sz)
    )
    rise = [high - low for low, high in zip(below, above, strict=True)]
    a, b, c, d = (x + w * dz for x, dz in zip(below, rise, strict=True))
    slopes = (
        (c - a) + v * ((d - c) - (b - a)),
        (b - a) + u * ((d - c) - (b - a)),
        _bilinear(rise, u, v),
    )
    return _bilinear((a, b, c, d), u, v), slopes, known


def _bilinear(corners: Sequence[Array], u: Array, v: Array) -> Array:
    """Between the corners (0, 0), (0, 1), (1, 0) and (1, 1) of a square."""
    a, b, c, d = corners
    low, high = a + v * (b - a), c + v * (d - c)
    return low + u * (high - low)


@lru_cache
def link_grids(robot: str, links: tuple[str, ...]) -> LinkGrids:
    """Return the shapes of a robot that the gown may meet.

    Args:
        robot: its name.
        links: those whose poses are known, in this order.

    Raises:
        SpecError: nothing was recorded of this robot, or only of links that are not among these.
        GarmentError: if the file is damaged.
        MissingAssetError: if there is no such file.
    """
    shapes = {"pos": ("shapes", 3), "rot": ("shapes", 3, 3), "distances": ("shapes", "points", "points", "points")}  # fmt: skip
    remedy = "Restore the file from the package."
    path, what = asset_path(LINKS), "file of robots' shapes"
    arrays = read_arrays(path, what, shapes, GarmentError, remedy)
    count = len(arrays["pos"])
    if not all(name in arrays and arrays[name].shape == (count,) for name in ("robot", "link")):
        raise GarmentError(f"The {what} {path} is damaged: it does not name the link of each shape. {remedy}")  # fmt: skip
    names = list(zip(arrays["robot"].tolist(), arrays["link"].tolist(), strict=True))
    recorded = [link for of, link in names if of == robot]
    if not recorded:
        raise SpecError(
            f"Dressing's gown can meet the arm of {', '.join(sorted({of for of, _ in names}))} "
            f"(meets_robot); nothing was recorded of {robot}."
        )
    own = [i for i, (of, link) in enumerate(names) if of == robot and link in links]
    if not own:
        raise SpecError(
            f"Dressing's gown (meets_robot) knows these links of {robot}: {', '.join(dict.fromkeys(recorded))}. "
            f"The arm in use moves none of them, but: {', '.join(links) or 'nothing'}."
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
