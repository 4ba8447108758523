"""The state of one environment: what ``reset`` returns and ``step`` maps to the next."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp

from agym_jax.human.body import BodyFields
from agym_jax.human.population import Human
from agym_jax.human.pose import BodyPose


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Placement:
    """Where the robot starts: one row of a placement bank."""

    base_pos: jax.Array  # world [m]                                         (3,)
    base_quat: jax.Array  # wxyz                                             (4,)
    arm_angles: jax.Array  # of the arms in use [rad]                        (n_arm,)


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Episode:
    """Everything that is drawn once an episode, and its clock."""

    human: Human
    pose: BodyPose  # how the person sits or lies
    rows: BodyFields  # the person's part of the model, rows of the scene's links
    placement: Placement
    human_angles: jax.Array  # start angles of the moving joints [rad]        (n_person,)
    human_target: jax.Array  # what the muscles hold, without tremor [rad]    (n_person,)
    step: jax.Array  # control steps done, int32                               ()


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class State:
    """One environment. Satisfies Brax's ``State`` in use: obs, reward, done, metrics, info, ``replace``."""

    data: Any  # mjx.Data
    obs: jax.Array  # robot's columns, then the active person's               (n_obs,)
    reward: jax.Array  #                                                      ()
    done: jax.Array  # 1.0 when the episode is over                           ()
    metrics: dict[str, jax.Array]  # every reward term, forces, success, ...   each ()
    info: dict[str, Any]  # belongs to wrappers; the environment never reads it
    task: Any  # the task's own pytree
    episode: Episode
    key: jax.Array

    def replace(self, **changes: Any) -> State:
        """A copy with some fields changed."""
        return dataclasses.replace(self, **changes)

    @property
    def pipeline_state(self) -> Any:
        """Brax's name for ``data``."""
        return self.data


def strong(tree: Any) -> Any:
    """No weak types: what ``reset`` and ``step`` return must compile once."""
    return jax.tree.map(
        lambda x: jax.lax.convert_element_type(x, x.dtype) if getattr(x, "weak_type", False) else x,
        tree,
    )


def select(where: jax.Array, new: Any, old: Any) -> Any:
    """Of two trees, the new one where it holds."""
    return jax.tree.map(lambda a, b: jnp.where(where, a, b), new, old)
