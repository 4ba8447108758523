"""An episode: drawn from keys, and written into a model. Pure functions for one world."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from agym_jax.human import population as draw
from agym_jax.human import pose as person_pose
from agym_jax.human.body import BodyFields
from agym_jax.sim.scene import Scene
from agym_jax.spec import PersonSpec
from agym_jax.state import Episode, Placement

Drawn = tuple[draw.Person, person_pose.Pose, Placement]
"""Who the person is, how they sit or lie, and where the robot starts."""


def draw_episode(
    keys: Sequence[Array], scene: Scene, spec: PersonSpec, people: draw.People, bank: Placement
) -> Drawn:
    """Draw all that makes one episode another than the next.

    Args:
        keys: three PRNG keys: of the person, the pose and the placement.
        scene: of the pair.
        spec: the person's part in the task.
        people: the population.
        bank: placements, K rows.
    """
    person = draw.draw_person(
        keys[0], people, len(scene.moving), spec.tremor_amplitude, spec.impairments
    )
    pose = person_pose.draw_pose(keys[1], spec, person)
    row = jax.random.randint(keys[2], (), 0, bank.arm_angles.shape[0])
    return person, pose, jax.tree.map(lambda x: jnp.asarray(x)[row], bank)


def episode_of(scene: Scene, spec: PersonSpec, drawn: Drawn, xp: Any = jnp) -> Episode:
    """What was drawn, with what follows from it, at step 0.

    Args:
        scene: of the pair.
        spec: the person's part in the task.
        drawn: from ``draw_episode``.
        xp: numpy or jax.numpy. A body is thousands of small operations, which NumPy has done before XLA has
            compiled them.
    """
    person, pose, placement = drawn if xp is jnp else jax.device_get(drawn)
    angles = person_pose.start_angles(pose, scene.moving, person.limit_scale, xp)
    rows = person_rows(scene, spec, person, pose, xp)
    rows, angles = jax.tree.map(lambda x: xp.asarray(x, np.float32), (rows, angles))
    return Episode(person, pose, rows, placement, angles, angles, jnp.int32(0))


def start_qpos(scene: Scene, episode: Episode) -> Array:
    """Joint angles as the episode begins [rad] (nq,)."""
    qpos = jnp.asarray(scene.model.qpos0, jnp.float32)
    qpos = qpos.at[scene.index.robot_qpos].set(episode.placement.arm_angles)
    return qpos.at[scene.index.person_qpos].set(episode.person_angles)


def person_rows(
    scene: Scene, spec: PersonSpec, person: draw.Person, pose: person_pose.Pose, xp: Any = jnp
) -> BodyFields:
    """The person's part of the model: rows of the scene's links."""
    rows = person_pose.rows(spec, pose, person.dims, scene.moving, person.limit_scale, xp)
    per_link = [k for k in rows._fields if not k.startswith("jnt")]
    return rows._replace(**{k: getattr(rows, k)[scene.index.person_row] for k in per_link})


def geom_sizes(scene: Scene, episode: Episode) -> Array:
    """Sizes of all geoms, this person's among them [m] (ngeom, 3)."""
    sizes = jnp.asarray(scene.model.geom_size, jnp.float32)
    return sizes.at[scene.index.person_geom].set(episode.rows.geom_size)


def model_fields(scene: Scene, model: Any, episode: Episode, damping: Array) -> dict[str, Array]:
    """The fields of a model in which this episode's person and robot base are written.

    Args:
        scene: of the pair.
        model: ``mjx.Model`` or ``MjModel`` of the scene; it is not changed.
        episode: of the world.
        damping: of the person's joints [N m s/rad] ().
    """
    index, rows, place = scene.index, episode.rows, episode.placement
    bodies, geoms, joints = index.person_body, index.person_geom, index.person_joint

    def of(name: str) -> Array:
        return jnp.asarray(getattr(model, name), jnp.float32)

    return {
        "body_pos": of("body_pos").at[bodies].set(rows.body_pos)
        .at[index.robot_base].set(place.base_pos),
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
        "dof_damping": of("dof_damping").at[index.person_dof].set(damping),
        "body_invweight0": _blend(scene, "body_invweight0", episode.person.sex),
        "dof_invweight0": _blend(scene, "dof_invweight0", episode.person.sex),
    }  # fmt: skip


def _blend(scene: Scene, name: str, sex: Array) -> Array:
    """Between the average man's field and the average woman's."""
    male: np.ndarray = getattr(scene.model, name)
    female: np.ndarray = getattr(scene.female, name)
    return jnp.asarray(male, jnp.float32) + sex * (female - male).astype(np.float32)
