"""Checkpoints: the whole learner in one file, so that an interrupted run resumes as if nothing had happened.

A checkpoint holds every leaf of the learner (networks, optimiser, statistics, random key, step
count, from which the learning rate follows) under its path in the tree, and a record of what it
fits with the learning curve so far. It is restored onto a learner of the right shape. The
environments are not saved: a resumed run begins with fresh episodes.
"""

from __future__ import annotations

import dataclasses
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from agym_jax.data.npz import check_writable, read_npz, write_npz
from agym_jax.errors import DamagedFileError
from agym_jax.policy.policy import Policy

from ..configs import LearnConfig
from ..errors import CheckpointMismatchError, CheckpointWarning
from ..learning.agents import Agents
from ..learning.seeds import Lane, SideBySide, lanes_of
from ..learning.sharding import to_host
from . import record
from .curve import Row, combine_rows
from .folder import RunFolder

FORMAT = 2
KEEP = 3


@dataclass(frozen=True)
class Checkpoint:
    """A restored checkpoint."""

    path: Path
    learner: Any
    meta: dict[str, Any]


def tree_to_arrays(tree: Any) -> dict[str, np.ndarray]:
    """Leaves of a tree by their path, such as ``params/policy/params/hidden_0/kernel``."""
    leaves = jax.tree_util.tree_leaves_with_path(tree)
    return {
        jax.tree_util.keystr(path, simple=True, separator="/"): np.asarray(leaf)
        for path, leaf in leaves
    }


def arrays_to_tree(arrays: Mapping[str, np.ndarray], template: Any) -> Any:
    """The opposite of ``tree_to_arrays``.

    Args:
        arrays: path -> array.
        template: tree of the wanted structure, shapes and types (arrays or ShapeDtypeStructs).

    Raises:
        CheckpointMismatchError: names, shapes or types differ; lists the first few.
    """
    paths, structure = jax.tree_util.tree_flatten_with_path(template)
    wanted = {jax.tree_util.keystr(p, simple=True, separator="/"): leaf for p, leaf in paths}
    faults = [f"{name} is missing" for name in wanted if name not in arrays]
    faults += [f"{name} is not expected" for name in arrays if name not in wanted]
    for name, want in wanted.items():
        have = arrays.get(name)
        if have is None:
            continue
        if have.shape != want.shape or have.dtype != want.dtype:
            faults.append(
                f"{name} is {have.dtype}{list(have.shape)}, not {want.dtype}{list(want.shape)}"
            )
    if faults:
        more = f" and {len(faults) - 3} more" if len(faults) > 3 else ""
        raise CheckpointMismatchError("; ".join(faults[:3]) + more)
    return jax.tree_util.tree_unflatten(structure, [jnp.asarray(arrays[n]) for n in wanted])


def steps_of(learner: Any) -> int:
    """Environment steps of a learner, of each of its seeds (one that diverged has stopped earlier)."""
    return int(np.max(jax.device_get(learner.env_steps)))


def checkpoint_files(folder: Path) -> list[Path]:
    """Checkpoints in a folder, newest first."""
    return sorted(folder.glob("step_*.npz"), reverse=True)


def save_checkpoint(folder: Path, learner: Any, meta: Mapping[str, Any]) -> Path:
    """Write a checkpoint and delete all but the newest few.

    Args:
        folder: where checkpoints lie; it exists.
        learner: tree with a leaf ``env_steps``.
        meta: ``compatibility`` (what the checkpoint fits), ``curve`` and whatever else, for JSON.

    Returns:
        The file.
    """
    learner = jax.device_get(learner)
    path = folder / f"step_{steps_of(learner):012d}.npz"
    write_npz(path, tree_to_arrays(learner), {"format": FORMAT, **meta})
    for old in checkpoint_files(folder)[KEEP:]:
        old.unlink(missing_ok=True)
    for part in folder.glob(".step_*"):  # left by a run that was killed while it wrote
        part.unlink(missing_ok=True)
    return path


def load_checkpoint(path: Path, template: Any, compatibility: Mapping[str, Any]) -> Checkpoint:
    """Read one checkpoint.

    Args:
        path: the file.
        template: learner of the right structure.
        compatibility: name -> value of everything that must agree (environment, layout, networks).

    Raises:
        DamagedFileError: the file is not whole.
        CheckpointMismatchError: it belongs to something else; says to what, and what would fit.
    """
    arrays, meta = read_npz(path)
    advice = (
        "Continue with the settings of the checkpoint, choose another --save-dir, or start over "
        "with --fresh (which moves the old run aside)."
    )
    if meta.get("format") != FORMAT:
        raise CheckpointMismatchError(
            f"{path} has checkpoint format {meta.get('format')}, this version reads {FORMAT}. {advice}"
        )
    theirs = meta["compatibility"]
    trainer = compatibility.get("trainer", theirs.get("trainer"))
    if theirs.get("trainer") != trainer:
        raise CheckpointMismatchError(
            f"{path} is of a run of train.{theirs.get('trainer')}, this is train.{trainer}. Continue it "
            f"with agym-jax {theirs.get('trainer')}, choose another --save-dir, or start over "
            f"with --fresh (which moves the old run aside)."
        )
    differ = [
        f"{name} is {theirs.get(name)!r}, this run has {value!r}"
        for name, value in compatibility.items()
        if theirs.get(name) != value
    ]
    if differ:
        raise CheckpointMismatchError(f"{path} does not fit: {'; '.join(differ)}. {advice}")
    try:
        return Checkpoint(path, arrays_to_tree(arrays, template), meta)
    except CheckpointMismatchError as error:
        raise CheckpointMismatchError(f"{path} does not fit: {error}. {advice}") from None


