"""What one comparison with Assistive Gym says, and the recorded arrays that it starts from."""

from __future__ import annotations

import functools
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType

import numpy as np

TRACES = Path(__file__).resolve().parent / "traces"
"""Arrays recorded in Assistive Gym v0.1, reduced to what the comparisons need."""


@dataclass(frozen=True)
class Row:
    """One quantity in Assistive Gym and here.

    Attributes:
        quantity: what is compared, in words that fit into a table.
        unit: of both values; empty for shares and counts.
        ag: value in Assistive Gym.
        ours: value here.
        tolerance: largest difference that counts as the same.
        deviation: name in docs/deviations.md that explains a larger difference.
    """

    quantity: str
    unit: str
    ag: float
    ours: float
    tolerance: float
    deviation: str = ""

    @property
    def holds(self) -> bool:
        """Whether both are the same within the tolerance; NaN is not."""
        return abs(self.ours - self.ag) <= self.tolerance


@functools.cache
def traces(name: str) -> Mapping[str, np.ndarray]:
    """The arrays of one file of ``traces/``, by name."""
    with np.load(TRACES / f"{name}.npz", allow_pickle=False) as file:
        return MappingProxyType({key: file[key] for key in file.files})
