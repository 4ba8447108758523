"""What one control step shows: the only reader of a simulator's data.

Works on one environment of ``mjx.Data`` and, because the field names are the same, of ``native.NativeData``
or C ``MjData``.
Forces are normal forces of contact sensors, averaged over the physics steps of a control step.

DEVIATION(force-mean): contact forces are means over the physics steps of a control step, not
the last one's value: a single step's is noisy.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from agym_jax.human.anthropometry import Dims
from agym_jax.math3d import capsule_gap
from agym_jax.sim.index import Index, ToolIndex


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class ToolContactSums:
    """Sums of one tool's contact sensors over physics steps."""

    force: Array  # normal force of each tool-person pair [N]               (n_touch,)
    moment: Array  # force times contact point [N m]                        (n_touch, 3)
    seat: Array  # [N]                                                      ()


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class ContactSums:
    """Sums of the contact sensors over physics steps."""

    tools: tuple[ToolContactSums, ...]
    robot_human: Array  # [N]                                              ()


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class ToolSensed:
    """One tool (the bare hand, in tasks without one), in world coordinates."""

    pos_w: Array  # tip of the tool [m]                                     (3,)
    quat_w: Array  # wxyz                                                   (4,)
    vel_w: Array  # linear velocity of the tip [m/s]                        (3,)
    gap: Array  # least distance of the tool to the person [m]              ()
    touch_force: Array  # normal force of each tool-person contact [N]      (n_touch,)
    touch_pos_w: Array  # where; the origin when there is none [m]          (n_touch, 3)
    touch_working: Array  # 1 where the tool's working part touches         (n_touch,)
    on_human: Array  # sum [N]                                             ()
    force: Array  # all contacts of the tool [N]                            ()


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Motion:
    """Poses at every physics step of a control step: n steps, n + 1 moments."""

    tool_pos_w: Array  # tip of the first tool [m]                          (n + 1, 3)
    tool_quat_w: Array  # wxyz                                              (n + 1, 4)
    link_pos_w: dict[str, Array]  # link of the person -> its joint [m]     (n + 1, 3)
    link_rot_w: dict[str, Array]  # link -> rotation matrix                 (n + 1, 3, 3)


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Sensed:
    """One control step, in world coordinates; everything a task may know."""

    tools: tuple[ToolSensed, ...]  # one for each arm, in action order
    arm_angles: Array  # of the robot's arms [rad]                          (n_arm,)
    torso_pos_w: Array  # reference point of the robot [m]                  (3,)
    robot_on_human: Array  # links of the robot on the person [N]          ()
    human_angles: Array  # of the moving joints [rad]                      (n_person,)
    link_pos_w: dict[str, Array]  # link -> its (last) joint [m]            (3,)
    link_rot_w: dict[str, Array]  # link -> rotation matrix                 (3, 3)
    link_quat_w: dict[str, Array]  # link -> the same, wxyz                 (4,)
    dims: Dims  # sizes of the person
    motion: Motion  # during the control step

    @property
    def tool(self) -> ToolSensed:
        """The first, and mostly only, tool."""
        return self.tools[0]

    @property
    def tool_on_human(self) -> Array:
        """Normal force of all tools on the person [N] ()."""
        return jnp.sum(jnp.stack([t.on_human for t in self.tools]))

    @property
    def force_on_human(self) -> Array:
        """Normal force of robot and tools on the person [N] ()."""
        return self.tool_on_human + self.robot_on_human

    @property
    def human_pos_w(self) -> Array:
        """The chest [m] (3,)."""
        return self.link_pos_w["chest"]

    @property
    def mouth_pos_w(self) -> Array:
        """Just before the lips [m] (3,). AG feeding.py: (0, -0.11 or -0.10, 0.03) in the head."""
        zero = jnp.zeros_like(self.dims.mouth_y)
        local = jnp.stack([zero, self.dims.mouth_y, self.dims.mouth_z])
        return self.link_pos_w["head"] + self.link_rot_w["head"] @ local


def no_contacts(index: Index) -> ContactSums:
    """The empty sum."""
    zero = jnp.float32(0.0)
    counts = [len(t.on_human) for t in index.tools]
    return ContactSums(
        tuple(ToolContactSums(jnp.zeros(n), jnp.zeros((n, 3)), zero) for n in counts), zero
    )


def add_contacts(index: Index, touch: ContactSums, sensordata: Array) -> ContactSums:
    """Add one physics step's contact sensors.

    Args:
        index: sensor addresses.
        touch: the sum so far.
        sensordata: of ``Data`` (nsensordata,).
    """
    return jax.tree.map(jnp.add, touch, read_contacts(index, sensordata))


