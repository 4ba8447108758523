"""Places and colours as tuples, so that records are hashable and files of robots and tasks need no arrays."""

from __future__ import annotations

from dataclasses import dataclass

Vec3 = tuple[float, float, float]
Quat = tuple[float, float, float, float]
Rgba = tuple[float, float, float, float]
IDENTITY: Quat = (1.0, 0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Pose:
    """A rigid pose: position [m] and quaternion wxyz."""

    pos: Vec3 = (0.0, 0.0, 0.0)
    quat: Quat = IDENTITY
