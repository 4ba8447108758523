"""The data of environments of C MuJoCo: what matters of ``MjData``, in one array."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any

import jax
import mujoco
import numpy as np

Layout = tuple[tuple[str, int, int, tuple[int, ...]], ...]
"""Name, start, stop and shape of each field in ``NativeData.numbers``."""
MOTION = ("qpos", "qvel", "qacc_warmstart", "qfrc_bias", "M")
"""Fields that decide what happens next, with those of ``BEARING``."""
POSES = ("xpos", "xmat", "xquat", "xanchor", "xaxis", "site_xpos", "geom_xpos", "geom_xmat")
"""Fields that ``sense`` reads besides."""
BEARING = ("xpos", "xmat", "xanchor", "xaxis")
"""Fields that tell what the arm of a seated person weighs."""
SAMPLED = ("site_xpos", "xquat", "xpos", "xmat")
"""Fields that ``sample_poses`` reads after every physics step."""


def _field(name: str) -> Any:
    """A property: the part of ``numbers`` that has this name."""

    def view(data: NativeData) -> Any:
        start, stop, shape = next(x[1:] for x in data.layout if x[0] == name)
        part = data.numbers[..., start:stop]
        return part.reshape(*part.shape[:-1], *shape)

    return property(view, doc=f"``{name}`` of ``MjData``.")


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class NativeData:
    """Environments of C MuJoCo: what matters of ``MjData``, under the same names, with the leading axes of ``numbers``.

    It lies in one array, because each array that enters a compiled function costs some microseconds.
    """

    numbers: Any  # float64 (..., n)
    layout: Layout = dataclasses.field(metadata={"static": True})

    qpos = _field("qpos")  # [rad]                                            (nq,)
    qvel = _field("qvel")  # [rad/s]                                          (nv,)
    qacc_warmstart = _field("qacc_warmstart")  # where the solver begins      (nv,)
    qfrc_bias = _field("qfrc_bias")  # gravity and inertial torque [N m]      (nv,)
    M = _field("M")  # inertia matrix, sparse, of the last physics step       (nC,)
    xpos = _field("xpos")  # of bodies, world [m]                             (nbody, 3)
    xmat = _field("xmat")  #                                                  (nbody, 9)
    xquat = _field("xquat")  # wxyz                                           (nbody, 4)
    xanchor = _field("xanchor")  # of joints, world [m]                       (njnt, 3)
    xaxis = _field("xaxis")  #                                                (njnt, 3)
    site_xpos = _field("site_xpos")  # world [m]                              (nsite, 3)
    geom_xpos = _field("geom_xpos")  # world [m]                              (ngeom, 3)
    geom_xmat = _field("geom_xmat")  #                                        (ngeom, 9)

    def replace(self, **changes: Any) -> NativeData:
        """A copy with some fields changed."""
        copy = NativeData(np.array(self.numbers), self.layout)
        for name, value in changes.items():
            getattr(copy, name)[...] = value
        return copy


def layout_of(d: mujoco.MjData, names: tuple[str, ...] = (*MOTION, *POSES)) -> Layout:
    """Where the fields of one environment lie in an array of numbers."""
    layout, start = [], 0
    for name in names:
        field = getattr(d, name)
        layout.append((name, start, start + field.size, field.shape))
        start += field.size
    return tuple(layout)
