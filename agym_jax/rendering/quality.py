"""OpenGL rendering quality, adapted to the image size: otherwise a small image would cost as much as a large one on a CPU."""

from __future__ import annotations

import copy
import math
from typing import NamedTuple

import mujoco

FULL_SIZE = 640
"""Longest side of an image from which everything is drawn in the quality given by the model [pixels]."""
MIN_SHADOW_SIZE, MIN_SAMPLES, MIN_SLICES, MIN_STACKS = 256, 4, 12, 8


class Quality(NamedTuple):
    """OpenGL rendering quality; names and meaning are those of ``MjModel.vis.quality``."""

    shadowsize: int
    """Side of the shadow map [pixels]."""
    offsamples: int
    """Samples per pixel."""
    numslices: int
    """Slices around a round geom."""
    numstacks: int
    """Stacks along a round geom."""


def quality_for(full: Quality, width: int, height: int) -> Quality:
    """Return the highest quality visible at an image size; on a CPU, more would make it as costly as a large image.

    The shadow map and the samples shrink with the image's longest side. A circle of n slices deviates by
    1 / n^2 of its radius, so slices and stacks shrink with the square root.

    Args:
        full: quality of images of ``FULL_SIZE`` or more; no image gets more than that.
        width: image width [pixels].
        height: image height [pixels].
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
    """Return the model, or a copy of it with the quality that is visible at an image size.

    Args:
        model: model with the quality of large images; it is not modified.
        width: image width [pixels].
        height: image height [pixels].
    """
    full = Quality(*(getattr(model.vis.quality, name) for name in Quality._fields))
    wanted = quality_for(full, width, height)
    if wanted == full:
        return model
    model = copy.copy(model)
    for name, value in wanted._asdict().items():
        setattr(model.vis.quality, name, value)
    return model
