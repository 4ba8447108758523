"""Episodes here that begin as recorded ones of Assistive Gym do."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import agym_jax
from agym_jax.errors import ArgumentError
from agym_jax.human import pose
from agym_jax.sim.episode import make_episode
from agym_jax.state import Episode, State


def read_recorded(path: Path, program: str) -> dict[str, np.ndarray]:
    """The arrays of a file that was recorded in Assistive Gym.

    Args:
        path: of the file.
        program: what records it, for the message.

    Raises:
        ArgumentError: there is no such file.
    """
    if not path.is_file():
        raise ArgumentError(f"{path}: no such file. It is recorded in Assistive Gym, by {program}.")
    with np.load(path, allow_pickle=False) as file:
        return dict(file)


def episode_as(
    env: agym_jax.Env, angles: np.ndarray, sex: float, drawn: Episode | None = None,
    body: pose.BodyPose | None = None, **person: Any,
) -> Episode:  # fmt: skip
    """An episode with a recorded person of Assistive Gym's sizes, and a robot in a recorded pose.

    Args:
        env: with ``impl="native"``.
        angles: of the robot's joints [rad] (n_arm,).
        sex: 0 male, 1 female.
        drawn: what else an episode has, such as the robot's base; of seed 0 unless given.
        body: how the person sits or lies; as usual in the task unless given.
        **person: further fields of ``Human``; without any, the person is unimpaired.
    """
    if drawn is None:
        drawn = env.reset(jax.random.PRNGKey(0)).episode
    unimpaired = dict.fromkeys(("stature", "girth", "strength", "limit_scale"), 1.0)
    fields = unimpaired | {"tremor": np.zeros_like(drawn.human.tremor), "sex": sex} | person
    fields = {name: jnp.asarray(value, jnp.float32) for name, value in fields.items()}
    human, spec = dataclasses.replace(drawn.human, **fields), env.task.human
    if body is None:
        body = pose.typical(spec, sex, 1.0, 1.0, float(human.limit_scale))
    place = dataclasses.replace(drawn.placement, arm_angles=jnp.asarray(angles, jnp.float32))
    return make_episode(
        env.scene, spec, (human, jax.tree.map(jnp.float32, body), place, drawn.robot), np
    )


def episode_in_place(
    env: agym_jax.Env,
    place: Mapping[str, np.ndarray],
    angles: np.ndarray,
    sex: float,
    **person: Any,
) -> Episode:
    """An episode in which a robot's base and a person are where they were recorded.

    Args:
        env: with ``impl="native"``.
        place: ``base`` and ``chest``, poses in the world as position [m] and quaternion wxyz (7,); ``body``, angles of all the
            person's joints in the order of ``body.JOINTS`` [rad] (41,).
        angles: of the robot's joints [rad] (n_arm,).
        sex: 0 male, 1 female.
        **person: further fields of ``Human``, see ``episode_as``.
    """
    drawn = env.reset(jax.random.PRNGKey(0)).episode
    base, chest = jnp.asarray(place["base"], jnp.float32), place["chest"]
    stands = dataclasses.replace(drawn.placement, base_pos=base[:3], base_quat=base[3:])
    body = pose.BodyPose(chest[:3], chest[3:], place["body"])
    drawn = dataclasses.replace(drawn, placement=stands)
    return episode_as(env, angles, sex, drawn, body, **person)


def begin_as(env: agym_jax.Env, state: State, episode: Episode, key: jax.Array) -> State:
    """The state in which an episode begins.

    Args:
        env: with ``impl="native"``.
        state: of the environment; it is not changed.
        episode: from ``episode_as``.
        key: of what the task draws.
    """
    data = env.physics.reset(state.data, episode)
    fields, _ = env._begin_task(key, data, episode)
    return state.replace(data=data, episode=episode, **fields)


def play_on(
    env: agym_jax.Env, episode: Episode, start: Mapping[str, np.ndarray], actions: np.ndarray
) -> np.ndarray:
    """Play actions from a state in the course of an episode.

    Args:
        env: with ``impl="native"``.
        episode: of the person and the robot's base.
        start: angles and speeds of the robot's joints ``q``, ``qd`` (n_arm,) and of the person's ``person_q``, ``person_qd``, those
            that do not move here at the end or left out [rad, rad/s].
        actions: one for each control step (n, n_arm).

    Returns:
        The robot's angles after them [rad] (n_arm,).
    """
    physics, index = env.physics, env.scene.index
    data = physics.reset(physics.make_data(), episode)
    q, v, moving = np.array(data.qpos), np.array(data.qvel), len(index.human_qpos)
    q[index.robot_qpos], v[index.robot_dof] = start["q"], start["qd"]
    q[index.human_qpos] = start["person_q"][:moving]
    v[index.human_dof] = start["person_qd"][:moving]
    data, aim = data.replace(qpos=q, qvel=v), _aim(env)
    for action in actions:
        data, _, _ = physics.step(
            data, episode, aim(episode, data, jnp.asarray(action, jnp.float32))
        )
    return np.array(data.qpos[index.robot_qpos])


@functools.cache
def _aim(env: agym_jax.Env) -> Any:
    """What the motors are told, compiled once for each environment."""
    return jax.jit(env.controller.targets)
