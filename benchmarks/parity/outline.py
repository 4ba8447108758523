"""PR2's forearm and hand.

How far the convex hulls of AG's collision meshes reach from the link's origin along 1,167 directions, and how far the capsules here reach: what a
plane would meet first. The directions are all but those that point back towards the elbow (forearm) or the wrist (hand). The hand is palm and
fingers, opened by 0.2 rad as around the wiper. Values are differences between the two, in AG 0.
"""

from __future__ import annotations

import functools

import mujoco
import numpy as np

from agym_jax.data.assets import asset_path
from agym_jax.robots import ROBOTS
from benchmarks.parity.row import Row, traces

PARTS = {
    "forearm": ("forearm_link", "forearm_end"),
    "hand": ("gripper_palm_left", "gripper_palm_right", "gripper_fingers"),
}
"""Collision geoms, without the side's letter and the ending."""
CLOSE = 5.0  # root mean square [mm]
LARGEST = 10.0  # [mm]


@functools.cache
def apart(part: str, side: str = "l") -> np.ndarray:
    """How much farther AG's hulls reach than these capsules (n,) [mm].

    Args:
        part: "forearm" or "hand", whose frame is that of the first of its geoms' link.
        side: "l" or "r".
    """
    kept = traces("outline")
    model = mujoco.MjModel.from_xml_path(str(asset_path(ROBOTS["PR2"].model)))
    reach = []
    for name in PARTS[part]:
        geom = model.geom(f"{side}_{name}_collision")
        radius, half = geom.size[0], geom.size[1]
        rot = np.zeros(9)
        mujoco.mju_quat2Mat(rot, geom.quat)
        along = half * abs(kept["directions"] @ rot.reshape(3, 3)[:, 2])
        reach.append(kept["directions"] @ geom.pos + along + radius)
    return 1e3 * (kept[part] - np.max(reach, axis=0))


def rows() -> list[Row]:
    """Both parts."""
    found = []
    for part in PARTS:
        off = apart(part)
        mean = float(np.sqrt(np.mean(off**2)))
        found += [
            Row(f"{part}: difference of how far it reaches, root mean square", "mm", 0.0, mean, CLOSE),
            Row(f"{part}: farthest beyond AG's hull", "mm", 0.0, float(-off.min()), LARGEST, "pr2-forearm"),
            Row(f"{part}: farthest within AG's hull", "mm", 0.0, float(off.max()), LARGEST, "pr2-forearm"),
        ]  # fmt: skip
    return found
