"""Trackio: a local database with a dashboard (``trackio show``), in the interface of Weights & Biases.

``TRACKIO_PROJECT`` names the project (``agym_jax``), ``TRACKIO_DIR`` where it is kept. The run's name there is the
environment and an id, which is in ``<run>/trackio.json``.
"""

from __future__ import annotations

import os
from typing import Any

import trackio

from .protocol import Curves, LoggedRun
from .service import Place


class Trackio:
    """See ``Logger``.

    Args:
        run: what is logged.
    """

    def __init__(self, run: LoggedRun) -> None:
        self._run, self._place = run, Place(run.folder / "trackio.json")
        self._log: Any = None

    def begin(self, curves: Curves) -> None:
        """See ``Logger``."""
        if self._log is None:
            self._log = trackio.init(
                project=os.environ.get("TRACKIO_PROJECT", "agym_jax"),
                name=f"{self._run.name}-{self._place.identity}",
                resume="allow",
                config=dict(self._run.settings),
                embed=False,
            )
        self.add(curves)

    def add(self, curves: Curves) -> None:
        """See ``Logger``."""
        self._place.log(curves, self._log.log)

    def close(self) -> None:
        """See ``Logger``."""
        if self._log is not None:
            self._log.finish()
            self._log = None
