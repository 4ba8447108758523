"""The agents: what each one observes and controls, baseline policies, and pairs of robot and person policies.

Every policy is a JAX pytree that is called like a ``Policy``, so that one compiled evaluation serves all policies of
the same shape.
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
"""``(obs, key, deterministic) -> action``: a policy, or a function with the same signature."""


@dataclass(frozen=True)
class Part:
    """The observation columns and action entries that belong to one agent.

    Attributes:
        observed: its columns of the full observation.
        acted: its entries of the full action.
        layout: version of its observation layout.
        former_layout: version before the columns were renamed; None if unknown.
    """

    observed: slice
    acted: slice
    layout: str
    former_layout: str | None = None

    @property
    def sizes(self) -> tuple[int, int]:
        """Number of observation columns and of action entries."""
        return self.observed.stop - self.observed.start, self.acted.stop - self.acted.start


def parts(env: Any) -> dict[str, Part]:
    """Return the parts of "robot", "human", and "joint" (both together).

    If only the robot acts, everything belongs to the robot.
    """
    n, m = env.observation_size, env.action_size
    alone = len(env.action_sizes) < 2
    records = list(getattr(env, "observation_records", {}).values())
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
    """A baseline policy: ``"zero"`` does nothing, ``"random"`` draws actions uniformly from [-1, 1]."""

    name: str
    action_size: int

    @property
    def info(self) -> dict[str, Any]:
        """Provenance, which is empty for a baseline."""
        return {}

    def __call__(
        self, obs: jax.Array, key: jax.Array | None = None, deterministic: bool = True
    ) -> jax.Array:
        """Return the action for an observation.

        Raises:
            ValueError: if a random action is requested without a key.
        """
        shape = (*obs.shape[:-1], self.action_size)
        if self.name == "zero":
            return jnp.zeros(shape)
        if key is None:
            raise ValueError("A random action needs a key: policy(obs, key).")
        return jax.random.uniform(key, shape, minval=-1.0, maxval=1.0)


def baseline_policy(name: str, action_size: int) -> Baseline:
    """Make the baseline ``"zero"`` (do nothing) or ``"random"`` (uniform in [-1, 1]), called like a ``Policy``.

    Raises:
        UnknownNameError: if there is no such baseline.
    """
    if name not in BASELINES:
        raise UnknownNameError("baseline", name, BASELINES)
    return Baseline(name, action_size)


@partial(
    jax.tree_util.register_dataclass,
    data_fields=["robot", "human"],
    meta_fields=["robot_columns"],
)
@dataclass(frozen=True, eq=False)  # as ``Policy``
class Pair:
    """A pair of robot policy and person policy; each receives only its own columns of the observation.

    Attributes:
        robot: the robot's policy.
        human: the person's policy.
        robot_columns: number of observation columns that belong to the robot; the rest are the person's.
    """

    robot: Policy | Baseline
    human: Policy | Baseline
    robot_columns: int

    @property
    def info(self) -> dict[str, Any]:
        """Provenance of the robot's policy."""
        return dict(self.robot.info)

    def __call__(
        self, obs: jax.Array, key: jax.Array | None = None, deterministic: bool = True
    ) -> jax.Array:
        """Return the robot's action followed by the person's; arguments as for ``Policy``."""
        keys = (None, None) if key is None else jax.random.split(key)
        robot, human = obs[..., : self.robot_columns], obs[..., self.robot_columns :]
        actions = (
            self.robot(robot, keys[0], deterministic),
            self.human(human, keys[1], deterministic),
        )
        return jnp.concatenate(actions, axis=-1)


TREES = (Policy, Pair, Baseline)
