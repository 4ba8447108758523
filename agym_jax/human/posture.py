"""Banks of postures: people who lie on the bed as gravity left them; ``agym-jax postures`` makes them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from functools import cache
from pathlib import Path
from typing import Any

import jax
import numpy as np

from agym_jax.data.assets import asset_root
from agym_jax.data.npz import Shape, read_arrays, write_arrays
from agym_jax.errors import MissingPostureError
from agym_jax.human import anthropometry, body

Array = Any


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Postures:
    """People and how they lie, one a row; or one of them, without the axis K.

    The leaves of a bank are float32. Its parts and their order are those of ``bed_postures.build_bank``; people
    of Assistive Gym's sizes come first.
    """

    sex: Array  # 0 male, 1 female, see anthropometry.dims            (K,)
    stature: Array  # height_scale                                    (K,)
    girth: Array  # radius_scale                                      (K,)
    limit_scale: Array  # of the limits within which they settled     (K,)
    root_pos: Array  # of the chest, world [m]                        (K, 3)
    root_quat: Array  # of the chest, world, wxyz                     (K, 4)
    angles: Array  # of every joint [rad], in the order of body.JOINTS (K, 41)

    @property
    def dims(self) -> anthropometry.Dims:
        """Sizes and masses."""
        return anthropometry.dims(self.sex, self.stature, self.girth)

    def row(self, i: int) -> Postures:
        """One person of a bank, in float64."""
        return Postures(*(np.asarray(getattr(self, f.name)[i], float) for f in fields(self)))


SHAPES: dict[str, Shape] = {
    "sex": ("rows",), "stature": ("rows",), "girth": ("rows",), "limit_scale": ("rows",),
    "root_pos": ("rows", 3), "root_quat": ("rows", 4), "angles": ("rows", len(body.JOINTS)),
}  # fmt: skip
"""Of the fields of a bank."""


def posture_path(name: str) -> Path:
    """Where a task's bank is kept."""
    return asset_root() / "postures" / f"{name}.npz"


def bank_of(humans: Sequence[Postures]) -> Postures:
    """Stack K people, each within that person's limits, into a bank."""
    rows = {
        f.name: np.array([getattr(p, f.name) for p in humans], np.float32) for f in fields(Postures)
    }
    for angles, limit_scale in zip(rows["angles"], rows["limit_scale"], strict=True):
        # float32 may round a limit outwards
        low, high = body.joint_limits(tuple(body.JOINTS), limit_scale, np).T.astype(np.float32)
        angles[:] = np.clip(angles, low, high)
    return Postures(**rows)


def link_positions(human: Postures) -> dict[str, np.ndarray]:
    """Where every link of one person is, world [m] (3,)."""
    angles = dict(zip(body.JOINTS, human.angles, strict=True))
    rows = body.fields(
        human.dims, angles, (), human.limit_scale, human.root_pos, human.root_quat, np
    )
    return dict(zip(body.LINK, rows.body_pos, strict=True))


def save_postures(bank: Postures, name: str, provenance: dict) -> None:
    """Write the bank of a task without pickle, with where it came from."""
    arrays = {f.name: getattr(bank, f.name) for f in fields(Postures)}
    write_arrays(posture_path(name), arrays, provenance)


@cache
def load_postures(name: str) -> Postures:
    """The bank of a task, K rows, as NumPy arrays.

    Args:
        name: of the task, such as ``"BedBathing"``.

    Raises:
        MissingPostureError: there is no such bank, or it is damaged; the message has its file and
            the command that makes it.
    """
    arrays = read_arrays(
        posture_path(name), "bank of postures", SHAPES, MissingPostureError,
        f"Build it with: agym-jax postures build {name}",
    )  # fmt: skip
    return Postures(**{f.name: np.asarray(arrays[f.name], np.float32) for f in fields(Postures)})
