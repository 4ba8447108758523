"""A policy: everything a trained robot or person needs to act, in one ``.npz`` file without pickle.

The file contains the weights of the policy network, the mean and standard deviation of the observation, and a record
of the policy's provenance. A loaded ``Policy`` is a pure function and a JAX pytree: pass it to a jitted function as an
argument, and new weights do not cause recompilation.
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

from agym_jax.data.assets import asset_root
from agym_jax.data.npz import read_npz, write_npz
from agym_jax.errors import (
    DamagedFileError,
    MissingAssetError,
    PolicyDamagedError,
    PolicyNotFoundError,
    did_you_mean,
)
from agym_jax.policy.networks import Architecture, make_networks, mode_action, sample_action

FORMAT = 1
FORMER_AGENTS = {"person": "human"}
"""Former name of an agent, used in files written before it was renamed -> its present name."""


@partial(
    jax.tree_util.register_dataclass,
    data_fields=["weights", "mean", "std"],
    meta_fields=["arch"],
    drop_fields=["info"],
)
@dataclass(frozen=True, eq=False)  # of arrays, which have no hash; jax.jit(policy) needs one
class Policy:
    """A policy, ready to act.

    Attributes:
        weights: parameters of the policy network.
        mean: mean of the observation    (observation,)
        std: standard deviation of the observation    (observation,)
        arch: sizes, layers, activation, distribution.
        info: provenance: ``env, agent, layout, env_steps, commit, versions, ...``. ``changes`` are the settings used in
            training, and ``meant_for`` those of the environment that the policy is for, if they differ.
    """

    weights: Any
    mean: jax.Array
    std: jax.Array
    arch: Architecture
    info: Mapping[str, Any] = field(default_factory=dict)

    def __repr__(self) -> str:
        about = (self.info.get("env"), self.info.get("agent"))
        known = "".join(f"{x}, " for x in about if x)
        steps = self.info.get("env_steps")
        trained = f", {steps:,} steps" if isinstance(steps, int) else ""
        return f"Policy({known}{self.arch.observation_size} -> {self.arch.action_size}{trained})"

    def __call__(
        self, obs: jax.Array, key: jax.Array | None = None, deterministic: bool = True
    ) -> jax.Array:
        """Compute the action for an observation.

        Args:
            obs: (..., observation).
            key: random key, needed only if not deterministic.
            deterministic: return the mode of the distribution instead of a sample.

        Returns:
            Action in [-1, 1]    (..., action).

        Raises:
            ValueError: if a sample is requested without a key, or the observation has another size.
        """
        if jnp.shape(obs)[-1:] != (self.arch.observation_size,):
            raise ValueError(
                f"This policy takes observations of shape (..., {self.arch.observation_size}), got {jnp.shape(obs)}."
            )
        networks = make_networks(self.arch)
        normalizer = NestedMeanStd(mean=self.mean, std=self.std)
        if deterministic:
            return mode_action(networks, normalizer, self.weights, obs)
        if key is None:
            raise ValueError("A sampled action needs a key: policy(obs, key, deterministic=False).")
        return jnp.clip(sample_action(networks, normalizer, self.weights, obs, key)[0], -1.0, 1.0)


def _named(tree: Mapping[str, Any], prefix: str) -> dict[str, Any]:
    """Return the leaves of nested dictionaries, under names such as ``prefix/a/b``."""
    flat: dict[str, Any] = {}
    for name, value in tree.items():
        path = f"{prefix}/{name}"
        flat |= _named(value, path) if isinstance(value, Mapping) else {path: value}
    return flat


def _flatten(tree: Mapping[str, Any], prefix: str) -> dict[str, np.ndarray]:
    """Return the same as NumPy arrays."""
    return {name: np.asarray(value) for name, value in _named(tree, prefix).items()}


def _unflatten(arrays: Mapping[str, np.ndarray], prefix: str) -> dict[str, Any]:
    """Invert ``_flatten``."""
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
    """Save a policy to a file.

    Args:
        path: file to write; its folder is created if necessary.
        policy: the policy; its ``info`` should contain ``env`` and ``layout``.

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


