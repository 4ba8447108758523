"""Environments on several devices: each steps its own, and all average what they learn.

An update means the same as one of all environments on one device.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh, NamedSharding, PartitionSpec

from agym_jax.compat import shardy_empty

from ..errors import ConfigError
from .agents import LearnerState
from .ppo import Hyper
from .rollout import RolloutState, Totals, fold_in
from .update import Run

AXIS = "environments"  # of the devices


def device_mesh(wanted: int) -> Mesh | None:
    """The devices that share the environments.

    Args:
        wanted: how many; 0 = all, those of other hosts included.

    Returns:
        The devices, or None if it is one only.

    Raises:
        ConfigError: there are not so many.
    """
    there = jax.devices()
    if wanted > len(there):
        raise ConfigError(
            f"--devices {wanted} were asked for; JAX sees {len(there)} ({there[0].platform}). "
            f"Use --devices {len(there)} or leave it out."
        )
    if 0 < wanted < len(there) and jax.process_count() > 1:
        raise ConfigError(
            f"--devices {wanted} would leave out devices of some of {jax.process_count()} hosts; "
            f"leave it out, or start fewer hosts."
        )
    chosen = there[: wanted or len(there)]
    return Mesh(np.array(chosen), (AXIS,)) if len(chosen) > 1 else None


def shard(
    mesh: Mesh, first: Callable[[jax.Array], RolloutState], run: Run
) -> tuple[Callable[[jax.Array], RolloutState], Run]:
    """The functions that begin and continue the environments, on all devices.

    Each device has its own environments and the whole learner. Outside, leaves of the rollout state get a
    leading axis of devices: some of Warp's buffers serve all environments of a device and have no axis of
    environments.

    Args:
        mesh: the devices.
        first: random key -> rollout state of one device.
        run: from ``make_updates`` with ``AXIS``.
    """
    common, own = PartitionSpec(), PartitionSpec(AXIS)
    first, run = shardy_empty.own_constants(first), shardy_empty.own_constants(run)

    def first_here(key: jax.Array) -> RolloutState:
        state = first(fold_in(key, jax.lax.axis_index(AXIS)))
        return jax.tree.map(lambda leaf: leaf[None], shardy_empty.hide(state))

    def run_here(
        learner: LearnerState, rollout: RolloutState, count: jax.Array, hyper: Hyper
    ) -> tuple[LearnerState, RolloutState, Totals]:
        inside = shardy_empty.restore(jax.tree.map(lambda leaf: leaf[0], rollout))
        learner, inside, totals = run(learner, inside, count, hyper)
        outside = jax.tree.map(lambda leaf: leaf[None], shardy_empty.hide(inside))
        return learner, outside, totals

    # What is common is so by construction: every device computes it from averages over all.
    return (
        jax.shard_map(first_here, mesh=mesh, in_specs=common, out_specs=own, check_vma=False),
        jax.shard_map(
            run_here,
            mesh=mesh,
            in_specs=(common, own, common, common),
            out_specs=(common, own, common),
            check_vma=False,
        ),
    )


def shardings(mesh: Mesh) -> tuple[NamedSharding, NamedSharding]:
    """Where what all devices share lives, and where what each has of its own."""
    return NamedSharding(mesh, PartitionSpec()), NamedSharding(mesh, PartitionSpec(AXIS))


def replicate(mesh: Mesh, tree: Any) -> Any:
    """A tree that all hosts have, as one that every device has."""
    return jax.device_put(jax.device_get(tree), shardings(mesh)[0])


def to_host(tree: Any) -> Any:
    """A tree that every device has, as one of this host alone."""
    return jax.tree.map(jnp.asarray, jax.device_get(tree))
