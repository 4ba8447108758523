"""Weights & Biases: one run there for each run here, with the columns of each seed and the statistics over seeds.

``WANDB_PROJECT`` names the project (``agym_jax``), ``WANDB_MODE=offline`` keeps everything in ``<run>/wandb`` until
``wandb sync``. The run's id is in ``<run>/wandb.json``.
"""

from __future__ import annotations

import os
from typing import Any

import wandb

from ...errors import ConfigError
from .protocol import Curves, LoggedRun
from .service import Place


class Wandb:
    """See ``Logger``.

    Args:
        run: what is logged.
    """

    def __init__(self, run: LoggedRun) -> None:
        self._run, self._place = run, Place(run.folder / "wandb.json")
        self._log: Any = None

    def begin(self, curves: Curves) -> None:
        """See ``Logger``."""
        if self._log is None:
            try:
                self._log = wandb.init(
                    project=os.environ.get("WANDB_PROJECT", "agym_jax"),
                    name=self._run.name,
                    id=self._place.identity,
                    resume="allow",
                    dir=str(self._run.folder),
                    config=dict(self._run.settings),
                )
            except wandb.Error as error:
                raise ConfigError(
                    f"--logger wandb cannot begin: {error} Log in with wandb login, set WANDB_MODE=offline, or leave the "
                    f"logger out."
                ) from error
        self.add(curves)

    def add(self, curves: Curves) -> None:
        """See ``Logger``."""
        self._place.log(curves, self._log.log)

    def close(self) -> None:
        """See ``Logger``."""
        if self._log is not None:
            self._log.finish()
            self._log = None
