"""One function for many updates, and the same function on many devices.

One update is a rollout (``train.learning.rollout``) and what the algorithm learns from it. Where there are
several devices, each steps environments of its own, and they average what they learn: an update means
the same as one of all environments on one device.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.extend.core import ClosedJaxpr, jaxpr_as_fun
from jax.sharding import Mesh, NamedSharding, PartitionSpec

from ..configs import LearnConfig
from ..errors import ConfigError
from .algorithm import Algorithm
from .rollout import RolloutState, collect, critic_obs, zero_totals

AXIS = "rollout_state"  # of the devices
Run = Callable[..., tuple[Any, RolloutState, dict[str, jax.Array]]]


def make_updates(
    venv: Any, config: LearnConfig, algorithm: Algorithm, axis: str | None = None
) -> Run:
    """The function to compile: ``count`` updates in one call.

    Args:
        venv: vectorised environment, of the environments of one device.
        config: resolved settings.
        algorithm: how to learn.
        axis: name of the axis of devices, if there are several.

    Returns:
        ``run(learner, rollout_state, count, total_steps)``: state and environments afterwards, and totals over
        all updates: those of ``train.learning.rollout`` and ``loss/*``. ``count`` (int32) and the length of
        the run, ``total_steps`` (float32), are traced: runs of every length share one compilation.
    """

    def run(
        learner: Any, rollout_state: RolloutState, count: jax.Array, total_steps: jax.Array
    ) -> tuple[Any, RolloutState, dict[str, jax.Array]]:
        def update(_: jax.Array, carry: tuple) -> tuple:
            learner, rollout_state, totals = carry
            key, key_rollout, key_learn = jax.random.split(learner.key, 3)
            if axis is not None:
                index = jax.lax.axis_index(axis)
                key_rollout, key_learn = (
                    jax.random.fold_in(k, index) for k in (key_rollout, key_learn)
                )
            rollout_state, batch, sums = collect(
                lambda obs, key: algorithm.act(learner, obs, key),
                venv,
                rollout_state,
                key_rollout,
                num_steps=config.num_steps,
                gamma=config.gamma,
                reward_scaling=config.reward_scaling,
            )
            learner, losses = algorithm.learn(
                replace(learner, key=key),
                batch,
                critic_obs(rollout_state.env_state),
                key_learn,
                total_steps,
                axis,
            )
            if axis is not None:
                sums = jax.lax.psum(sums, axis)
            sums |= {f"loss/{name}": value for name, value in losses.items()}
            return (
                learner,
                rollout_state,
                {name: total + sums[name] for name, total in totals.items()},
            )

        totals = zero_totals(rollout_state.env_state)
        totals |= {f"loss/{name}": jnp.zeros((), jnp.float32) for name in algorithm.losses}
        return jax.lax.fori_loop(0, count, update, (learner, rollout_state, totals))

    return run


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


@jax.tree_util.register_static
@dataclass(frozen=True)
class Empty:
    """Stands for an array without elements where such arrays must not be."""

    shape: tuple[int, ...]
    dtype: Any


def shard(mesh: Mesh, first: Callable[[jax.Array], RolloutState], run: Run) -> tuple[Callable, Run]:
    """The functions that begin and continue the environments, on all devices.

    Each device has its own environments and the whole learner. Outside, leaves of the environments get a
    leading axis of devices: some of Warp's buffers serve all environments of a device and have no axis of
    environments. Arrays without elements are ``Empty`` there, because XLA's partitioner crashes on them
    (jaxlib 0.11.2 on GPUs, a segmentation fault in Shardy's ``ManualComputationUnusedInputsPattern``).

    Args:
        mesh: the devices.
        first: random key -> environments of one device.
        run: from ``make_updates`` with ``AXIS``.
    """
    common, own = PartitionSpec(), PartitionSpec(AXIS)
    first, run = _own_empty_constants(first), _own_empty_constants(run)

    def first_here(key: jax.Array) -> RolloutState:
        return _given(first(jax.random.fold_in(key, jax.lax.axis_index(AXIS))))

    def run_here(
        learner: Any, rollout_state: RolloutState, count: jax.Array, total_steps: jax.Array
    ) -> tuple[Any, RolloutState, dict[str, jax.Array]]:
        learner, rollout_state, totals = run(learner, _taken(rollout_state), count, total_steps)
        return learner, _given(rollout_state), totals

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


def _given(rollout_state: RolloutState) -> RolloutState:
    """Environments of one device, as they are outside (see ``shard``)."""
    return jax.tree.map(
        lambda leaf: leaf[None] if leaf.size else Empty(leaf.shape, leaf.dtype), rollout_state
    )


def _taken(rollout_state: RolloutState) -> RolloutState:
    """The reverse of ``_given``."""
    return jax.tree.map(
        lambda leaf: jnp.zeros(leaf.shape, leaf.dtype) if isinstance(leaf, Empty) else leaf[0],
        rollout_state,
        is_leaf=lambda leaf: isinstance(leaf, Empty),
    )


def _own_empty_constants(function: Callable[..., Any]) -> Callable[..., Any]:
    """The function, with arrays without elements made in it that it would otherwise be given."""

    def traced(*inputs: Any) -> Any:
        closed, out = jax.make_jaxpr(function, return_shape=True)(*inputs)
        constants = [x if x.size else jnp.zeros(x.shape, x.dtype) for x in closed.consts]
        run = jaxpr_as_fun(ClosedJaxpr(closed.jaxpr, constants))
        return jax.tree.unflatten(jax.tree.structure(out), run(*jax.tree.leaves(inputs)))

    return traced


def shardings(mesh: Mesh) -> tuple[NamedSharding, NamedSharding]:
    """Where what all devices share lives, and where what each has of its own."""
    return NamedSharding(mesh, PartitionSpec()), NamedSharding(mesh, PartitionSpec(AXIS))


def replicate(mesh: Mesh, tree: Any) -> Any:
    """A tree that all hosts have, as one that every device has."""
    return jax.device_put(jax.device_get(tree), shardings(mesh)[0])


def to_host(tree: Any) -> Any:
    """A tree that every device has, as one of this host alone."""
    return jax.tree.map(jnp.asarray, jax.device_get(tree))
