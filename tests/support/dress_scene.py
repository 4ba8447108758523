"""What Dressing senses of a man who holds his left arm sideways, without MJX."""

from __future__ import annotations

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
from meal_scene import FAR, arrays, sensed

from agym_jax.sense import Sensed
from agym_jax.tasks.dressing import ARM_LINKS, START

SHOULDER, ELBOW, WRIST = np.array([
    [0.179, 0.03, 1.0315], [0.4538, 0.03, 0.9831], [0.4538, -0.26, 0.9831]
])  # of a man, humans.md section 5  # fmt: skip


def towards(direction: np.ndarray) -> np.ndarray:
    """A rotation that takes -z to a direction (3, 3)."""
    z = -direction / np.linalg.norm(direction)
    x = np.cross([0.31, 0.5, 0.81], z)
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(z, x), z], -1)


def seen(path: np.ndarray | None = None, **tool: np.ndarray) -> Sensed:
    """The man holds his left arm sideways; the hand goes along a path (11, 3) or rests at the start."""
    path = np.tile(START, (11, 1)) if path is None else path
    s = sensed({"pos_w": path[-1]} | tool, path=path, limbs_at=FAR + 5.0)
    places = dict(zip(ARM_LINKS, (SHOULDER, ELBOW, WRIST), strict=True))
    turns = dict(
        zip(ARM_LINKS, map(towards, (ELBOW - SHOULDER, WRIST - ELBOW, WRIST - ELBOW)), strict=True)
    )
    still = lambda x: np.tile(x, (len(path), *[1] * np.ndim(x)))  # noqa: E731
    moved = replace(
        s.motion,
        link_pos_w=s.motion.link_pos_w | arrays({k: still(v) for k, v in places.items()}),
        link_rot_w=s.motion.link_rot_w | arrays({k: still(v) for k, v in turns.items()}),
    )
    return replace(
        s, motion=moved, link_pos_w=s.link_pos_w | arrays(places), link_rot_w=s.link_rot_w | arrays(turns),
        human_angles=jnp.arange(10.0),
    )  # fmt: skip
