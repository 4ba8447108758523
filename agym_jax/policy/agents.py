"""Who acts: what each agent sees and moves, baselines, and a robot's policy beside a person's.

All that acts is a JAX tree that is called like a ``Policy``, so that a compiled evaluation serves all
policies of the same shape.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp

from agym_jax import observe
from agym_jax.errors import UnknownNameError
from agym_jax.policy.policy import Policy

BASELINES = ("zero", "random")
AnyPolicy = Callable[..., jax.Array]
"""``(obs, key, deterministic) -> action``: a policy, or a function like one."""


@dataclass(frozen=True)
class Part:
    """What belongs to one agent: columns of the observation and entries of the action.

    Attributes:
        observed: columns of the whole observation.
        acted: entries of the whole action.
        layout: version of its observation's layout.
        former_layout: the same before its columns were renamed; None if nobody knows.
    """

    observed: slice
    acted: slice
    layout: str
    former_layout: str | None = None

    @property
    def sizes(self) -> tuple[int, int]:
        """Columns of the observation, entries of the action."""
        return self.observed.stop - self.observed.start, self.acted.stop - self.acted.start


def parts(env: Any) -> dict[str, Part]:
    """What belongs to "robot" and "human", and to "joint", which is both at once.

    Where only the robot acts, all is the robot's.
    """
    n, m = env.observation_size, env.action_size
    task, alone = getattr(env, "task", None), len(env.action_sizes) < 2
    records = [task.robot_obs, *([] if alone else [task.human_obs])] if task else []
    former = observe.layout_version(*records, former=True) if records else None
    whole = Part(slice(0, n), slice(0, m), env.layout_version, former)
    if alone:
        return {"robot": whole}
    seen, moved = env.observation_sizes["robot"], env.action_sizes["robot"]
    (robot, robot_former), (human, human_former) = (
        (observe.layout_version(r), observe.layout_version(r, former=True)) for r in records
    )
    return {
        "robot": Part(slice(0, seen), slice(0, moved), robot, robot_former),
        "human": Part(slice(seen, n), slice(moved, m), human, human_former),
        "joint": whole,
    }


@partial(jax.tree_util.register_dataclass, data_fields=[], meta_fields=["name", "action_size"])
@dataclass(frozen=True)
class Baseline:
    """``"zero"`` does nothing, ``"random"`` anything in [-1, 1], uniformly."""

    name: str
    action_size: int

    @property
    def info(self) -> dict[str, Any]:
        """Where it came from: nowhere."""
        return {}

    def __call__(
        self, obs: jax.Array, key: jax.Array | None = None, deterministic: bool = True
    ) -> jax.Array:
        """The action for an observation.

        Raises:
            ValueError: a random action was asked for without a key.
        """
        shape = (*obs.shape[:-1], self.action_size)
        if self.name == "zero":
            return jnp.zeros(shape)
        if key is None:
            raise ValueError("A random action needs a key: policy(obs, key).")
        return jax.random.uniform(key, shape, minval=-1.0, maxval=1.0)


def baseline_policy(name: str, action_size: int) -> Baseline:
    """``"zero"`` (do nothing) or ``"random"`` (uniform in [-1, 1]), called like a ``Policy``.

    Raises:
        UnknownNameError: there is no such baseline.
    """
    if name not in BASELINES:
        raise UnknownNameError("baseline", name, BASELINES)
    return Baseline(name, action_size)


@partial(
    jax.tree_util.register_dataclass,
    data_fields=["robot", "human"],
    meta_fields=["robot_columns"],
)
@dataclass(frozen=True)
class Pair:
    """A robot's policy and a person's; each sees its own columns of the observation only.

    Attributes:
        robot: the robot's policy.
        human: the person's.
        robot_columns: how many columns of the observation are the robot's; the rest the person's.
    """

    robot: Policy | Baseline
    human: Policy | Baseline
    robot_columns: int

    @property
    def info(self) -> dict[str, Any]:
        """Where the robot's policy came from."""
        return dict(self.robot.info)

    def __call__(
        self, obs: jax.Array, key: jax.Array | None = None, deterministic: bool = True
    ) -> jax.Array:
        """The robot's action, then the person's; as ``Policy``."""
        keys = (None, None) if key is None else jax.random.split(key)
        robot, human = obs[..., : self.robot_columns], obs[..., self.robot_columns :]
        actions = (
            self.robot(robot, keys[0], deterministic),
            self.human(human, keys[1], deterministic),
        )
        return jnp.concatenate(actions, axis=-1)


TREES = (Policy, Pair, Baseline)
