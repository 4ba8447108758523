"""Policies: what a trained robot needs to act, in one ``.npz`` without pickle.

The file holds the weights of the policy network, mean and deviation of the observation, and a
record of where it came from. A loaded ``Policy`` is a pure function and a JAX tree: pass it to a
jitted function as an argument and new weights do not compile anew.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from brax.training.acme.running_statistics import NestedMeanStd

from agym_jax.data.npz import read_npz, write_npz
from agym_jax.errors import MissingAssetError, did_you_mean
from agym_jax.policy.networks import Architecture, make_networks, mode_action, sample_action
from train.envs import active_name, parts, static_name
from train.errors import (
    DamagedFileError,
    PolicyDamagedError,
    PolicyEnvironmentError,
    PolicyLayoutError,
    PolicyNotFoundError,
)

FORMAT = 1
FILE_NAME = "policy.npz"
FILE_NAMES = {"robot": FILE_NAME, "joint": FILE_NAME, "human": "human_policy.npz"}


@partial(
    jax.tree_util.register_dataclass,
    data_fields=["weights", "mean", "std"],
    meta_fields=["arch"],
    drop_fields=["info"],
)
@dataclass(frozen=True)
class Policy:
    """A policy that can act.

    Attributes:
        weights: parameters of the policy network.
        mean: of the observation    (observation,)
        std: of the observation    (observation,)
        arch: sizes, layers, activation, distribution.
        info: where it came from: ``env, agent, layout, env_steps, commit, versions, ...``.
    """

    weights: Any
    mean: jax.Array
    std: jax.Array
    arch: Architecture
    info: Mapping[str, Any] = field(default_factory=dict)

    def __call__(
        self, obs: jax.Array, key: jax.Array | None = None, deterministic: bool = True
    ) -> jax.Array:
        """The action for an observation.

        Args:
            obs: (..., observation).
            key: random key, needed only if not deterministic.
            deterministic: the mode of the distribution instead of a sample.

        Returns:
            Action in [-1, 1]    (..., action).

        Raises:
            ValueError: a sample was asked for without a key.
        """
        networks = make_networks(self.arch)
        normalizer = NestedMeanStd(mean=self.mean, std=self.std)
        if deterministic:
            return mode_action(networks, normalizer, self.weights, obs)
        if key is None:
            raise ValueError("A sampled action needs a key: policy(obs, key, deterministic=False).")
        return sample_action(networks, normalizer, self.weights, obs, key)[0]


MOVES = {"robot": "the robot", "human": "the person", "joint": "robot and person at once"}
FLAGS = {
    "robot": "--policy, and a --human-policy (a file, zero or random) where the person acts too",
    "human": "--human-policy, and an id whose person acts (...Human-v0)",
    "joint": "--policy alone, and the id it was trained in",
}


def train_command(env_name: str) -> str:
    """The command that trains a policy for an environment."""
    trainer = "ppo" if env_name == static_name(env_name) else "coop"
    return f"python -m train.{trainer} --env-name {env_name}"


def _flatten(tree: Mapping[str, Any], prefix: str) -> dict[str, np.ndarray]:
    """Nested dictionaries to ``prefix/a/b`` names."""
    flat: dict[str, np.ndarray] = {}
    for name, value in tree.items():
        path = f"{prefix}/{name}"
        flat |= _flatten(value, path) if isinstance(value, Mapping) else {path: np.asarray(value)}
    return flat


def _unflatten(arrays: Mapping[str, np.ndarray], prefix: str) -> dict[str, Any]:
    """The opposite of ``_flatten``."""
    tree: dict[str, Any] = {}
    for path, value in arrays.items():
        first, *names, last = path.split("/")
        if first == prefix:
            branch = tree
            for name in names:
                branch = branch.setdefault(name, {})
            branch[last] = jnp.asarray(value)
    return tree


def save_policy(path: Path | str, policy: Policy) -> Path:
    """Write a policy.

    Args:
        path: file to write; its folder is made if need be.
        policy: the policy; its ``info`` should have ``env`` and ``layout``.

    Returns:
        The path.
    """
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    arrays = _flatten(policy.weights, "policy")
    arrays |= {"observation/mean": np.asarray(policy.mean)}
    arrays |= {"observation/std": np.asarray(policy.std)}
    write_npz(path, arrays, {"format": FORMAT, "arch": asdict(policy.arch), **policy.info})
    return path


def load_policy(
    path: Path | str, env: Any = None, any_env: bool = False, agent: str | None = None
) -> Policy:
    """Read a policy.

    Args:
        path: file to read.
        env: environment that it must fit; None skips that check.
        any_env: accept a policy of another environment whose observation layout and action size
            agree.
        agent: whom it shall move: "robot", "person", or "joint" for both; None = all who act.

    Raises:
        PolicyNotFoundError: no such file; lists the policies that lie near it.
        PolicyDamagedError: the file is not whole, or no policy.
        PolicyEnvironmentError: trained for another task, robot or agent (a robot's policy fits the
            still and the active person of its pair).
        PolicyLayoutError: reads another observation layout, or has other sizes.
    """
    path = Path(path)
    try:
        arrays, meta = read_npz(path)
    except FileNotFoundError:
        raise _not_found(path) from None
    except DamagedFileError as error:
        raise PolicyDamagedError(f"{error} Fetch or train the policy again.") from error
    if meta.get("format") != FORMAT or "arch" not in meta or "observation/mean" not in arrays:
        raise PolicyDamagedError(
            f"{path} is not a policy of format {FORMAT} (format {meta.get('format')!r})."
        )
    sizes: dict[str, Any] = {
        k: tuple(v) if isinstance(v, list) else v for k, v in meta.pop("arch").items()
    }
    policy = Policy(
        weights=_unflatten(arrays, "policy"),
        mean=jnp.asarray(arrays["observation/mean"]),
        std=jnp.asarray(arrays["observation/std"]),
        arch=Architecture(**sizes),
        info=meta,
    )
    if env is not None:
        check_policy(policy, env, path, any_env, agent)
    return policy


def check_policy(
    policy: Policy,
    env: Any,
    path: Path | str,
    any_env: bool = False,
    agent: str | None = None,
) -> None:
    """Make sure that a policy fits an environment; see ``load_policy`` for arguments and errors."""
    agents = parts(env)
    agent = agent or ("joint" if "joint" in agents else "robot")
    part, whose = agents[agent], policy.info.get("agent", "robot")
    trained_in = str(policy.info.get("env"))
    if whose != agent:
        raise PolicyEnvironmentError(
            f"{path} moves {MOVES[whose]} of {trained_in!r}, not {MOVES[agent]} of {env.name!r}. "
            f"It goes with {FLAGS[whose]}."
        )
    fitting = {
        "robot": (static_name(env.name), active_name(env.name)),
        "human": (active_name(env.name),),
        "joint": (env.name,),
    }[agent]
    if trained_in not in fitting and not any_env:
        raise PolicyEnvironmentError(
            f"{path} was trained in {trained_in!r}, not in {env.name!r}. What fits was trained in "
            f"{' or '.join(map(repr, fitting))}. Use --env-name {trained_in}, or train one: "
            f"{train_command(env.name)}"
        )
    layout = policy.info.get("layout")
    if layout != part.layout:
        raise PolicyLayoutError(
            f"{path} reads observation layout {layout!r}, but {env.name!r} now has "
            f"{part.layout!r}: the entries of the observation have changed since it was "
            f"trained. Train it again, or use the version of agym_jax that it was made with "
            f"({policy.info.get('versions', {}).get('agym_jax', 'unknown')})."
        )
    theirs = (policy.arch.observation_size, policy.arch.action_size)
    ours = part.sizes
    if theirs != ours:
        raise PolicyLayoutError(
            f"{path} takes {theirs[0]} observations and gives {theirs[1]} actions; {env.name!r} "
            f"has {ours[0]} and {ours[1]}."
        )


def _shipped() -> list[str]:
    """Names of the environments whose policies come with agym_jax."""
    from agym_jax.data.assets import asset_root

    try:
        return sorted(p.stem for p in (asset_root() / "policies").glob("*.npz"))
    except MissingAssetError:
        return []


def _not_found(path: Path) -> PolicyNotFoundError:
    """An error that lists what lies near a missing policy."""
    folder = path.parent
    near = sorted(p.name for p in folder.glob("*.npz")) if folder.is_dir() else []
    text = f"No policy {str(path)!r}. "
    text += f"In its folder: {did_you_mean(path.name, near)} " if near else ""
    return PolicyNotFoundError(text + f"Shipped policies: {did_you_mean(path.stem, _shipped())}")


def find_policy(
    env_name: str, load_dir: Path | str | None = None, policy: Path | str | None = None
) -> Path:
    """The policy file that the command-line tools mean.

    Args:
        env_name: environment id.
        load_dir: ``--save-dir`` of a training run; its ``<env>/policy.npz`` is meant.
        policy: a file, which goes before ``load_dir``.

    Returns:
        The file; without folder and file, the shipped policy of the environment.

    Raises:
        PolicyNotFoundError: there is none; lists what there is and how to train one.
    """
    train = f"Train one: {train_command(env_name)}"
    if policy is not None:
        if not Path(policy).is_file():
            raise _not_found(Path(policy))
        return Path(policy)
    if load_dir is not None:
        path = Path(load_dir) / env_name / FILE_NAME
        if not path.is_file():
            there = [p.parent.name for p in Path(load_dir).glob(f"*/{FILE_NAME}")]
            raise PolicyNotFoundError(
                f"No policy for {env_name!r} in {str(load_dir)!r} (looked for {path}). "
                f"{did_you_mean(env_name, there)} {train} --save-dir {load_dir}"
            )
        return path
    from agym_jax.data.assets import asset_path

    try:
        return asset_path(f"policies/{env_name}.npz")
    except MissingAssetError:
        raise PolicyNotFoundError(
            f"agym_jax ships no policy for {env_name!r}. {did_you_mean(env_name, _shipped())} {train}"
        ) from None


def shipped_human(env_name: str) -> Path:
    """Where the person's policy of an environment lies if it is shipped; it may not be there."""
    from agym_jax.data.assets import asset_root

    return asset_root() / "policies" / "human" / f"{env_name}.npz"
