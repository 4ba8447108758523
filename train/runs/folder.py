"""The folder of one run: settings, curve, checkpoints and policy, and how they are continued."""

from __future__ import annotations

import dataclasses
import datetime
import json
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from agym_jax.data.npz import append_line, check_writable, remove_parts, write_file
from agym_jax.errors import SaveFolderError
from agym_jax.policy.files import FILE_NAMES
from agym_jax.policy.policy import Policy, save_policy

from ..configs import LearnConfig
from .lock import RunLock
from .overview import SELECTION
from .plots import plot_curve
from .record import record


class RunFolder:
    """``<save_dir>/<environment>``.

    Attributes:
        path: the folder.
        checkpoints: folder of the checkpoints in it.
        curve: learning curve, one JSON object a line.
        picture: learning curve as a picture.
        lock: keeps other runs out while it is entered.
    """

    def __init__(self, save_dir: str, env_name: str) -> None:
        self.path = Path(save_dir) / env_name
        self.checkpoints = self.path / "checkpoints"
        self.curve = self.path / "curve.jsonl"
        self.picture = self.path / "curve.png"
        self.lock = RunLock(self.path)

    def of_lane(self, name: str) -> RunFolder:
        """The folder of one of several trainings, in this one."""
        return RunFolder(str(self.path), name)

    def check(self, fresh: bool) -> None:
        """Refuse a folder that a run must not write to, before anything is built.

        Args:
            fresh: the results of an earlier run will be moved aside.

        Raises:
            SaveFolderError: the folder cannot be written to, or holds results that cannot be continued.
            RunInUseError: another run is training in it.
        """
        check_writable(self.path.parent)
        with self.lock:
            if not fresh:
                self._refuse_results_without_checkpoint()

    def prepare(self, fresh: bool) -> Path | None:
        """Make sure that results can be written, before anything compiles; the lock is held.

        Args:
            fresh: move the results of an earlier run aside.

        Returns:
            Where an earlier run went, if it was moved.

        Raises:
            SaveFolderError: the folder cannot be written to, or holds results that cannot be continued.
        """
        aside = None
        if not fresh:
            self._refuse_results_without_checkpoint()
        elif self.path.is_dir() and any(self.path.iterdir()):
            stamp = datetime.datetime.now().strftime("%Y%m%d-%H%M%S-%f")
            aside = self.path.rename(self.path.with_name(f"{self.path.name}.before-{stamp}"))
        check_writable(self.path)
        check_writable(self.checkpoints)
        remove_parts(self.path)
        return aside

    def _refuse_results_without_checkpoint(self) -> None:
        if any(self.checkpoints.glob("step_*.npz")):
            return
        names = (*FILE_NAMES.values(), self.curve.name)
        there = [
            path
            for pattern in ("", "seed_*/")
            for name in names
            for path in self.path.glob(pattern + name)
        ]
        if found := sorted({str(x.relative_to(self.path)) for x in there if x.stat().st_size}):
            raise SaveFolderError(
                f"{str(self.path)!r} has {', '.join(found)}, but no checkpoint to continue from; training would "
                f"overwrite them. Start over with --fresh, which moves the folder aside, or choose another folder with "
                f"--save-dir."
            )

    def write_config(self, config: LearnConfig, **fields: Any) -> None:
        """Save the resolved settings with commit, versions and device."""
        line = record("training-config", config=dataclasses.asdict(config), **fields)
        write_file(self.path / "config.json", (json.dumps(line, indent=2) + "\n").encode())

    def save_policies(self, policies: Mapping[str, Policy]) -> None:
        """Save the policies of all agents."""
        for agent, policy in policies.items():
            save_policy(self.path / FILE_NAMES[agent], policy)

    def has_policies(self, agents: Iterable[str]) -> bool:
        """Whether there is a policy of each of these agents."""
        return all((self.path / FILE_NAMES[agent]).is_file() for agent in agents)

    def set_aside_choice(self, steps: int) -> Path | None:
        """Move aside what was chosen among seeds, as they are trained further.

        Args:
            steps: environment steps of a seed when it was chosen.

        Returns:
            The folder with it; None if nothing had been chosen.
        """
        names = {*FILE_NAMES.values(), SELECTION}
        there = [path for name in sorted(names) if (path := self.path / name).is_file()]
        aside = self.path / f"chosen_at_step_{steps}"
        for path in there:
            aside.mkdir(exist_ok=True)
            path.replace(aside / path.name)
        return aside if there else None

    def write_curve(self, curve: Sequence[Mapping[str, Any]]) -> None:
        """Replace the curve, as when a run goes on from a checkpoint."""
        write_file(self.curve, "".join(json.dumps(row) + "\n" for row in curve).encode())

    def add_row(self, row: Mapping[str, Any]) -> None:
        """Add a row to the curve, whole or not at all.

        Raises:
            OSError: it cannot be written.
        """
        append_line(self.curve, json.dumps(row))

    def draw(self, curve: Sequence[Mapping[str, Any]], title: str) -> None:
        """Draw the curve."""
        plot_curve(self.picture, curve, title)
