"""What of a run outlives it: curve, checkpoints, policies, settings; and going on from them."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any

from . import record
from ..learning.algorithm import Algorithm
from .checkpoint import load_newest, save_checkpoint
from ..configs import LearnConfig
from .curve import Row
from agym_jax.policy.policy import Policy
from .folder import RunFolder
from ..learning.update import to_host

Policies = Mapping[str, Policy]


class CheckpointManager:
    """Writes what is to be kept, if anything is.

    Args:
        env: the environment.
        config: resolved settings.
        algorithm: whose state it is.
        folder: where; None keeps the curve in memory only.
        writes: whether this host is the one that writes; all of them read.

    Attributes:
        curve: rows of all sessions.
        seconds: that earlier sessions trained.
    """

    def __init__(
        self,
        env: Any,
        config: LearnConfig,
        algorithm: Algorithm,
        folder: RunFolder | None,
        writes: bool = True,
    ) -> None:
        self._env, self._config, self._algorithm = env, config, algorithm
        self._source, self._folder = folder, folder if writes else None
        self.curve: list[Row] = []
        self.seconds = 0.0
        self._belongs = {
            "trainer": algorithm.trainer,
            "env": env.name,
            "layout": env.layout_version,
            **algorithm.belongs(),
        }
        self._info = {
            "env": env.name,
            "commit": record.commit(),
            "versions": record.versions(),
            "algorithm": algorithm.trainer,
        }

    def resume(self, learner: Any) -> tuple[Any, Mapping[str, Any] | None]:
        """The learner to begin with, and what the newest sound checkpoint says, if there is one.

        Args:
            learner: a new one; where there is no checkpoint it is returned.

        Raises:
            CheckpointMismatchError: the folder holds a run of something else.
        """
        if not self._source:
            return learner, None
        found = load_newest(self._source.checkpoints, learner, self._belongs)
        if not found:
            return learner, None
        self.curve, self.seconds = found.meta["curve"], found.meta["seconds"]
        return found.learner, found.meta

    def begin(self, first_steps: int) -> None:
        """Write down the settings, and the curve as far as it is valid."""
        if self._folder:
            self._folder.write_curve(self.curve)
            self._folder.write_config(
                self._config,
                resumed_from_step=first_steps or None,
                impl=str(getattr(self._env, "impl", self._config.impl)),
            )

    def add(self, row: Row) -> None:
        """Keep a row of the curve."""
        self.curve.append(row)
        if self._folder:
            self._folder.add_row(row)

    def policies(self, learner: Any) -> Policies:
        """The policies of a learner, by agent."""
        return self._algorithm.policies(to_host(learner), self._info)

    def save(self, learner: Any, seconds: float) -> None:
        """A checkpoint, and the policies beside it.

        Args:
            learner: state to keep.
            seconds: that this session has trained.
        """
        if self._folder:
            meta = {
                "belongs": self._belongs,
                "curve": self.curve,
                "seconds": self.seconds + seconds,
                "config": dataclasses.asdict(self._config),
            }
            save_checkpoint(self._folder.checkpoints, learner, meta)
            self._folder.save_policies(self.policies(learner))

    def finish(self, learner: Any) -> Policies:
        """Save policies and picture; returns the policies."""
        policies = self.policies(learner)
        if self._folder:
            self._folder.save_policies(policies)
            title = f"{self._env.name}, {self._algorithm.trainer}, seed {self._config.seed}"
            self._folder.draw(self.curve, title)
        return policies
