"""Who acts, and by which policy: baselines, and a robot's policy beside a person's.

Everything here is a JAX tree that is called like a ``Policy``, so that a compiled evaluation serves
all policies of the same shape.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp

from agym_jax.errors import UnknownNameError
from agym_jax.policy.policy import FILE_NAMES, Policy, find_policy, load_policy, shipped_human

from ..envs import active_name, parts, static_name
from ..errors import PolicyEnvironmentError

BASELINES = ("zero", "random")
AnyPolicy = Callable[..., jax.Array]


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


@dataclass(frozen=True)
class PolicyFiles:
    """What the command line means: files or names of baselines; no person where none is named."""

    robot: str
    human: str | None


def find_policies(
    env_name: str, load_dir: str | None, policy: str | None, human_policy: str | None
) -> PolicyFiles:
    """The policies that the command-line tools mean, before anything is built.

    Args:
        env_name: environment id.
        load_dir: ``--save-dir`` of a training run.
        policy: of the robot (or of both at once): a file or a baseline, before ``load_dir``.
        human_policy: of the person, the same.

    Raises:
        PolicyNotFoundError: there is no such file.
        PolicyEnvironmentError: a person's policy where the person does not act.
    """
    plain = env_name.rpartition(":")[2]
    acts = plain != static_name(plain)
    if human_policy and not acts:
        raise PolicyEnvironmentError(
            f"In {plain!r} the person holds still and needs no --human-policy ({human_policy}). "
            f"Leave it out, or use --env-name {active_name(plain)}."
        )
    robot = policy if policy in BASELINES else str(find_policy(plain, load_dir, policy))
    human = human_policy
    if human and human not in BASELINES:
        human = str(find_policy(plain, None, human))
    if human is None and acts and policy is None:
        beside = shipped_human(plain)
        if load_dir is not None:
            beside = Path(load_dir) / plain / FILE_NAMES["human"]
        human = str(beside) if beside.is_file() else None
    return PolicyFiles(str(robot), human)


def load_agent(name: str, env: Any, agent: str, any_env: bool = False) -> Policy | Baseline:
    """The policy of one agent: a file that fits, or a baseline."""
    if name in BASELINES:
        return baseline_policy(name, parts(env)[agent].sizes[1])
    return load_policy(name, env, any_env, agent)


def load_policies(files: PolicyFiles, env: Any, any_env: bool = False) -> Policy | Baseline | Pair:
    """The policies of all who act in an environment.

    Args:
        files: from ``find_policies``.
        env: what they must fit.
        any_env: see ``load_policy``.

    Raises:
        PolicyEnvironmentError: of another task, robot or agent.
        PolicyLayoutError: it reads another observation layout, or has other sizes.
        PolicyDamagedError: a file is not whole.
    """
    if files.human is None:
        return load_agent(files.robot, env, "joint" if "joint" in parts(env) else "robot", any_env)
    robot = load_agent(files.robot, env, "robot", any_env)
    human = load_agent(files.human, env, "human", any_env)
    return Pair(robot, human, parts(env)["robot"].observed.stop)
