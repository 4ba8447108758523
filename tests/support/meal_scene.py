"""A person at a meal and a tool, by hand: ``Sensed`` without physics, for tests."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from agym_jax.human import anthropometry
from agym_jax.human.body import LINKS
from agym_jax.math3d import rotation_matrix
from agym_jax.matter.particles.solver import Contact, Particles
from agym_jax.sense import Motion, Sensed, ToolSensed

_MAN = anthropometry.dims(0.0)
HEAD, CHEST = np.array([0.0, 0.03, 1.1785]), np.array([0.0, 0.03, 0.89])  # humans.md section 5
TORSO = np.array([-1.0, 0.0, 1.0])
TURN = np.array([0.9, 0.1, -0.3, 0.3]) / np.linalg.norm([0.9, 0.1, -0.3, 0.3])  # of the head, wxyz
MOUTH = HEAD + rotation_matrix(TURN, np) @ [0.0, -0.11, 0.03]  # of a man, humans.md section 4
FAR = np.array([0.5, 0.6, 0.7])  # from where nothing of this is near [m]
AIR = {
    "pos_w": np.array([-0.1, -0.5, 1.1]), "quat_w": np.array([1.0, 0, 0, 0]), "vel_w": np.zeros(3),
    "gap": 0.3, "touch_force": np.zeros(2), "touch_pos_w": np.zeros((2, 3)),
    "touch_working": np.ones(2), "on_human": 0.0, "force": 0.0,
}  # fmt: skip
STRAIGHT = np.array([1.0, 0.0, 0.0, 0.0])
"""The head of a man who looks ahead, and where his mouth and the top of his skull are."""
MOUTH_AHEAD = np.add(HEAD, [0.0, -0.11, 0.03])
SKULL_TOP = np.add(HEAD, [0.0, float(_MAN.head_y), float(_MAN.head_high + _MAN.head_r)])
FLIGHT = np.array([0.0, -0.062, 0.05]), np.array([0.0, 0.5, 0.0])
"""From where, seen from that mouth [m], and how fast [m/s] something flies past the nose to 12 mm before the mouth in
0.1 s, and how fast it then is: it has fallen 49 mm."""
FLIGHT_SPEED = float(np.hypot(0.5, 0.981))
UPRIGHT = np.array([0.5**0.5, 0.5**0.5, 0.0, 0.0])
"""Turns a tool's y axis upwards."""


def arrays(tree: Any) -> Any:
    """Leaves as float32."""
    return jax.tree.map(lambda v: jnp.asarray(v, jnp.float32), tree)


def sensed(
    tool: dict[str, Any] | None = None, n_steps: int = 10, path: np.ndarray | None = None,
    pushes: float = 0.0, head: np.ndarray = HEAD, turn: np.ndarray = TURN, limbs_at: np.ndarray = FAR,
) -> Sensed:  # fmt: skip
    """A man who looks aside and does not move; every limb but head and chest is out of the way.

    Args:
        tool: changes of the tool in the air.
        n_steps: physics steps of the control step.
        path: tool positions at all moments (n_steps + 1, 3); at rest if not given.
        pushes: force of the robot on the person [N].
        head: its place.
        turn: its orientation, wxyz.
        limbs_at: where the other limbs are.
    """
    assert set(tool or {}) <= set(AIR)
    held = AIR | (tool or {})
    pos = {x.name: limbs_at for x in LINKS} | {"head": head, "chest": CHEST}
    quat = {x.name: np.array([1.0, 0, 0, 0]) for x in LINKS} | {"head": turn}
    rot = {k: rotation_matrix(q, np) for k, q in quat.items()}
    still = lambda x: np.tile(x, (n_steps + 1, *[1] * np.ndim(x)))  # noqa: E731
    path = still(held["pos_w"]) if path is None else path
    motion = {
        "tool_pos_w": path, "tool_quat_w": still(held["quat_w"]),
        "link_pos_w": {k: still(v) for k, v in pos.items()},
        "link_rot_w": {k: still(v) for k, v in rot.items()},
    }  # fmt: skip
    rest = {
        "arm_angles": np.arange(7.0), "torso_pos_w": TORSO, "human_angles": np.arange(4.0),
        "robot_on_human": pushes,
    }  # fmt: skip
    return Sensed(
        tools=(ToolSensed(**arrays(held | {"pos_w": path[-1]})),),
        link_pos_w=arrays(pos),
        link_rot_w=arrays(rot),
        link_quat_w=arrays(quat),
        dims=arrays(anthropometry.dims(0.0)),
        motion=Motion(**arrays(motion)),
        **arrays(rest),
    )


def particles(places: Any, speeds: Any = 0.0, alive: Any = True) -> Particles:
    """Particles at places (n, 3), with speeds [m/s] (n,) along x."""
    pos = np.atleast_2d(np.asarray(places, float))
    vel = np.zeros_like(pos)
    vel[:, 0] = speeds
    mask = np.broadcast_to(np.asarray(alive), len(pos))
    return Particles(*arrays((pos, vel)), jnp.asarray(mask))


def touched(n: int, **groups: Any) -> Contact:
    """What n particles touched: masks by group (``human``, ``furniture``, ...), none if not named."""
    mask = lambda x: jnp.broadcast_to(jnp.asarray(x, bool), (n,))  # noqa: E731
    names = ("vessel", "human", "furniture", "floor")
    return Contact(*(mask(groups.get(x, False)) for x in names), lost=jnp.int32(0))
