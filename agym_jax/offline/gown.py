"""Builds the hospital gown from a few measures: a sleeve, and under its opening a piece of the body.

``agym-jax gown`` writes ``assets/garments/gown.npz``. The gown at rest, in the frame of
``garment.py``: the sleeve is a tapering tube along -y. Its opening, where the hand enters, is the loop that the
sleeve test watches; its other end has the perimeter of AG's cuff, 0.386 m. The gripper holds the top of the opening
by a patch that is as wide as AG's, 75 mm. The body continues the underside of the opening along +y: the arc
there, and wings tangential to it. The undeformed shape is free of stress.

Facts of Assistive Gym: reference tasks.md section 6.

DEVIATION(part-of-a-gown): sleeve and body have 0.39 m^2 of AG's 1.10 m^2, at AG's 0.209 kg/m^2: 0.08 kg of
0.23 kg. The other sleeve and the rest of the body, which hang from the gripper or lie on the lap, are left out.
DEVIATION(held-at-the-opening): the gripper holds the gown where the arm enters, and the watched loop is that
opening, 0.52 m round as an armhole is: AG's 0.386 m does not pass a bent elbow of 43 mm radius without
stretching. AG's gripper holds the shoulder, and the loop, the sleeve's other end, hangs 0.33 m below it.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from agym_jax.data.assets import asset_root
from agym_jax.matter.cloth.garment import GOWN, Garment, save
from agym_jax.matter.cloth.hang import settle


@dataclass(frozen=True)
class GownMeasures:
    """Measures of the gown [m]; AG's where a source is given, else estimates.

    Attributes:
        edge: length of most edges, which sets the resolution; diagonals are longer by 1.4.
        opening: perimeter of the armhole.
        cuff: perimeter of the sleeve's other end (AG: the smaller cuff).
        sleeve: length of the tube: from the shoulder to the middle of the forearm of AG's man.
        patch: width that is held at the opening's top (AG: the patch of anchors).
        patch_depth: length of the held patch into the sleeve (AG: the same).
        body_width: width of the body, along the cloth.
        body_length: length of the body along +y.
        seam: share of the opening to which the body is joined.
    """

    edge: float = 0.0241
    opening: float = 0.52
    cuff: float = 0.386
    sleeve: float = 0.43
    patch: float = 0.075
    patch_depth: float = 0.018
    body_width: float = 0.40
    body_length: float = 0.40
    seam: float = 0.19


def build_gown(measures: GownMeasures = GownMeasures()) -> Garment:
    """The gown, not yet settled.

    Args:
        measures: of the gown.
    """
    m = measures
    around = 2 * round(m.opening / m.edge / 2)
    edge = m.opening / around
    radius = edge / (2 * np.sin(np.pi / around))
    rows = round(m.sleeve / edge)
    column = np.arange(around) - (around - 1) / 2  # from the top, symmetric; the ends meet below
    angle = 2 * np.pi * column / around
    ring = np.stack([radius * np.sin(angle), 0 * angle, radius * np.cos(angle)], -1)
    back = np.array([0.0, -edge, 0.0])
    down = np.arange(rows + 1)[:, None, None]
    width = 1.0 - (1.0 - m.cuff / m.opening) * down / rows
    top = np.array([0.0, 0.0, radius])  # straight: what the gripper holds is level
    sleeve = (top + width * (ring - top) + back * down).reshape(-1, 3)
    ids = np.arange(len(sleeve)).reshape(rows + 1, around)
    tube = _quads(np.concatenate([ids, ids[:, :1]], axis=1), np.arange(around) < around // 2)

    half = max(1, round(m.seam * around / 2))  # the seam: 2 * half columns about the lowest point
    seam = np.concatenate([ids[0, -half:], ids[0, :half]])
    profile = ring[seam]
    wing = max(1, round((m.body_width / edge - (2 * half - 1)) / 2))
    outwards = [_unit(profile[0] - profile[1]), _unit(profile[-1] - profile[-2])]
    steps = edge * np.arange(1, wing + 1)[:, None]
    profile = np.concatenate(
        [(profile[0] + steps * outwards[0])[::-1], profile, profile[-1] + steps * outwards[1]]
    )
    length = round(m.body_length / edge)
    body = (profile - back * np.arange(length + 1)[:, None, None]).reshape(-1, 3)
    in_body = np.arange(len(body)).reshape(length + 1, -1)
    shared = in_body[0, wing:-wing]
    fresh = np.setdiff1d(np.arange(len(body)), shared)
    number = np.empty(len(body), int)
    number[fresh] = len(sleeve) + np.arange(len(fresh))
    number[shared] = seam

    # where sleeve and body meet, diagonals avoid the vertices with most edges, which keeps six edges per vertex
    cell = np.arange(in_body.shape[1] - 1)
    mirrored = ((cell >= wing) & (cell < wing + half)) | (cell >= len(cell) - wing)

    held = np.flatnonzero(np.abs(column) * edge <= m.patch / 2)
    deep = max(1, round(m.patch_depth / edge))
    vertices = np.concatenate([sleeve, body[fresh]])
    anchors = ids[: deep + 1, held].ravel()
    return Garment(
        name="gown",
        vertices=vertices - vertices[anchors].mean(0),
        triangles=np.concatenate([tube, _quads(number[in_body], mirrored)]),
        cuff=ids[0],
        anchors=anchors,
    )


def _quads(grid: np.ndarray, mirrored: np.ndarray) -> np.ndarray:
    """Two triangles for every cell of a grid of vertices (r, c): (t, 3).

    Args:
        grid: vertices.
        mirrored: columns of cells whose diagonals are mirrored (c - 1,) bool.
    """
    a, b, c, d = grid[:-1, :-1], grid[:-1, 1:], grid[1:, :-1], grid[1:, 1:]
    first = np.stack([a, b, np.where(mirrored, c, d)], -1)
    second = np.stack([np.where(mirrored, b, a), d, c], -1)
    return np.concatenate([first.reshape(-1, 3), second.reshape(-1, 3)])


def _unit(a: np.ndarray) -> np.ndarray:
    return a / np.linalg.norm(a)


def main(argv: Sequence[str] | None = None, prog: str = "agym-jax gown") -> int:
    """The command line; returns the exit status."""
    description = "Build the gown of the package, let it settle, and write it to the assets."
    argparse.ArgumentParser(prog=prog, description=description).parse_args(argv)
    gown = settle(build_gown())
    save(gown, asset_root() / GOWN)
    print(
        f"{len(gown.vertices)} vertices, {len(gown.triangles)} triangles, {gown.areas.sum():.3f} m^2, "
        f"{gown.mass:.3f} kg, cuff {gown.cuff_perimeter:.4f} m of {len(gown.cuff)}, {len(gown.anchors)} anchors"
    )
    return 0
