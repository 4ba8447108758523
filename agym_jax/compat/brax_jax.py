"""One function that Brax 0.14.2 calls and JAX 0.10 removed: ``jax.device_put_replicated``.

Brax's trainers (PPO, SAC, APG) put their training state on all devices with it. ``apply`` gives it back to the
module ``jax`` if it is missing there, as JAX's own guide to ``jax.pmap`` writes it; nothing else is changed.
``agym_jax.adapters.brax`` applies it, and nobody else: importing agym_jax leaves JAX as it is.
``tests/compat/test_brax_jax.py`` fails when Brax no longer calls the function; delete this file then.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh, NamedSharding, PartitionSpec

from agym_jax.compat import switch

NAME = "device_put_replicated"
AXIS = "i"  # as Brax names it: its arrays and these then have one type, and programs compile once


def device_put_replicated(x: Any, devices: Sequence[jax.Device]) -> Any:
    """Put a copy of a tree on each device, as ``jax.pmap`` takes it.

    Args:
        x: tree of arrays or numbers.
        devices: D of them.

    Returns:
        The tree; leaves have a first axis of D, one entry on each device.
    """
    sharding = NamedSharding(Mesh(np.array(devices), (AXIS,)), PartitionSpec(AXIS))

    def put(leaf: Any) -> jax.Array:
        leaf = jnp.asarray(leaf)
        return jax.device_put(jnp.broadcast_to(leaf, (len(devices), *leaf.shape)), sharding)

    return jax.tree.map(put, x)


def apply() -> bool:
    """Give ``jax.device_put_replicated`` back if JAX has none, Brax is 0.14 and this is not switched off.

    Returns:
        Whether JAX's is this module's now.
    """
    if not hasattr(jax, NAME) and switch.applies("brax_jax", "brax", "0.14.2", "0.15"):
        setattr(jax, NAME, device_put_replicated)
    return getattr(jax, NAME, None) is device_put_replicated