def read_policy(path: Path | str) -> Policy:
    """Read a policy file; ``agym_jax.policy.check`` checks whether it fits an environment.

    Raises:
        PolicyNotFoundError: if there is no such file; the message lists policies in nearby folders.
        PolicyDamagedError: if the file is damaged, is not a policy, or contains a policy that cannot act.
    """
    path = Path(path)
    try:
        arrays, meta = read_npz(path)
    except FileNotFoundError:
        raise not_found(path) from None
    except DamagedFileError as error:
        raise PolicyDamagedError(f"{error} Fetch or train the policy again.") from error
    if meta.get("format") != FORMAT or "arch" not in meta or "observation/mean" not in arrays:
        raise PolicyDamagedError(
            f"{path} is not a policy of format {FORMAT} (format {meta.get('format')!r})."
        )
    fault = _fault(meta["arch"], arrays)
    if fault:
        raise PolicyDamagedError(f"{path} cannot act: {fault}. Fetch or train the policy again.")
    arch = _architecture(meta.pop("arch"))
    agent = meta.get("agent", "robot")
    return Policy(
        weights=_unflatten(arrays, "policy"),
        mean=jnp.asarray(arrays["observation/mean"]),
        std=jnp.asarray(arrays["observation/std"]),
        arch=arch,
        info=meta | {"agent": FORMER_AGENTS.get(agent, agent)},
    )


def _architecture(record: Mapping[str, Any]) -> Architecture:
    fields: dict[str, Any] = {k: tuple(x) if isinstance(x, list) else x for k, x in record.items()}
    return Architecture(**fields)


def _fault(record: Any, arrays: Mapping[str, np.ndarray]) -> str | None:
    """Describe what is wrong with the arrays of a policy; None if nothing is."""
    try:
        arch = _architecture(record)
        network = make_networks(arch).policy_network
        weights = jax.eval_shape(network.init, jax.random.PRNGKey(0))
    except (AttributeError, LookupError, TypeError, ValueError) as error:
        return f"its record of a network is none ({type(error).__name__}: {error})"
    shapes = {name: x.shape for name, x in _named(weights, "policy").items()}
    shapes |= dict.fromkeys(("observation/mean", "observation/std"), (arch.observation_size,))
    for name, shape in shapes.items():
        array = arrays.get(name)
        if array is None:
            return f"it has no {name}"
        if array.shape != shape:
            return f"{name} has the shape {array.shape}, not {shape}"
        if array.dtype.kind != "f" or not np.isfinite(array).all():
            return f"{name} has entries that are no finite numbers"
    return None if (arrays["observation/std"] > 0).all() else "observation/std is not positive"


def shipped(memory: bool = False) -> list[str]:
    """Return the names of the environments for which a policy ships with agym_jax.

    Args:
        memory: whether the policy has a memory, see ``agym_jax.memory``; some environments have both.
    """
    try:
        return sorted(p.stem for p in (asset_root() / shipped_folder(memory)).glob("*.npz"))
    except MissingAssetError:
        return []


def shipped_folder(memory: bool = False) -> str:
    """Return the folder of the shipped policies of robots, with or without a memory, among the assets."""
    return "policies/memory" if memory else "policies"


def not_found(path: Path) -> PolicyNotFoundError:
    """Make an error that lists the policies near a missing one."""
    folder = path.parent
    near = sorted(p.name for p in folder.glob("*.npz")) if folder.is_dir() else []
    text = f"No policy {str(path)!r}. "
    text += f"In its folder: {did_you_mean(path.name, near)} " if near else ""
    return PolicyNotFoundError(
        f"{text}Policies ship for these ids. {did_you_mean(path.stem, shipped())}"
    )
