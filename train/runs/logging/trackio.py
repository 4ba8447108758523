"""Trackio: a local database with a dashboard (``trackio show``), in the interface of Weights & Biases.

``TRACKIO_PROJECT`` names the project (``agym_jax``), ``TRACKIO_DIR`` where it is kept. The run's name there is the
environment and an id, which is in ``<run>/trackio.json``.
"""

from __future__ import annotations

import os
from typing import Any

import trackio

from .service import Service


class Trackio(Service):
    """See ``Logger``."""

    file = "trackio.json"

    def open(self) -> Any:
        """See ``Service``."""
        return trackio.init(
            project=os.environ.get("TRACKIO_PROJECT", "agym_jax"),
            name=f"{self.run.name}-{self.place.identity}",
            resume="allow",
            config=dict(self.run.settings),
            embed=False,
        )
