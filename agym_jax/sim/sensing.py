"""From a simulator's data to ``Sensed``: the only reader of ``mjx.Data``.

Works on one environment of ``mjx.Data`` and, because the field names are the same, of ``native_data.NativeData``
or C ``MjData``.

DEVIATION(force-mean): contact forces are means over the physics steps of a control step, not
the last one's value: a single step's is noisy. Peaks are told besides, see ``human.regions``.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from agym_jax.human.anthropometry import Dims
from agym_jax.human.regions import REGIONS, RegionForces, no_forces
from agym_jax.math3d import capsule_gap, child_quat
from agym_jax.sense import LinkMotion, Motion, Sensed, ToolSensed
from agym_jax.sim.index import Index, ToolIndex


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class ToolContactSums:
    """Sums of one tool's contact sensors over physics steps."""

    force: Array  # normal force of each tool-person pair of geoms [N]      (n_pairs,)
    moment: Array  # force times contact point [N m]                        (n_pairs, 3)
    seat: Array  # [N]                                                      ()


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class ContactSums:
    """Sums of the contact sensors over physics steps."""

    tools: tuple[ToolContactSums, ...]
    robot_human: Array  # [N]                                               ()
    regions: RegionForces  # of all: sums, and no sums but peaks


class PoseSample(NamedTuple):
    """Poses of the first tool and of the links of person and robot at one physics step, as the simulator has them."""

    tool_pos_w: Any  # tip [m]                                              (3,)
    tool_body_quat_w: Any  # of the body that holds the tool, wxyz          (4,)
    link_pos_w: Any  # of the links of ``index.links`` [m]                  (n_links, 3)
    link_rot_w: Any  # rotation matrices                                    (n_links, 3, 3)
    robot_pos_w: Any  # of the links of ``index.robot_links`` [m]           (r, 3)
    robot_rot_w: Any  # rotation matrices                                   (r, 3, 3)


def no_contacts(index: Index) -> ContactSums:
    """The empty sum."""
    zero = jnp.float32(0.0)
    counts = [len(t.on_human) for t in index.tools]
    sums = tuple(ToolContactSums(jnp.zeros(n), jnp.zeros((n, 3)), zero) for n in counts)
    return ContactSums(sums, zero, no_forces())


def add_contacts(index: Index, sums: ContactSums, sensordata: Array) -> ContactSums:
    """Add one physics step's contact sensors.

    Args:
        index: sensor addresses.
        sums: so far.
        sensordata: of ``Data`` (nsensordata,).
    """
    new = read_contacts(index, sensordata)
    total = jax.tree.map(jnp.add, sums, new)
    peaks = jnp.maximum(sums.regions.peak, new.regions.peak)
    return replace(total, regions=RegionForces.of(total.regions.mean, peaks))


def total_contacts(readings: ContactSums, xp: Any = np) -> ContactSums:
    """The sums that readings of all physics steps make.

    Args:
        readings: from ``read_contacts``, with a leading axis of physics steps.
        xp: numpy or jax.numpy.
    """
    total = jax.tree.map(lambda x: x.sum(axis=0), readings)
    peaks = readings.regions.peak.max(axis=0)
    return replace(total, regions=RegionForces.of(total.regions.mean, peaks, xp))


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
        return ToolContactSums(force, force[..., None] * pos, total(tool.on_seat))

    belongs = np.eye(len(REGIONS), dtype=np.float32)[index.touch_region]
    # a masked sum and no matrix product: it is fused with what is around it
    touch = xp.abs(sensordata[..., index.touch])
    regions = xp.sum(touch[..., None] * belongs, axis=-2)
    tools = tuple(read(tool) for tool in index.tools)
    return ContactSums(tools, total(index.robot_human), RegionForces.of(regions, regions, xp))


def sample_poses(index: Index, data: Any, xp: Any = jnp) -> PoseSample:
    """Poses at one physics step.

    Args:
        index: of the scene.
        data: of one environment, kinematics up to date; or of n physics steps, all leaves (n, ...).
        xp: numpy or jax.numpy.
    """
    tool, bodies, robot = index.tools[0], index.human_body, index.robot_body
    pos, rot = xp.array(data.xpos), _matrices(xp.array(data.xmat))
    return PoseSample(
        tool_pos_w=xp.array(data.site_xpos)[..., tool.tip, :],
        tool_body_quat_w=xp.array(data.xquat)[..., tool.body, :],
        link_pos_w=pos[..., bodies, :],
        link_rot_w=rot[..., bodies, :, :],
        robot_pos_w=pos[..., robot, :],
        robot_rot_w=rot[..., robot, :, :],
    )


def _matrices(xmat: Any) -> Any:
    """Rotation matrices of bodies, which MJX has as such and MuJoCo as rows of 9 (..., nbody, 3, 3)."""
    return xmat.reshape(*xmat.shape[:-1], 3, 3) if xmat.shape[-1] == 9 else xmat


