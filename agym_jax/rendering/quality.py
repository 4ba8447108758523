"""How finely OpenGL draws: on a CPU a small picture would cost as much as a large one otherwise."""

from __future__ import annotations

import copy
import math
from typing import NamedTuple

import mujoco

FULL_SIZE = 640
"""Longest side of a picture from which on everything is drawn as finely as the model says [pixels]."""
MIN_SHADOW_SIZE, MIN_SAMPLES, MIN_SLICES, MIN_STACKS = 256, 4, 12, 8


class Quality(NamedTuple):
    """How finely OpenGL draws; names and meaning are those of ``MjModel.vis.quality``."""

    shadowsize: int
    """Side of the shadow map [pixels]."""
    offsamples: int
    """Samples of a pixel."""
    numslices: int
    """Around a round geom."""
    numstacks: int
    """Along a round geom."""


def quality_for(full: Quality, width: int, height: int) -> Quality:
    """As fine as a picture can show: on a CPU, a finer one costs as much as a large picture.

    The shadow map and the samples shrink with the picture's longest side. A circle of n slices is off by
    1 / n^2 of its radius, so slices and stacks shrink with the root.

    Args:
        full: of pictures of ``FULL_SIZE`` and more; no picture gets more than that.
        width: of the picture [pixels].
        height: of the picture [pixels].
    """
    share = min(1.0, max(width, height) / FULL_SIZE)
    return Quality(
        min(full.shadowsize, max(MIN_SHADOW_SIZE, _power_of_two(share * full.shadowsize))),
        min(full.offsamples, max(MIN_SAMPLES, _power_of_two(share * full.offsamples))),
        min(full.numslices, max(MIN_SLICES, math.ceil(share**0.5 * full.numslices))),
        min(full.numstacks, max(MIN_STACKS, math.ceil(share**0.5 * full.numstacks))),
    )


def _power_of_two(at_least: float) -> int:
    return 1 << max(0, math.ceil(at_least) - 1).bit_length()


def with_quality(model: mujoco.MjModel, width: int, height: int) -> mujoco.MjModel:
    """The model, or a copy of it that OpenGL draws as finely as a picture can show.

    Args:
        model: with the quality of large pictures; it is not written.
        width: of the picture [pixels].
        height: of the picture [pixels].
    """
    full = Quality(*(getattr(model.vis.quality, name) for name in Quality._fields))
    wanted = quality_for(full, width, height)
    if wanted == full:
        return model
    model = copy.copy(model)
    for name, value in wanted._asdict().items():
        setattr(model.vis.quality, name, value)
    return model