def load_newest(folder: Path, template: Any, compatibility: Mapping[str, Any]) -> Checkpoint | None:
    """The newest checkpoint that is whole; damaged ones are skipped with a ``CheckpointWarning``.

    Args:
        folder: where checkpoints lie; it may not exist.
        template: learner of the right structure.
        compatibility: see ``load_checkpoint``.

    Returns:
        The checkpoint, or None if there is none.

    Raises:
        DamagedFileError: there are checkpoints, and all are damaged.
        CheckpointMismatchError: the newest whole one belongs to something else.
    """
    files = checkpoint_files(folder)
    for path in files:
        try:
            return load_checkpoint(path, template, compatibility)
        except DamagedFileError as error:
            warnings.warn(f"{error} Using the one before it.", CheckpointWarning, stacklevel=2)
    if files:
        raise DamagedFileError(
            f"All {len(files)} checkpoints in {folder} are damaged. Start over with --fresh, which "
            f"moves them aside."
        )
    return None


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

    Attributes:
        lanes: the trainings side by side.
        curves: of each lane, rows of all sessions.
        combined: rows for all lanes together; with one lane, its curve.
        stopped: name of a lane -> why it was stopped.
        seconds: that earlier sessions trained.
    """

    def __init__(
        self,
        env: Any,
        config: LearnConfig,
        agents: Agents | SideBySide,
        folder: RunFolder | None,
        lanes: Sequence[Lane] | None = None,
        writes: bool = True,
    ) -> None:
        self._env, self._config, self._agents = env, config, agents
        self._source, self._folder = folder, folder if writes else None
        self.lanes = list(lanes or lanes_of(config))
        self.curves: list[list[Row]] = [[] for _ in self.lanes]
        self.combined: list[Row] = self.curves[0] if len(self.lanes) == 1 else []
        self.stopped: dict[str, str] = {}
        self.seconds = 0.0
        self._compatibility = {
            "trainer": agents.trainer,
            "env": env.name,
            "layout": env.layout_version,
            **agents.compatibility(),
        }
        self._info = {
            "env": env.name,
            "commit": record.commit(),
            "versions": record.versions(),
            "algorithm": agents.trainer,
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
        self.combined, self.seconds = meta["curve"], meta["seconds"]
        self.curves = meta.get("curves") or [self.combined]
        self.stopped = dict(meta.get("stopped", {}))
        return found.learner, meta

    def begin(self, first_steps: int) -> None:
        """Write down the settings, and the curves as far as they are valid."""
        if self._folder:
            for folder, curve in zip(self._folders(), self.curves, strict=True):
                check_writable(folder.path)
                folder.write_curve(curve)
            self._folder.write_curve(self.combined)
            self._folder.write_config(
                self._config,
                resumed_from_step=first_steps or None,
                impl=str(getattr(self._env, "impl", self._config.impl)),
            )

    def add(self, rows: Mapping[int, Row]) -> Row:
        """Keep a row of the curve of each lane (by its index) that still learns; returns the one for all."""
        row = rows[0] if len(self.lanes) == 1 else combine_rows(list(rows.values()))
        folders = self._folders()
        for index, own in rows.items():
            self.curves[index].append(own)
            if folders:
                folders[index].add_row(own)
        if len(self.lanes) > 1:
            self.combined.append(row)
            if self._folder:
                self._folder.add_row(row)
        return row

    def policies(self, learner: Any) -> list[Policies]:
        """The policies of a learner by agent, for each lane."""
        learners = self._agents.of_seeds(to_host(learner))
        return [
            self._agents.policies(own, {**self._info, "seed": lane.seed})
            for lane, own in zip(self.lanes, learners, strict=True)
        ]

    def save(self, learner: Any, seconds: float) -> None:
        """A checkpoint, and the policies beside it.

        Args:
            learner: state to keep.
            seconds: that this session has trained.
        """
        if self._folder:
            meta = {
                "compatibility": self._compatibility,
                "curve": self.combined,
                "seconds": self.seconds + seconds,
                "config": dataclasses.asdict(self._config),
            }
            if len(self.lanes) > 1:
                meta |= {"curves": self.curves, "stopped": self.stopped}
            save_checkpoint(self._folder.checkpoints, learner, meta)
            self._save_policies(self.policies(learner))

    def _save_policies(self, policies: list[Policies]) -> None:
        for folder, own in zip(self._folders(), policies, strict=True):
            folder.save_policies(own)

    def finish(self, learner: Any) -> list[Policies]:
        """Save policies and picture; returns the policies by agent, for each lane."""
        policies = self.policies(learner)
        if self._folder:
            self._save_policies(policies)
            of = f"seed {self.lanes[0].seed}"
            if len(self.lanes) > 1:
                of = f"{self.lanes[0].name} to {self.lanes[-1].name}"
            title = f"{self._env.name}, {self._agents.trainer}, {of}"
            self._folder.draw(self.combined, title)
        return policies
