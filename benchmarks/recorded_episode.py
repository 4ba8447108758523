"""Episodes here that begin as recorded ones of Assistive Gym do."""

from __future__ import annotations

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import agym_jax
from agym_jax.human import pose
from agym_jax.sim.episode import make_episode
from agym_jax.state import Episode, State


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
