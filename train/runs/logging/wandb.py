"""Weights & Biases: one run there for each run here, with the columns of each seed and the statistics over seeds.

``WANDB_PROJECT`` names the project (``agym_jax``), ``WANDB_MODE=offline`` keeps everything in ``<run>/wandb`` until
``wandb sync``. The run's id is in ``<run>/wandb.json``.
"""

from __future__ import annotations

import os
from typing import Any

import wandb

from ...errors import ConfigError
from .service import Service


class Wandb(Service):
    """See ``Logger``."""

    file = "wandb.json"

    def open(self) -> Any:
        """See ``Service``."""
        try:
            return wandb.init(
                project=os.environ.get("WANDB_PROJECT", "agym_jax"),
                name=self.run.name,
                id=self.place.identity,
                resume="allow",
                dir=str(self.run.folder),
                config=dict(self.run.settings),
            )
        except wandb.Error as error:
            raise ConfigError(
                f"--logger wandb cannot start: {error} Log in with wandb login, set WANDB_MODE=offline, or leave the "
                f"logger out."
            ) from error
