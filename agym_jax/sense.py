"""The sensed data of one control step that a task receives: records in world coordinates, independent of the simulator.

``agym_jax.sim.sensing`` fills them from simulation data. Forces are normal forces of contact sensors, averaged over
the physics steps of a control step.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import jax
import jax.numpy as jnp
from jax import Array

from agym_jax.human.anthropometry import Dims


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class ToolSensed:
    """One tool (or the bare hand, in tasks without a tool), in world coordinates."""

    pos_w: Array  # tip of the tool [m]                                     (3,)
    quat_w: Array  # wxyz                                                   (4,)
    vel_w: Array  # linear velocity of the tip [m/s]                        (3,)
    gap: Array  # least distance of the tool to the person [m]              ()
    touch_force: Array  # normal force of each tool-person contact [N]      (n_touch,)
    touch_pos_w: Array  # where; the origin when there is none [m]          (n_touch, 3)
    touch_working: Array  # 1 where the tool's working part touches         (n_touch,)
    on_human: Array  # sum [N]                                              ()
    force: Array  # all contacts of the tool [N]                            ()


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class LinkMotion:
    """Poses of r links of the robot at every physics step of a control step."""

    robot: str = field(metadata={"static": True})  # its name
    names: tuple[str, ...] = field(metadata={"static": True})  # what is fixed to one is part of it
    pos_w: Array  # origin of the link's frame [m]                          (n + 1, r, 3)
    rot_w: Array  # rotation matrix                                         (n + 1, r, 3, 3)


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Motion:
    """Poses at every physics step of a control step: n + 1 poses for n steps."""

    tool_pos_w: Array  # tip of the first tool [m]                          (n + 1, 3)
    tool_quat_w: Array  # wxyz                                              (n + 1, 4)
    link_pos_w: dict[str, Array]  # link of the person -> its joint [m]     (n + 1, 3)
    link_rot_w: dict[str, Array]  # link -> rotation matrix                 (n + 1, 3, 3)
    robot: LinkMotion | None = None  # links of the arms in use; None if made by hand


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Sensed:
    """The sensed data of one control step, in world coordinates; everything that a task may use."""

    tools: tuple[ToolSensed, ...]  # one for each arm, in action order
    arm_angles: Array  # of the robot's arms [rad]                          (n_arm,)
    torso_pos_w: Array  # reference point of the robot [m]                  (3,)
    robot_on_human: Array  # links of the robot on the person [N]           ()
    human_angles: Array  # of the moving joints [rad]                       (n_human,)
    link_pos_w: dict[str, Array]  # link -> its (last) joint [m]            (3,)
    link_rot_w: dict[str, Array]  # link -> rotation matrix                 (3, 3)
    link_quat_w: dict[str, Array]  # link -> the same, wxyz                 (4,)
    dims: Dims  # sizes of the person
    motion: Motion  # during the control step
    regions: Any = None  # human.regions.RegionForces on the person; None if made by hand

    @property
    def tool(self) -> ToolSensed:
        """The first tool, which in most tasks is the only one."""
        return self.tools[0]

    @property
    def tool_on_human(self) -> Array:
        """Total normal force of all tools on the person [N] ()."""
        return jnp.sum(jnp.stack([t.on_human for t in self.tools]))

    @property
    def force_on_human(self) -> Array:
        """Total normal force of the robot and its tools on the person [N] ()."""
        return self.tool_on_human + self.robot_on_human

    @property
    def human_pos_w(self) -> Array:
        """Position of the chest [m] (3,)."""
        return self.link_pos_w["chest"]

    @property
    def mouth_pos_w(self) -> Array:
        """Position of the mouth, just in front of the lips [m] (3,). AG feeding.py: (0, -0.11 or -0.10, 0.03) in the head."""
        zero = jnp.zeros_like(self.dims.mouth_y)
        local = jnp.stack([zero, self.dims.mouth_y, self.dims.mouth_z])
        return self.link_pos_w["head"] + self.link_rot_w["head"] @ local


def quats_of(sensed: Sensed) -> Array:
    """Return the quaternions that a task may observe: those of the tools, then of the links, in order (n, 4)."""
    return jnp.stack([*(t.quat_w for t in sensed.tools), *sensed.link_quat_w.values()])


def with_quats(sensed: Sensed, quats: Array) -> Sensed:
    """Return the same data with different quaternions, in the order of ``quats_of`` (n, 4)."""
    tools = tuple(replace(t, quat_w=quats[i]) for i, t in enumerate(sensed.tools))
    links = dict(zip(sensed.link_quat_w, quats[len(tools) :], strict=True))
    return replace(sensed, tools=tools, link_quat_w=links)
