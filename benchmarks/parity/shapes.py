"""Baxter's and Sawyer's forearm, wrist and gripper.

AG's links are cylinders, spheres and boxes; here capsules and spheres stand for them. For each of these links, in its own frame: how far a point of
AG's surface can be outside these shapes, and a point of theirs outside AG's. Fingers are closed, as in Feeding and Reaching, but where a row says
otherwise. Neighbouring links, which cover some of these points, are left out. AG's column is 0 by definition. PR2's forearm and hand are above; of
Jaco's, only the largest distances are known (`jaco-hand`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from agym_jax.data.assets import asset_path
from agym_jax.robots import ROBOTS
from benchmarks.parity.row import Row

LARGEST = 10.0  # [mm]
AROUND, ALONG = 48, 25  # samples around an axis, and along it


@dataclass(frozen=True)
class Shape:
    """A solid, in the frame of a link.

    Attributes:
        kind: "cylinder" or "capsule", along an axis; "sphere"; or "box", along the axes.
        size: radius and half length (of a capsule without its ends); radius; half lengths [m].
        pos: centre [m]    (3,).
        axis: unit vector of a cylinder or a capsule    (3,).
    """

    kind: str
    size: tuple[float, ...]
    pos: tuple[float, float, float] = (0.0, 0.0, 0.0)
    axis: tuple[float, float, float] = (0.0, 0.0, 1.0)

    def outside(self, points: np.ndarray) -> np.ndarray:
        """Distance of points from the solid, 0 inside (n, 3) -> (n,) [m]."""
        apart = points - np.array(self.pos)
        if self.kind == "box":
            return np.linalg.norm(np.maximum(abs(apart) - self.size, 0.0), axis=1)
        if self.kind == "sphere":
            return np.maximum(np.linalg.norm(apart, axis=1) - self.size[0], 0.0)
        along = apart @ np.array(self.axis)
        across = np.linalg.norm(apart - along[:, None] * self.axis, axis=1)
        beyond = np.maximum(abs(along) - self.size[1], 0.0)
        if self.kind == "capsule":
            return np.maximum(np.hypot(across, beyond) - self.size[0], 0.0)
        return np.hypot(np.maximum(across - self.size[0], 0.0), beyond)

    def surface(self) -> np.ndarray:
        """Points of the surface, its edges and corners among them (n, 3) [m]."""
        if self.kind == "box":
            grid = np.stack(np.meshgrid(*[np.linspace(-1, 1, 15)] * 3), -1).reshape(-1, 3)
            return grid[abs(grid).max(1) == 1] * self.size + self.pos
        turn, axis = np.linspace(0, 2 * np.pi, AROUND, endpoint=False), np.array(self.axis)
        if self.kind == "cylinder":  # radius and height of rings on its side, then on its faces
            radius, half = self.size
            rings = [(radius, h * half) for h in np.linspace(-1, 1, ALONG)]
            rings += [(r * radius, h) for r in np.linspace(0, 1, ALONG) for h in (-half, half)]
        else:  # a ball, of a capsule at several places: what is inside does not reach farther than what is outside
            half = self.size[1] if self.kind == "capsule" else 0.0
            tilts, places = np.linspace(0, np.pi, AROUND), np.linspace(-half, half, ALONG)
            rings = [(self.size[0] * np.sin(t), self.size[0] * np.cos(t) + z) for t in tilts for z in places]  # fmt: skip
        first, second = _across(axis)
        around = np.cos(turn)[:, None] * first + np.sin(turn)[:, None] * second
        rings = np.array(rings)[:, None]
        return (rings[..., :1] * around + rings[..., 1:] * axis).reshape(-1, 3) + self.pos


def _across(axis: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Two unit vectors across an axis (3,), (3,)."""
    first = np.cross(axis, np.eye(3)[np.argmin(abs(axis))])
    first /= np.linalg.norm(first)
    return first, np.cross(axis, first)


