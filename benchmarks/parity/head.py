"""Head, mouth and limbs.

Rays on the collision shapes of both people, in the frames of head and limbs: along +y on the 10 cm around the mouth, towards
the head's z axis, and towards the axes of the right arm's limbs. Distances between the surfaces are those from the points of
one to the nearest of the other, in both directions; "around the mouth" is within 25 mm of the mouth's target, seen from
the front: what a spoon's bowl covers and more than the radius within which food counts as eaten.
"""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np

from agym_jax.human import anthropometry, body
from agym_jax.human.model import build
from benchmarks.parity.row import Row, traces

SEXES = ("male", "female")
LIMBS = {
    "upperarm": ("right_upper_arm", "upper arm"),
    "forearm": ("right_forearm", "forearm"),
    "hand": ("right_hand", "hand"),
}
AROUND = 0.025  # of the mouth's target, from the front [m]
FINE = 0.001  # spacing of the points to which distances are taken [m]
FAR = 0.3  # where rays begin [m]


class Person:
    """An average man or woman as MuJoCo has them, all joints at 0, to shoot rays at."""

    def __init__(self, sex: str):
        self.dims = d = anthropometry.dims(float(SEXES.index(sex)))
        links = tuple(x.name for x in body.LINKS)
        self._model = build(body.fields(d, {}, (), xp=np), (), d, links, False).compile()

    def first_hit(self, link: str, start: np.ndarray, along: np.ndarray) -> np.ndarray:
        """Distances (n,) to the link from points (n, 3) along unit vectors (n, 3), its frame; NaN: none [m]."""
        model, turn = self._model, np.zeros(9)
        found = np.full(len(start), np.inf)
        for name in body.shapes_of([link]):
            geom = model.geom(name)
            mujoco.mju_quat2Mat(turn, geom.quat)
            for i, (point, way) in enumerate(zip(start, along, strict=True)):
                away = mujoco.mju_rayGeom(geom.pos, turn, geom.size, point, way, geom.type[0])
                found[i] = min(found[i], away if away >= 0 else np.inf)
        return np.where(np.isfinite(found), found, np.nan)

    def front(self, x: np.ndarray, z: np.ndarray) -> np.ndarray:
        """Where rays along +y meet the head: y in its frame, NaN where none does [m] (z, x)."""
        grid_x, grid_z = np.meshgrid(x, z)
        start = np.stack([grid_x, np.full_like(grid_x, -FAR), grid_z], -1).reshape(-1, 3)
        along = np.broadcast_to((0.0, 1.0, 0.0), start.shape)
        return self.first_hit("head", start, along).reshape(grid_x.shape) - FAR

    def radius(self, link: str, s: np.ndarray, out: np.ndarray) -> np.ndarray:
        """Distance of the link's surface from its z axis [m] (s, directions).

        Args:
            link: name.
            s: along z [m].
            out: unit vectors away from the axis (directions, 3).
        """
        at = np.stack([0.0 * s, 0.0 * s, s], -1)[:, None] + 0.0 * out
        away = self.first_hit(
            link, (at + FAR * out).reshape(-1, 3), (0.0 * at - out).reshape(-1, 3)
        )
        return FAR - away.reshape(len(s), len(out))


def rows() -> list[Row]:
    """Both people's heads and right arms."""
    found = []
    for sex in SEXES:
        person = Person(sex)
        found += [*_head(sex, person), *_limbs(sex, person)]
    return [replace(row, ag=float(row.ag), ours=float(row.ours)) for row in found]


