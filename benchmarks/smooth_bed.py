"""The shapes of our bed in Assistive Gym, in place of its mesh: the mattress without the mesh's gaps.

Assistive Gym's bed is a triangle mesh of 58 convex pieces that stand beside each other with gaps of millimetres, in whose walls a tool that
presses on the bed gets caught. ``benchmarks/in_assistive_gym.py --smooth-bed`` tells what this does to a policy.
"""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Any

import numpy as np

BED = Path(__file__).resolve().parents[1] / "assets" / "furniture" / "bed.xml"
MESH = "bed_single_reduced_vhacd.obj"
MOST = 16  # shapes of one body in Assistive Gym's engine; it drops further ones silently
LEFT_OUT = ("headboard", "frame")  # which nothing meets
PLACE = (-0.1, 0.0, 0.0)  # of the mesh's frame in the world [m]
TURN = (math.pi / 2, 0.0, 0.0)  # rpy [rad]


def shapes(path: Path = BED) -> list[dict[str, Any]]:
    """The collision geoms of the bed's file, without ``LEFT_OUT`` and outlines.

    Raises:
        ValueError: there are more than ``MOST``.

    Returns:
        for each ``box`` its ``size``, half the edges (3,), for each ``capsule`` its ``radius`` and ``length`` without the ends [m]; with
        ``pos`` [m] (3,) and ``rot``, a matrix (3, 3), in the world.
    """
    found = []
    for geom in ET.parse(path).getroot().iter("geom"):
        name = geom.get("name", "").removesuffix("_collision")
        if geom.get("class") != "collision" or not name or name in LEFT_OUT:
            continue
        if name.endswith("_outline"):  # of the pillow, whose boxes are there
            continue
        numbers = {k: np.array([float(x) for x in geom.get(k, "").split()]) for k in ("size", "pos", "xyaxes", "fromto")}  # fmt: skip
        if geom.get("type") == "capsule":
            begin, end = numbers["fromto"][:3], numbers["fromto"][3:]
            length = np.linalg.norm(end - begin)
            found.append({
                "kind": "capsule", "radius": float(numbers["size"][0]), "length": float(length),
                "pos": (begin + end) / 2, "rot": _frame_about((end - begin) / length),
            })  # fmt: skip
        else:
            axes = numbers["xyaxes"] if len(numbers["xyaxes"]) else np.eye(3)[:2].ravel()
            found.append({
                "kind": "box", "size": numbers["size"], "pos": numbers["pos"], "rot": _frame(axes[:3], axes[3:]),
            })  # fmt: skip
    if len(found) > MOST:
        raise ValueError(f"The bed has {len(found)} shapes; Assistive Gym's engine takes {MOST}.")
    return found


def _frame(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """The rotation matrix whose first axis is x, and whose second lies in the plane of both (3, 3)."""
    x = x / np.linalg.norm(x)
    y = y - x * (x @ y)
    y = y / np.linalg.norm(y)
    return np.stack([x, y, np.cross(x, y)], axis=1)


def _frame_about(z: np.ndarray) -> np.ndarray:
    """A rotation matrix whose third axis is the unit vector z (3, 3)."""
    y = np.cross(z, np.eye(3)[np.argmin(abs(z))])
    return _frame(np.cross(y, z), y)


def quaternion(rot: np.ndarray) -> np.ndarray:
    """Of a rotation matrix (3, 3), xyzw (4,)."""
    signs = np.array([[1, -1, -1], [-1, 1, -1], [-1, -1, 1], [1, 1, 1]])
    sizes = np.sqrt(np.maximum(0.0, 1.0 + signs @ np.diag(rot))) / 2
    turns = [rot[2, 1] - rot[1, 2], rot[0, 2] - rot[2, 0], rot[1, 0] - rot[0, 1], 1.0]
    return np.copysign(sizes, turns)


def install() -> None:
    """From now on, Assistive Gym's bed has these shapes; to be called before it makes an environment."""
    import pybullet

    make = pybullet.createCollisionShape
    to_mesh = pybullet.invertTransform(PLACE, pybullet.getQuaternionFromEuler(TURN))

    def create(*args: Any, **options: Any) -> int:
        if not str(options.get("fileName", "")).endswith(MESH):
            return make(*args, **options)
        geoms = shapes()
        places = [pybullet.multiplyTransforms(*to_mesh, g["pos"], quaternion(g["rot"])) for g in geoms]  # fmt: skip
        kinds = {"box": pybullet.GEOM_BOX, "capsule": pybullet.GEOM_CAPSULE}
        return pybullet.createCollisionShapeArray(
            shapeTypes=[kinds[g["kind"]] for g in geoms],
            halfExtents=[list(g.get("size", np.zeros(3))) for g in geoms],
            radii=[g.get("radius", 0.0) for g in geoms],
            lengths=[g.get("length", 0.0) for g in geoms],
            collisionFramePositions=[x[0] for x in places],
            collisionFrameOrientations=[x[1] for x in places],
            physicsClientId=options["physicsClientId"],
        )  # fmt: skip

    pybullet.createCollisionShape = create