def read_contacts(index: Index, sensordata: Any, xp: Any = jnp) -> ContactSums:
    """The contact sensors of one physics step.

    Args:
        index: sensor addresses.
        sensordata: of ``Data`` (..., nsensordata).
        xp: numpy or jax.numpy.

    Returns:
        The fields of ``ContactSums``, each with the leading axes of ``sensordata``.
    """

    def total(sensors: np.ndarray) -> Any:
        return xp.sum(xp.abs(sensordata[..., sensors]), axis=-1)

    def read(tool: ToolIndex) -> ToolContactSums:
        force = xp.abs(sensordata[..., tool.on_human])
        pos = sensordata[..., tool.on_human[:, None] + np.arange(3, 6)]
        return ToolContactSums(force=force, moment=force[..., None] * pos, seat=total(tool.on_seat))

    return ContactSums(tuple(read(tool) for tool in index.tools), total(index.robot_human))


def moment(index: Index, data: Any, xp: Any = jnp) -> Motion:
    """One moment of a motion: no leading axis."""
    tool, bodies = index.tools[0], dict(zip(index.links, index.human_body, strict=True))
    xpos, xmat = xp.array(data.xpos), xp.array(data.xmat).reshape(-1, 3, 3)
    return Motion(
        tool_pos_w=xp.array(data.site_xpos)[tool.tip],
        tool_quat_w=_quat_mul(xp.array(data.xquat)[tool.body], tool.quat, xp),
        link_pos_w={k: xpos[b] for k, b in bodies.items()},
        link_rot_w={k: xmat[b] for k, b in bodies.items()},
    )


def at_rest(index: Index, data: Any, n_steps: int) -> Motion:
    """Nothing moves for n physics steps."""
    still = lambda x: jnp.broadcast_to(jnp.asarray(x, jnp.float32), (n_steps + 1, *x.shape))  # noqa: E731
    return jax.tree.map(still, moment(index, data))


def sense(
    index: Index, data: Any, touch: ContactSums, motion: Motion, dims: Dims, sizes: Any
) -> Sensed:
    """Read one environment.

    Args:
        index: of the scene.
        data: ``mjx.Data`` of one environment (or ``MjData``) whose kinematics are up to date.
        touch: sums over the n physics steps of the control step.
        motion: during them.
        dims: sizes of the person.
        sizes: geom sizes of the model (ngeom, 3), the person's own in their rows.
    """
    n_steps = len(motion.tool_pos_w) - 1
    xpos, xmat = jnp.asarray(data.xpos), jnp.asarray(data.xmat).reshape(-1, 3, 3)
    bodies = dict(zip(index.links, index.human_body, strict=True))
    return Sensed(
        tools=tuple(
            _sense_tool(index, i, data, t, n_steps, jnp.asarray(sizes))
            for i, t in zip(index.tools, touch.tools, strict=True)
        ),
        arm_angles=jnp.asarray(data.qpos)[index.robot_qpos],
        torso_pos_w=jnp.asarray(data.site_xpos)[index.torso_site],
        robot_on_human=touch.robot_human / n_steps,
        human_angles=jnp.asarray(data.qpos)[index.human_qpos],
        link_pos_w={name: xpos[b] for name, b in bodies.items()},
        link_rot_w={name: xmat[b] for name, b in bodies.items()},
        link_quat_w={name: jnp.asarray(data.xquat)[b] for name, b in bodies.items()},
        dims=dims,
        motion=motion,
    )


def _sense_tool(
    index: Index, tool: ToolIndex, data: Any, touch: ToolContactSums, n_steps: int, sizes: Array
) -> ToolSensed:
    tip = jnp.asarray(data.site_xpos)[tool.tip]
    axis = jnp.asarray(data.xaxis)[tool.joints]
    anchor = jnp.asarray(data.xanchor)[tool.joints]
    speed = jnp.asarray(data.qvel)[tool.dofs]
    centre = jnp.asarray(data.geom_xpos)
    along = jnp.asarray(data.geom_xmat).reshape(-1, 3, 3)[:, :, 2] * sizes[:, 1:2]
    capsule = lambda ids: (centre[ids], along[ids], sizes[ids, 0])  # noqa: E731
    force = touch.force / n_steps
    where = touch.moment / jnp.where(touch.force > 0, touch.force, 1.0)[:, None]
    on_human = jnp.sum(force)
    return ToolSensed(
        pos_w=tip,
        quat_w=_quat_mul(jnp.asarray(data.xquat)[tool.body], tool.quat),
        vel_w=jnp.sum(jnp.cross(axis, tip - anchor) * speed[:, None], axis=0),
        gap=capsule_gap(capsule(tool.geoms), capsule(index.human_geom)),
        touch_force=force,
        touch_pos_w=where,
        touch_working=jnp.asarray(tool.working),
        on_human=on_human,
        force=on_human + touch.seat / n_steps,
    )


def _quat_mul(a: Array, b: Any, xp: Any = jnp) -> Array:
    """Product of quaternions wxyz."""
    b = xp.asarray(b, xp.float32)
    vector = a[0] * b[1:] + b[0] * a[1:] + xp.cross(a[1:], b[1:])
    return xp.concatenate([(a[0] * b[0] - xp.dot(a[1:], b[1:]))[None], vector])