def _head(sex: str, person: Person) -> list[Row]:
    """The front of the head, the mouth in it, and the whole."""
    t = traces("head")
    x, z, mouth = t["mouth_x"], t["mouth_z"], t[f"{sex}_mouth"]
    theirs = t[f"{sex}_mouth_y"].astype(float)
    ours = person.front(x, z)
    apart = _apart(x, z, theirs, person)
    grid_x, grid_z = np.meshgrid(x, z)
    near = np.hypot(grid_x - mouth[0], grid_z - mouth[2]) < AROUND + 1e-4
    row, column = int(np.argmin(abs(z - mouth[2]))), int(np.argmin(abs(x - mouth[0])))
    target = (0.0, float(person.dims.mouth_y), float(person.dims.mouth_z))
    angles, heights = t["head_theta"], t["head_z"]
    out = np.stack([np.sin(angles), -np.cos(angles), 0.0 * angles], -1)
    whole = 1e3 * (person.radius("head", heights, out) - t[f"{sex}_head_radius"])
    inside = lambda y, at: 1e3 * (at - y)  # noqa: E731
    return [
        Row(f"{sex}: y of the mouth's target", "mm", 1e3 * mouth[1], 1e3 * target[1], 0.1),
        Row(f"{sex}: z of the mouth's target", "mm", 1e3 * mouth[2], 1e3 * target[2], 0.1),
        Row(f"{sex}: depth of the mouth's target behind the lips", "mm",
            inside(theirs[row, column], mouth[1]), inside(ours[row, column], target[1]), 3.0),
        Row(f"{sex}: largest distance of the surfaces around the mouth", "mm", 0.0,
            float(1e3 * np.nanmax(apart[near])), 3.0),
        Row(f"{sex}: mean distance of the surfaces around the mouth", "mm", 0.0,
            float(1e3 * np.nanmean(apart[near])), 3.0),
        Row(f"{sex}: y of the tip of the nose", "mm", 1e3 * np.nanmin(theirs), 1e3 * np.nanmin(ours), 3.0),
        Row(f"{sex}: mean distance of the surfaces, 10 cm around the mouth", "mm", 0.0,
            float(1e3 * np.nanmean(apart)), 3.0),
        Row(f"{sex}: largest distance of the surfaces, 10 cm around the mouth", "mm", 0.0,
            float(1e3 * np.nanmax(apart)), 3.0, "head-capsules"),
        Row(f"{sex}: mean difference of the head's distance from its axis", "mm", 0.0,
            float(np.nanmean(abs(whole))), 3.0, "head-capsules"),
    ]  # fmt: skip


def _limbs(sex: str, person: Person) -> list[Row]:
    """Thickness of upper arm, forearm and hand, and their outlines with the ends."""
    t, found = traces("head"), []
    s = t["limb_s"].astype(float)
    fine = np.arange(s[0], s[-1], FINE / 4)
    for key, (link, name) in LIMBS.items():
        theirs = t[f"{sex}_{key}_radius"].astype(float)
        ours = person.radius(link, -fine, np.eye(3)[:1])[:, 0]
        apart = _nearest(np.stack([s, theirs], -1), np.stack([fine, ours], -1))
        found += [
            Row(f"{sex}: radius of the {name}", "mm", 1e3 * np.nanmax(theirs), 1e3 * np.nanmax(ours), 1.0),
            Row(f"{sex}: largest distance of the surfaces of the {name}, with its ends", "mm", 0.0,
                1e3 * np.nanmax(apart), 3.0),
        ]  # fmt: skip
    return found


def _apart(x: np.ndarray, z: np.ndarray, theirs: np.ndarray, person: Person) -> np.ndarray:
    """Distances between the surfaces, the larger of both directions, at the points of a grid [m] (z, x).

    Args:
        x: of the grid [m].
        z: of the grid [m].
        theirs: y of AG's surface there, NaN where there is none [m] (z, x).
        person: ours.
    """
    fine = np.arange(x[0], x[-1] + FINE / 2, FINE), np.arange(z[0], z[-1] + FINE / 2, FINE)
    across = np.stack([np.interp(fine[0], x, line) for line in theirs])
    between = np.stack([np.interp(fine[1], z, line) for line in across.T], 1)
    # ours reaches beyond the grid: the nearest point may lie there
    wide = np.arange(x[0] - 0.03, x[-1] + 0.03, FINE), np.arange(z[0] - 0.03, z[-1] + 0.03, FINE)
    on_ours = _nearest(_points(x, z, theirs), _points(*wide, person.front(*wide)))
    on_theirs = _nearest(_points(x, z, person.front(x, z)), _points(*fine, between))
    exists = np.isfinite(theirs)
    return np.where(exists, np.fmax(on_ours, on_theirs).reshape(theirs.shape), np.nan)


def _points(x: np.ndarray, z: np.ndarray, y: np.ndarray) -> np.ndarray:
    """A surface over a grid as points (n, 3)."""
    grid_x, grid_z = np.meshgrid(x, z)
    return np.stack([grid_x, y, grid_z], -1).reshape(-1, 3)


def _nearest(points: np.ndarray, others: np.ndarray) -> np.ndarray:
    """Distance of each point (n, 3) to the nearest of others; NaN where a point is [m] (n,)."""
    others = others[np.isfinite(others).all(1)]
    return np.array([np.sqrt(((others - p) ** 2).sum(1).min()) for p in points])
