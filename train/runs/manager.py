"""What a run keeps: learner, curves, policies and picture, written so that nothing already written is lost.

A disk that is full does not end a run. It is told, training goes on, and what is missing is written as soon as that is
possible: at the latest log line, with everything before it.
"""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from agym_jax.data.npz import check_writable
from agym_jax.errors import SaveFolderError
from agym_jax.interrupts import deferred
from agym_jax.policy.policy import Policy

from ..configs import LearnConfig
from ..errors import CheckpointMismatchError
from ..learning.agents import Agents
from ..learning.seeds import Lane, SideBySide, lanes_of
from ..learning.sharding import to_host
from . import record
from .checkpoint import load_newest, save_checkpoint, steps_of
from .curve import Row, combine_rows
from .folder import RunFolder
from .logging import Loggers

PATIENCE = 300.0
"""Seconds that a run which is complete waits for a disk to have room again."""
Policies = Mapping[str, Policy]


class CheckpointManager:
    """Writes what is to be kept, if anything is.

    Args:
        env: the environment.
        config: resolved settings.
        agents: whose state it is.
        folder: where; None keeps the curves in memory only.
        lanes: the trainings side by side; by default those of the configuration.
        writes: whether this host is the one that writes; all of them read.
        say: is told when results cannot be written, and when they can again.
        loggers: get the rows that a checkpoint holds.

    Attributes:
        lanes: the trainings side by side.
        curves: of each lane, rows of all sessions.
        combined: rows for all lanes together; with one lane, its curve.
        stopped: name of a lane -> why it was stopped.
        candidates: how many candidates each lane had (``count``), the fraction of the run after which one of them continued (``until``), by
            which ``rule``, and its number for each lane (``chosen``); None without candidates.
        seconds: that earlier sessions trained.
        saved_steps: environment steps of the newest checkpoint.
        trouble: why the latest results are not on disk; empty if they are.
    """

    def __init__(
        self,
        env: Any,
        config: LearnConfig,
        agents: Agents | SideBySide,
        folder: RunFolder | None,
        lanes: Sequence[Lane] | None = None,
        writes: bool = True,
        say: Callable[[str], None] = lambda text: None,
        loggers: Loggers | None = None,
    ) -> None:
        self._env, self._config, self._agents = env, config, agents
        self._source, self._folder = folder, folder if writes else None
        self.lanes = list(lanes or lanes_of(config))
        self.curves: list[list[Row]] = [[] for _ in self.lanes]
        self.combined: list[Row] = self.curves[0] if len(self.lanes) == 1 else []
        self.stopped: dict[str, str] = {}
        self.candidates: dict[str, Any] | None = None
        self.seconds, self.saved_steps, self._complete = 0.0, 0, False
        self.trouble = ""
        self._loggers = loggers or Loggers((), None, say)
        self._say, self._behind = say, set[str]()  # files of curves that lack rows
        self._compatibility = {
            "trainer": agents.trainer,
            "env": env.name,
            "layout": env.layout_version,
            "changes": getattr(env, "changes", {}),
            **agents.compatibility(),
        }
        self._info = {
            "env": env.name,
            "commit": record.commit(),
            "versions": record.versions(),
            "algorithm": agents.trainer,
            "changes": getattr(env, "changes", {}),
        }

    def _folders(self) -> list[RunFolder]:
        """Folder of the policies and the curve of each lane; none if nothing is written."""
        if not self._folder:
            return []
        if len(self.lanes) == 1:
            return [self._folder]
        return [self._folder.of_lane(lane.name) for lane in self.lanes]

    def resume(self, learner: Any) -> tuple[Any, Mapping[str, Any] | None]:
        """The learner to begin with, and what the newest sound checkpoint says, if there is one.

        Args:
            learner: a new one; where there is no checkpoint it is returned.

        Raises:
            CheckpointMismatchError: the folder holds a run of something else.
        """
        if not self._source:
            return learner, None
        found = load_newest(self._source.checkpoints, learner, self._compatibility)
        if not found:
            return learner, None
        meta = found.meta
        seed = meta.get("config", {}).get("seed", self._config.seed)
        if seed != self._config.seed:
            raise CheckpointMismatchError(
                f"{found.path} is of seed {seed}, this run has seed {self._config.seed}. Continue with --seed {seed}, choose another "
                f"--save-dir, or start over with --fresh (which moves the old run aside)."
            )
        self._check_starts(found.path, meta.get("config", {}))
        self.combined, self.seconds = meta["curve"], meta["seconds"]
        self.curves = meta.get("curves") or [self.combined]
        self.stopped = dict(meta.get("stopped", {}))
        self.candidates = meta.get("candidates")
        self.saved_steps = steps_of(found.learner)
        return found.learner, meta

    def _check_starts(self, path: Path, was: Mapping[str, Any]) -> None:
        """Reject a run that began with a policy where this one does not, or the other way round: it would learn otherwise from here on.

        Raises:
            CheckpointMismatchError: it did.
        """
        for name in ("robot_policy", "human_policy"):
            flag = f"--{name.replace('_', '-')}"
            before, now = was.get(name), getattr(self._config, name, None)
            if name in was and bool(before) != bool(now):
                began = f"began with {flag} {before}" if before else f"began without {flag}"
                needed = f"Add {flag} {before}" if before else f"Leave {flag} {now} out"
                raise CheckpointMismatchError(
                    f"{path} is of a run that {began}. {needed}, choose another --save-dir, or start over with --fresh (which moves "
                    f"the old run aside)."
                )

    def begin(self, learner: Any, complete: bool = False) -> None:
        """Write down the settings, the curves as far as they are valid, and a checkpoint if there is none yet.

        So a run that has begun has a checkpoint, and can be told from results that nothing can continue.

        Args:
            learner: with which the run begins.
            complete: whether there is nothing left to do. What has been written about the run then stays, as this commit and these
                settings did not train it.

        Raises:
            SaveFolderError: they cannot be written.
        """
        if not self._folder:
            return
        resumed_from_step = self.saved_steps or None
        self._complete = bool(complete and resumed_from_step)
        try:
            if not resumed_from_step:
                save_checkpoint(self._folder.checkpoints, learner, self._meta(0.0))
                self.saved_steps = steps_of(learner)
            for folder in self._folders():
                check_writable(folder.path)
            if not self._complete:
                if resumed_from_step and len(self.lanes) > 1:
                    self._set_aside_choice(resumed_from_step)
                self._folder.write_config(
                    self._config,
                    resumed_from_step=resumed_from_step,
                    impl=str(getattr(self._env, "impl", self._config.impl)),
                    candidates=self.candidates,
                )
            self._write_curves()
            self._loggers.begin(self._named())
        except SaveFolderError:
            raise
        except OSError as error:
            handed_over = self.candidates and not resumed_from_step
            lost = "" if handed_over else " Nothing has been computed yet."
            raise SaveFolderError(
                f"Cannot write to the folder {str(self._folder.path)!r}: {error.strerror or error}.{lost} Make room and rerun the "
                f"same command, or choose another folder with --save-dir."
            ) from error

    def continue_curves(self, curves: list[list[Row]]) -> None:
        """Begin the curve of each lane with rows from before, some of which may have ended early."""
        self.curves, longest = curves, max(curves, key=len)
        rows = [[curve[i] for curve in curves if len(curve) > i] for i in range(len(longest))]
        self.combined = curves[0] if len(curves) == 1 else [combine_rows(x) for x in rows]
        self.seconds = longest[-1]["seconds"] if longest else 0.0

    def _named(self) -> dict[str, list[Row]]:
        """The curves as loggers are given them."""
        seeds = {lane.name: curve for lane, curve in zip(self.lanes, self.curves, strict=True)}
        return {"": self.combined} | (seeds if len(self.lanes) > 1 else {})

    def add(self, rows: Mapping[int, Row]) -> Row:
        """Keep a row of the curve of each lane (by its index) that still learns; returns the one for all."""
        row = rows[0] if len(self.lanes) == 1 else combine_rows(list(rows.values()))
        folders = self._folders()
        for index, own in rows.items():
            self.curves[index].append(own)
            if folders:
                self._add_row(folders[index], self.curves[index])
        if len(self.lanes) > 1:
            self.combined.append(row)
            if self._folder:
                self._add_row(self._folder, self.combined)
        return row

    def _add_row(self, folder: RunFolder, curve: Sequence[Row]) -> None:
        """Write the last row of a curve, and those before it that could not be written."""
        name = str(folder.path)
        try:
            if name in self._behind:
                folder.write_curve(curve)
            else:
                folder.add_row(curve[-1])
        except OSError as error:
            self._behind.add(name)
            self._tell(error)
        else:
            self._behind.discard(name)

    def _tell(self, error: OSError) -> None:
        """Say once why results cannot be written."""
        if not self.trouble and self._folder:
            self._say(
                f"Cannot save in {self._folder.path}: {error.strerror or error}. Training goes on, and saving is tried "
                f"again at every log line; the newest checkpoint is of step {self.saved_steps:,}."
            )
        self.trouble = error.strerror or str(error)

    def policies(self, learner: Any) -> list[Policies]:
        """The policies of a learner by agent, for each lane."""
        learners = self._agents.of_seeds(to_host(learner))
        chosen = self.candidates["chosen"] if self.candidates else {}
        return [
            self._agents.policies(own, {**self._info, "seed": lane.seed, **number})
            for lane, own in zip(self.lanes, learners, strict=True)
            for number in [{"candidate": chosen[lane.name]} if lane.name in chosen else {}]
        ]

    def _meta(self, seconds: float) -> dict[str, Any]:
        """What a checkpoint says besides the learner."""
        meta = {
            "compatibility": self._compatibility,
            "curve": self.combined,
            "seconds": self.seconds + seconds,
            "config": dataclasses.asdict(self._config),
        }
        if self.candidates:
            meta["candidates"] = self.candidates
        if len(self.lanes) > 1:
            meta |= {"curves": self.curves, "stopped": self.stopped}
        return meta

    def save(self, learner: Any, seconds: float) -> bool:
        """A checkpoint, and the policies beside it; an interrupt waits until they are written.

        Args:
            learner: state to keep.
            seconds: that this session has trained.

        Returns:
            Whether that worked; where it did not, what was there before is still there.
        """
        if not self._folder:
            return True
        try:
            with deferred():
                save_checkpoint(self._folder.checkpoints, learner, self._meta(seconds))
                self.saved_steps = steps_of(learner)
                self._save_policies(self.policies(learner))
                if self._behind:
                    self._write_curves()
        except OSError as error:
            self._tell(error)
            return False
        if self.trouble:
            self._say(f"Saved again, at step {self.saved_steps:,}.")
            self.trouble = ""
        self._loggers.update(self._named())
        return True

    def save_end(self, learner: Any, seconds: float, patience: float | None = None) -> bool:
        """``save``, tried again while the disk has no room; for a run that is complete.

        Args:
            learner: state to keep.
            seconds: that this session has trained.
            patience: seconds to wait; None for ``PATIENCE``.

        Returns:
            Whether it worked.
        """
        patience = PATIENCE if patience is None else patience
        deadline = time.monotonic() + patience
        while not self.save(learner, seconds):
            if time.monotonic() >= deadline:
                return False
            if patience:
                self._say(f"Make room: the end of this run waits up to {patience:.0f} s for it.")
                patience = 0.0
            time.sleep(min(2.0, max(0.0, deadline - time.monotonic())))
        return True

    def _set_aside_choice(self, steps: int) -> None:
        if self._folder and (aside := self._folder.set_aside_choice(steps)):
            self._say(
                f"What was chosen among the seeds before is now in {aside}; choose again with agym-jax select {self._folder.path}."
            )

    def _write_curves(self) -> None:
        for folder, curve in zip(self._folders(), self.curves, strict=True):
            folder.write_curve(curve)
        if self._folder:
            self._folder.write_curve(self.combined)
        self._behind.clear()

    def _save_policies(self, policies: list[Policies]) -> None:
        for folder, own in zip(self._folders(), policies, strict=True):
            if not (self._complete and folder.has_policies(own)):
                folder.save_policies(own)

    def finish(self, learner: Any) -> list[Policies]:
        """Save policies and picture; returns the policies by agent, for each lane."""
        policies = self.policies(learner)
        if not self._folder:
            return policies
        of = f"seed {self.lanes[0].seed}"
        if len(self.lanes) > 1:
            of = f"{self.lanes[0].name} to {self.lanes[-1].name}"
        try:
            self._save_policies(policies)
            self._folder.draw(self.combined, f"{self._env.name}, {self._agents.trainer}, {of}")
        except OSError as error:
            self._tell(error)
        return policies
