"""Banks of postures: people who lie on the bed as gravity left them; ``settle.py`` makes them."""

from __future__ import annotations

import json
import zipfile
from collections.abc import Sequence
from dataclasses import dataclass, fields
from functools import cache
from pathlib import Path
from typing import Any

import jax
import numpy as np

from agym_jax.data.assets import asset_root
from agym_jax.errors import MissingPostureError
from agym_jax.human import anthropometry, body

Array = Any


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Postures:
    """People and how they lie, one a row; or one of them, without the axis K.

    The leaves of a bank are float32. Its parts and their order are those of ``settle.build_bank``; people
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


SHAPES = {
    "sex": (), "stature": (), "girth": (), "limit_scale": (), "root_pos": (3,), "root_quat": (4,),
    "angles": (len(body.JOINTS),),
}  # fmt: skip
"""Shape of one row of each field."""


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
    path = posture_path(name)
    path.parent.mkdir(parents=True, exist_ok=True)
    arrays = {f.name: getattr(bank, f.name) for f in fields(Postures)}
    np.savez_compressed(path, **arrays, provenance=np.array(json.dumps(provenance)))


@cache
def load_postures(name: str) -> Postures:
    """The bank of a task, K rows, as NumPy arrays.

    Args:
        name: of the task, such as ``"BedBathing"``.

    Raises:
        MissingPostureError: there is no such bank, or it is damaged; the message has its file and
            the command that makes it.
    """
    path = posture_path(name)
    remedy = f"Build it with: python -m agym_jax.offline.bed_postures build {name}"
    if not path.is_file():
        raise MissingPostureError(f"There is no bank of postures {path}. {remedy}")
    try:
        with path.open("rb") as file, np.load(file, allow_pickle=False) as z:
            bank = Postures(**{f.name: np.asarray(z[f.name], np.float32) for f in fields(Postures)})
    except (OSError, EOFError, ValueError, KeyError, zipfile.BadZipFile) as error:
        raise MissingPostureError(f"{path} cannot be read ({error}). {remedy}") from error
    for field, shape in SHAPES.items():
        value = getattr(bank, field)
        if value.shape != (len(bank.sex), *shape) or not np.isfinite(value).all():
            raise MissingPostureError(
                f"{path} is damaged: {field} has shape {value.shape}, or is not finite. {remedy}"
            )
    return bank
