"""The folder of one run: settings, curve, checkpoints and policy, and how they are continued."""

from __future__ import annotations

import dataclasses
import datetime
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from agym_jax.data.npz import check_writable, write_file
from agym_jax.policy.files import FILE_NAMES
from agym_jax.policy.policy import Policy, save_policy

from ..configs import LearnConfig
from .plots import plot_curve
from .record import record


class RunFolder:
    """``<save_dir>/<environment>``.

    Attributes:
        path: the folder.
        checkpoints: folder of the checkpoints in it.
        curve: learning curve, one JSON object a line.
        picture: learning curve as a picture.
    """

    def __init__(self, save_dir: str, env_name: str) -> None:
        self.path = Path(save_dir) / env_name
        self.checkpoints = self.path / "checkpoints"
        self.curve = self.path / "curve.jsonl"
        self.picture = self.path / "curve.png"

    def of_lane(self, name: str) -> RunFolder:
        """The folder of one of several trainings, in this one."""
        return RunFolder(str(self.path), name)

    def prepare(self, fresh: bool) -> Path | None:
        """Make sure that results can be written, before anything compiles.

        Args:
            fresh: move the results of an earlier run aside.

        Returns:
            Where an earlier run went, if it was moved.

        Raises:
            SaveFolderError: the folder cannot be written to.
        """
        check_writable(self.path.parent)
        aside = None
        if fresh and self.path.is_dir() and any(self.path.iterdir()):
            stamp = datetime.datetime.now().strftime("%Y%m%d-%H%M%S-%f")
            aside = self.path.rename(self.path.with_name(f"{self.path.name}.before-{stamp}"))
        check_writable(self.path)
        check_writable(self.checkpoints)
        return aside

    def write_config(self, config: LearnConfig, **fields: Any) -> None:
        """Save the resolved settings with commit, versions and device."""
        line = record("training-config", config=dataclasses.asdict(config), **fields)
        write_file(self.path / "config.json", (json.dumps(line, indent=2) + "\n").encode())

    def save_policies(self, policies: Mapping[str, Policy]) -> None:
        """Save the policies of all agents."""
        for agent, policy in policies.items():
            save_policy(self.path / FILE_NAMES[agent], policy)

    def write_curve(self, curve: Sequence[Mapping[str, Any]]) -> None:
        """Replace the curve, as when a run goes on from a checkpoint."""
        write_file(self.curve, "".join(json.dumps(row) + "\n" for row in curve).encode())

    def add_row(self, row: Mapping[str, Any]) -> None:
        """Add a row to the curve."""
        with self.curve.open("a") as file:
            file.write(json.dumps(row) + "\n")

    def draw(self, curve: Sequence[Mapping[str, Any]], title: str) -> None:
        """Draw the curve."""
        plot_curve(self.picture, curve, title)
