"""How spoon and cup are filled when an episode begins: particles at rest, looked up in a bank.

``agym_jax.offline.particle_fill`` builds the banks.

DEVIATION(settled-bank): an episode begins with particles at rest, in an arrangement of the nearest tilt; AG
begins with whatever motion its settling has left.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from functools import cache
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from agym_jax.data.assets import asset_root
from agym_jax.data.npz import read_arrays
from agym_jax.errors import MissingFillError, UnknownNameError
from agym_jax.math3d import rotation_matrix
from agym_jax.matter.particles.solver import FOOD, WATER, Particles

DOWN = (0.0, 0.0, -1.0)
"""Direction of gravity, world."""
CONTENTS = {"spoon": FOOD, "cup": WATER}
"""Particles of each vessel that has a bank."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class FillBank:
    """K arrangements of n particles at rest, in the vessel's frame."""

    gravity_dir: Array | np.ndarray  # unit vectors in which gravity points (K, 3)
    pos: Array | np.ndarray  # centres [m]                                  (K, n, 3)


def fill_path(name: str) -> Path:
    """File of a vessel's bank."""
    return asset_root() / "matter" / f"{name}.npz"


@cache
def load_fill(name: str) -> FillBank:
    """The bank of ``"spoon"`` or ``"cup"``, as NumPy arrays.

    Raises:
        UnknownNameError: there is no such vessel.
        MissingFillError: its bank is missing or damaged; the message names the command that builds it.
    """
    if name not in CONTENTS:
        raise UnknownNameError("vessel", name, CONTENTS)
    arrays = read_arrays(
        fill_path(name), "bank of settled particles",
        {"gravity_dir": ("rows", 3), "pos": ("rows", CONTENTS[name].count, 3)},
        MissingFillError, f"Build it with: agym-jax particles {name}",
    )  # fmt: skip
    return FillBank(**{f.name: np.asarray(arrays[f.name], np.float32) for f in fields(FillBank)})


def fill(bank: FillBank, vessel_pos_w: Array, vessel_quat_w: Array) -> Particles:
    """Particles at rest in a vessel, from the bank's row of the nearest tilt.

    Args:
        bank: of the vessel.
        vessel_pos_w: of the vessel's frame [m] (3,).
        vessel_quat_w: wxyz (4,).
    """
    rot_w = rotation_matrix(vessel_quat_w, normalize=True)
    nearest = jnp.argmax(jnp.asarray(bank.gravity_dir) @ (jnp.array(DOWN) @ rot_w))
    pos_w = vessel_pos_w + jnp.asarray(bank.pos)[nearest] @ rot_w.T
    return Particles(pos_w, jnp.zeros_like(pos_w), jnp.ones(len(pos_w), bool))
