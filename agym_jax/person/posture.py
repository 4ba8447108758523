"""Banks of postures: people who lie on the bed as gravity left them; ``settle.py`` makes them."""

from __future__ import annotations

import zipfile
from dataclasses import dataclass, fields
from functools import cache
from pathlib import Path
from typing import Any

import jax
import numpy as np

from agym_jax.assets import asset_root
from agym_jax.errors import MissingPostureError
from agym_jax.person import body

Array = Any


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Postures:
    """People and how they lie, one a row. All leaves are float32."""

    sex: Array  # 0 male, 1 female, see anthropometry.dims            (K,)
    stature: Array  # height_scale                                    (K,)
    girth: Array  # radius_scale                                      (K,)
    root_pos: Array  # of the chest, world [m]                        (K, 3)
    root_quat: Array  # of the chest, world, wxyz                     (K, 4)
    angles: Array  # of every joint [rad], in the order of body.JOINTS (K, 41)


SHAPES = {
    "sex": (), "stature": (), "girth": (), "root_pos": (3,), "root_quat": (4,),
    "angles": (len(body.JOINTS),),
}  # fmt: skip
"""Shape of one row of each field."""


def posture_path(name: str) -> Path:
    """Where a task's bank is kept."""
    return asset_root() / "postures" / f"{name}.npz"


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
    remedy = f"Build it with: python -m agym_jax.person.settle build {name}"
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
