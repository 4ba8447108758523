"""An episode: drawn from keys, and written into a model. Pure functions for one environment."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from agym_jax.data.banks import Placement
from agym_jax.human import population
from agym_jax.human import pose as human_pose
from agym_jax.human.body import BodyFields
from agym_jax.human.muscles import Muscles
from agym_jax.sim.motors import implicit_armature
from agym_jax.sim.scene import Scene
from agym_jax.sim.starts import Starts, draw_start
from agym_jax.spec import HumanSpec
from agym_jax.state import Episode
from agym_jax.variation import RobotDraw, nothing_sent

EpisodeSample = tuple[population.Human, human_pose.BodyPose, Placement, RobotDraw | None]
"""Who the person is, how they sit or lie, where the robot starts, and how it is other than usual."""


def sample_episode(
    keys: Sequence[Array],
    scene: Scene,
    spec: HumanSpec,
    humans: population.Population,
    starts: Starts,
    robot: RobotDraw | None = None,
) -> EpisodeSample:
    """Draw all that makes one episode another than the next.

    Args:
        keys: three PRNG keys: of the person, the pose and the placement.
        scene: of the pair.
        spec: the person's part in the task.
        humans: the population.
        starts: placements, K rows, and whom they meet or suit.
        robot: of the episode, if robots vary.
    """
    human = population.sample_human(
        keys[0], humans, len(scene.moving), spec.tremor_amplitude, spec.impairments
    )
    pose, posture = human_pose.sample_pose_and_row(keys[1], spec, human)
    mouth = None
    if starts.mouths is not None:
        mouth = human_pose.mouth_of(spec, pose, human.dims, human.limit_scale, jnp)
    return human, pose, draw_start(keys[2], starts, posture, mouth), robot


def make_episode(scene: Scene, spec: HumanSpec, drawn: EpisodeSample, xp: Any = jnp) -> Episode:
    """What was drawn, with what follows from it, at step 0.

    Args:
        scene: of the pair.
        spec: the person's part in the task.
        drawn: from ``sample_episode``.
        xp: numpy or jax.numpy. A body is thousands of small operations, which NumPy has done before XLA has
            compiled them.
    """
    human, pose, placement, robot = drawn if xp is jnp else jax.device_get(drawn)
    angles = human_pose.start_angles(pose, scene.moving, human.limit_scale, xp)
    rows = human_rows(scene, spec, human, pose, xp)
    rows, angles = jax.tree.map(lambda x: xp.asarray(x, np.float32), (rows, angles))
    sent = nothing_sent(robot, len(scene.index.robot_joint), xp)
    return Episode(human, pose, rows, placement, angles, angles, xp.int32(0), robot, sent)


def start_qpos(scene: Scene, episode: Episode) -> Array:
    """Joint angles as the episode begins [rad] (nq,)."""
    qpos = jnp.asarray(scene.model.qpos0, jnp.float32)
    qpos = qpos.at[scene.index.robot_qpos].set(episode.placement.arm_angles)
    return qpos.at[scene.index.human_qpos].set(episode.human_angles)


def human_rows(
    scene: Scene, spec: HumanSpec, human: population.Human, pose: human_pose.BodyPose, xp: Any = jnp
) -> BodyFields:
    """The person's part of the model: rows of the scene's links and shapes."""
    rows = human_pose.rows(
        spec, pose, human.dims, scene.moving, human.limit_scale, xp, human.at_joints
    )
    index = scene.index
    kept = {"body": index.human_row, "geom": index.shape_row, "jnt": slice(None)}
    return rows._replace(**{k: x[kept[k.split("_")[0]]] for k, x in rows._asdict().items()})


def geom_sizes(scene: Scene, episode: Episode) -> Array:
    """Sizes of all geoms, this person's among them [m] (ngeom, 3)."""
    sizes = jnp.asarray(scene.model.geom_size, jnp.float32)
    return sizes.at[scene.index.human_geom].set(episode.rows.geom_size)


def model_fields(scene: Scene, model: Any, episode: Episode, muscles: Muscles) -> dict[str, Array]:
    """The fields of a model in which this episode's person, robot base and what varies of the robot are written.

    Args:
        scene: of the pair.
        model: ``mjx.Model`` or ``MjModel`` of the scene; it is not changed.
        episode: of the environment.
        muscles: of this person.
    """
    index, rows, place = scene.index, episode.rows, episode.placement
    bodies, geoms, joints = index.human_body, index.human_geom, index.human_joint

    def of(name: str) -> Array:
        return jnp.asarray(getattr(model, name), jnp.float32)

    written = {
        "body_pos": of("body_pos").at[bodies].set(rows.body_pos)
        .at[np.r_[index.robot_base, index.mount]].set(place.base_pos),
        "body_quat": of("body_quat").at[bodies].set(rows.body_quat)
        .at[index.robot_base].set(place.base_quat),
        "body_mass": of("body_mass").at[bodies].set(rows.body_mass),
        "body_ipos": of("body_ipos").at[bodies].set(rows.body_ipos),
        "body_inertia": of("body_inertia").at[bodies].set(rows.body_inertia),
        "geom_size": of("geom_size").at[geoms].set(rows.geom_size),
        "geom_pos": of("geom_pos").at[geoms].set(rows.geom_pos),
        "geom_rbound": of("geom_rbound").at[geoms].set(rows.geom_rbound),
        "jnt_pos": of("jnt_pos").at[joints].set(rows.jnt_pos),
        "jnt_range": of("jnt_range").at[joints].set(rows.jnt_range),
        "dof_damping": of("dof_damping").at[index.human_dof].set(muscles.damping),
        "dof_frictionloss": of("dof_frictionloss").at[index.human_dof].set(muscles.bound),
        "dof_armature": of("dof_armature").at[index.human_dof]
        .multiply(1.0 - episode.human.at_joints).at[index.human_dof]
        .add(implicit_armature(muscles.damping, scene.model.opt.timestep)),
        "body_invweight0": _blend(scene, "body_invweight0", episode.human.sex),
        "dof_invweight0": _blend(scene, "dof_invweight0", episode.human.sex),
    }  # fmt: skip
    if (robot := episode.robot) is None:
        return written
    if robot.strength is not None:
        bound = written["dof_frictionloss"].at[index.robot_dof].multiply(robot.strength)
        written["dof_frictionloss"] = bound
    if robot.friction is not None:
        rubs = of("pair_friction").at[index.robot_pair].multiply(robot.friction)
        written["pair_friction"] = rubs
    return written


def _blend(scene: Scene, name: str, sex: Array) -> Array:
    """Between the average man's field and the average woman's."""
    male: np.ndarray = getattr(scene.model, name)
    female: np.ndarray = getattr(scene.female, name)
    return jnp.asarray(male, jnp.float32) + sex * (female - male).astype(np.float32)