def gripper(opening: float = 0.0) -> tuple[Shape, ...]:
    """AG's gripper, of both robots: cylinder of the base, fingers and their tips, in the frame of the base.

    Args:
        opening: how far each finger is from where they are closed [m].
    """
    found = [Shape("cylinder", (0.029, 0.05), axis=(0.0, 1.0, 0.0))]
    for side in (1.0, -1.0):
        found += [
            Shape("box", (0.005, 0.00675, 0.05635), (0.0, side * (0.01575 + opening), 0.0815)),
            Shape("box", (0.005, 0.025, 0.0085), (-side * 0.005, side * (opening - 0.0045), 0.0283)),
            Shape("box", (0.021, 0.00325, 0.0185), (0.0, side * (0.01125 + opening), 0.1177)),
        ]  # fmt: skip
    return tuple(found)


AG = {
    "Baxter": {
        "right_upper_forearm": (
            Shape("cylinder", (0.06, 0.044), (0.0, 0.0, -0.044)),
            Shape("cylinder", (0.06, 0.136), (0.0, 0.0, 0.136)),
        ),
        "right_lower_forearm": (Shape("cylinder", (0.06, 0.05)),),
        "right_wrist": (Shape("cylinder", (0.06, 0.0825)),),
        "right_hand": (Shape("cylinder", (0.04, 0.0232), (0.0, 0.0, -0.0232)),),
        "right_gripper_base": gripper(),
    },
    "Sawyer": {
        "right_l4": (Shape("cylinder", (0.045, 0.18), (0.0, 0.0, 0.14)),),
        "right_l5": (Shape("sphere", (0.06,), (0.01, 0.0, 0.09)),),
        "right_l6": (Shape("cylinder", (0.065, 0.025), (0.0, 0.0, -0.005)),),
        "right_gripper_base": gripper(),
    },
}
"""Robot -> link -> AG's collision shapes (AG v0.1, its URDF files)."""


def ours(robot: str, link: str) -> tuple[Shape, ...]:
    """The collision shapes of a link here, in its frame."""
    model = mujoco.MjModel.from_xml_path(str(asset_path(ROBOTS[robot].model)))
    found = []
    for geom in (model.geom(g) for g in range(model.ngeom)):
        if model.body(geom.bodyid[0]).name != link or not geom.name.endswith("_collision"):
            continue
        rot = np.zeros(9)
        mujoco.mju_quat2Mat(rot, geom.quat)
        kind = mujoco.mjtGeom(int(geom.type[0])).name.removeprefix("mjGEOM_").lower()
        pos, axis = tuple(geom.pos), tuple(rot.reshape(3, 3)[:, 2])
        size = tuple(geom.size[: {"sphere": 1, "box": 3}.get(kind, 2)])
        found.append(Shape(kind, size, pos, axis))
    return tuple(found)


def farthest(of: Sequence[Shape], outside: Sequence[Shape]) -> float:
    """How far a surface point of the first solids is outside of the second ones, at most [mm]."""
    points = np.concatenate([shape.surface() for shape in of])
    apart = np.min([shape.outside(points) for shape in outside], axis=0)
    return round(1e3 * float(apart.max()), 6)


def rows() -> list[Row]:
    """Each link in both directions."""
    found = []
    for robot, links in AG.items():
        for link, shapes in links.items():
            here, name = ours(robot, link), f"{robot}, {link.removeprefix('right_')}"
            why = f"{robot.lower()}-shapes"
            missing, extra = farthest(shapes, here), farthest(here, shapes)
            found += [
                Row(f"{name}: AG's shapes outside these", "mm", 0.0, missing, LARGEST, why),
                Row(f"{name}: these outside AG's shapes", "mm", 0.0, extra, LARGEST, why),
            ]
        around = gripper(ROBOTS[robot].gripper_opening["cup"])
        missing = farthest(around, ours(robot, "right_gripper_base"))
        name = f"{robot}, gripper_base around a cup: AG's shapes outside these"
        found.append(Row(name, "mm", 0.0, missing, LARGEST, f"{robot.lower()}-shapes"))
    return found
