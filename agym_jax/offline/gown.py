"""Builds the hospital gown from a few measures: a sleeve that widens to the shoulder, up to where it is held.

``agym-jax gown`` writes ``assets/garments/gown.npz``. The gown at rest, in the frame of ``garment.py``, is a surface
of revolution about y. Its narrow end, -y, is the cuff, the loop that the sleeve test watches; towards its wide end it has
at every distance from the cuff the girth of AG's gown (lines of equal distance on AG's mesh). The gripper holds the top
of the wide end, as AG's holds the edge of the gown at the neck: there AG's gown is cut open, and the hand enters
between its front and its back. The undeformed shape is free of stress.

Facts of Assistive Gym: reference tasks.md section 6.

DEVIATION(part-of-a-gown): the gown ends where it is held, 0.33 m from the cuff: 0.26 m^2 of AG's 1.10 m^2, at AG's
0.209 kg/m^2: 0.05 kg of 0.23 kg. The rest, which hangs from the gripper to both sides or lies on the lap, is left out.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import jax.numpy as jnp
import numpy as np

from agym_jax.data.assets import asset_root
from agym_jax.matter.cloth.garment import GOWN, Garment, save
from agym_jax.matter.cloth.hang import settle
from agym_jax.matter.cloth.topology import GOWN_FABRIC
from agym_jax.matter.shapes import Capsules

GIRTHS = ((0.0, 0.386), (0.07, 0.407), (0.11, 0.490), (0.15, 0.637), (0.33, 1.415))
"""Of AG's gown: distance from the cuff along the cloth, length of the line at that distance [m]."""

HANDS, HANDS_RADIUS = ((0.0, 0.08, -0.22), (0.0, 0.5, -0.22)), 0.08
"""Thicker than a hand and the forearm behind it, in the garment's frame [m]: the gown hangs around it."""

SAME_LENGTH = 1e-9
"""Diagonals that differ by less [m] are equally long."""


@dataclass(frozen=True)
class GownMeasures:
    """Measures of the gown [m]; AG's where a source is given, else estimates.

    Attributes:
        edge: length of most edges, which sets the resolution.
        cuff: perimeter of the cuff (AG: the same).
        length: from the cuff to where the gown is held, along the cloth (AG: 0.32 to 0.36).
        patch: width that is held (AG: the patch of anchors).
        patch_depth: length of the held patch (AG: the same).
    """

    edge: float = 0.0241
    cuff: float = 0.386
    length: float = 0.33
    patch: float = 0.075
    patch_depth: float = 0.018


def build_gown(measures: GownMeasures = GownMeasures()) -> Garment:
    """The gown, not yet settled.

    Args:
        measures: of the gown.
    """
    m = measures
    height = m.edge * np.sqrt(3.0) / 2.0  # of a triangle
    rows = round(m.length / height)
    along, forward, girth = _profile(m)
    rings, vertices, top = [], [], []
    for distance in np.linspace(0.0, m.length, rows + 1):
        around = np.interp(distance, along, girth)
        count = 2 * round(around / m.edge / 2)
        column = np.arange(count) - (count - 1) / 2  # from the top, symmetric; the ends meet below
        angle, radius = 2 * np.pi * column / count, around / (2 * np.pi)
        y = np.full(count, np.interp(distance, along, forward))
        rings.append(sum(map(len, rings)) + np.arange(count))
        vertices.append(np.stack([radius * np.sin(angle), y, radius * np.cos(angle)], -1))
        top.append(rings[-1][np.abs(column) * m.edge <= m.patch / 2])
    placed = np.concatenate(vertices)
    strips = [_strip(placed, a, b) for a, b in pairwise(rings)]
    deep = max(1, round(m.patch_depth / height))
    anchors = np.concatenate(top[-1 - deep :])
    return Garment(
        name="gown",
        vertices=placed - placed[anchors].mean(0),
        triangles=np.concatenate(strips),
        cuff=rings[0],
        anchors=anchors,
    )


def _profile(m: GownMeasures) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Distance from the cuff along the cloth, y, and girth [m], each (p,)."""
    along = np.linspace(0.0, m.length, 2001)
    girth = np.maximum(np.interp(along, *np.array(GIRTHS).T), m.cuff)
    wider = np.diff(girth / (2 * np.pi))
    steps = np.sqrt(np.maximum(np.diff(along) ** 2 - wider**2, 0.0))
    return along, np.concatenate([[0.0], np.cumsum(steps)]), girth


def _strip(vertices: np.ndarray, first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Triangles between two closed rings that begin beside each other, the shorter diagonal first (t, 3).

    Where both diagonals are equally long the second ring advances; rounding, which differs between processors, has no say.

    Args:
        vertices: [m] (n, 3).
        first: vertices of one ring, in order (a,).
        second: vertices of the other ring (b,).
    """
    a, b = np.append(first, first[0]), np.append(second, second[0])
    triangles, i, j = [], 0, 0
    while i < len(first) or j < len(second):
        ends = [np.inf, np.inf]
        if i < len(first):
            ends[0] = float(np.linalg.norm(vertices[a[i + 1]] - vertices[b[j]]))
        if j < len(second):
            ends[1] = float(np.linalg.norm(vertices[b[j + 1]] - vertices[a[i]]))
        if ends[0] < ends[1] - SAME_LENGTH:
            triangles.append((a[i], a[i + 1], b[j]))
            i += 1
        else:
            triangles.append((a[i], b[j + 1], b[j]))
            j += 1
    return np.array(triangles)


def main(argv: Sequence[str] | None = None, prog: str = "agym-jax gown") -> int:
    """The command line; returns the exit status."""
    description = "Build the gown of the package, let it settle, and write it to the assets."
    argparse.ArgumentParser(prog=prog, description=description).parse_args(argv)
    tip, elbow = (jnp.array([end]) for end in HANDS)
    hands = Capsules(tip, elbow, jnp.array([HANDS_RADIUS]))
    gown = settle(build_gown(), GOWN_FABRIC, hands)
    save(gown, asset_root() / GOWN)
    print(
        f"{len(gown.vertices)} vertices, {len(gown.triangles)} triangles, {gown.areas.sum():.3f} m^2, "
        f"{gown.mass:.3f} kg, cuff {gown.cuff_perimeter:.4f} m of {len(gown.cuff)}, {len(gown.anchors)} anchors"
    )
    return 0