def motion_of(index: Index, poses: PoseSample, xp: Any = jnp) -> Motion:
    """The motion that pose samples make.

    Args:
        index: of the scene.
        poses: samples with a leading axis of n + 1 physics steps.
        xp: numpy or jax.numpy.
    """
    return Motion(
        tool_pos_w=poses.tool_pos_w,
        tool_quat_w=child_quat(poses.tool_body_quat_w, xp.asarray(index.tools[0].quat), xp),
        link_pos_w={name: poses.link_pos_w[:, i] for i, name in enumerate(index.links)},
        link_rot_w={name: poses.link_rot_w[:, i] for i, name in enumerate(index.links)},
        robot=LinkMotion(index.robot, index.robot_links, poses.robot_pos_w, poses.robot_rot_w),
    )


def motion_at_rest(index: Index, data: Any, n_steps: int) -> Motion:
    """A motion in which nothing moves for n physics steps."""
    repeat = lambda x: jnp.broadcast_to(jnp.asarray(x, jnp.float32), (n_steps + 1, *x.shape))  # noqa: E731
    return motion_of(index, jax.tree.map(repeat, sample_poses(index, data)))


def sense(
    index: Index, data: Any, contacts: ContactSums, motion: Motion, dims: Dims, sizes: Any
) -> Sensed:
    """Read one environment.

    Args:
        index: of the scene.
        data: ``mjx.Data`` of one environment (or ``MjData``) whose kinematics are up to date.
        contacts: sums over the n physics steps of the control step.
        motion: during them.
        dims: sizes of the person.
        sizes: geom sizes of the model (ngeom, 3), the person's own in their rows.
    """
    n_steps = len(motion.tool_pos_w) - 1
    xpos, xmat = jnp.asarray(data.xpos), jnp.asarray(data.xmat).reshape(-1, 3, 3)
    bodies = dict(zip(index.links, index.human_body, strict=True))
    return Sensed(
        tools=tuple(
            _sense_tool(index, i, data, c, n_steps, jnp.asarray(sizes))
            for i, c in zip(index.tools, contacts.tools, strict=True)
        ),
        arm_angles=jnp.asarray(data.qpos)[index.robot_qpos],
        torso_pos_w=jnp.asarray(data.site_xpos)[index.torso_site],
        robot_on_human=contacts.robot_human / n_steps,
        human_angles=jnp.asarray(data.qpos)[index.human_qpos],
        link_pos_w={name: xpos[b] for name, b in bodies.items()},
        link_rot_w={name: xmat[b] for name, b in bodies.items()},
        link_quat_w={name: jnp.asarray(data.xquat)[b] for name, b in bodies.items()},
        dims=dims,
        motion=motion,
        regions=RegionForces.of(contacts.regions.mean / n_steps, contacts.regions.peak),
    )


def _sense_tool(
    index: Index, tool: ToolIndex, data: Any, contacts: ToolContactSums, n_steps: int, sizes: Array
) -> ToolSensed:
    tip = jnp.asarray(data.site_xpos)[tool.tip]
    axis = jnp.asarray(data.xaxis)[tool.joints]
    anchor = jnp.asarray(data.xanchor)[tool.joints]
    speed = jnp.asarray(data.qvel)[tool.dofs]
    centre = jnp.asarray(data.geom_xpos)
    along = jnp.asarray(data.geom_xmat).reshape(-1, 3, 3)[:, :, 2] * sizes[:, 1:2]
    capsule = lambda ids: (centre[ids], along[ids], sizes[ids, 0])  # noqa: E731
    total, moment = (_per_contact(tool, x) for x in (contacts.force, contacts.moment))
    force = total / n_steps
    where = moment / jnp.where(total > 0, total, 1.0)[:, None]
    on_human = jnp.sum(force)
    return ToolSensed(
        pos_w=tip,
        quat_w=child_quat(jnp.asarray(data.xquat)[tool.body], jnp.asarray(tool.quat)),
        vel_w=jnp.sum(jnp.cross(axis, tip - anchor) * speed[:, None], axis=0),
        gap=capsule_gap(capsule(tool.geoms), capsule(index.human_geom)),
        touch_force=force,
        touch_pos_w=where,
        touch_working=jnp.asarray(tool.working),
        on_human=on_human,
        force=on_human + contacts.seat / n_steps,
    )


def _per_contact(tool: ToolIndex, pairs: Array) -> Array:
    """Sums over the pairs of geoms that make up each contact (n_touch, ...).

    Args:
        tool: which pair belongs to which contact.
        pairs: (n_pairs, ...).
    """
    if len(tool.contact) == len(tool.working):
        return pairs  # one each
    return jax.ops.segment_sum(pairs, jnp.asarray(tool.contact), len(tool.working))
