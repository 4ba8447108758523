"""Checkpoints: the whole learner in one file, so that an interrupted run resumes as if nothing had happened.

A checkpoint holds every leaf of the learner (networks, optimiser, statistics, random key, step
count, from which the learning rate follows) under its path in the tree, and a record of what it
fits with the learning curve so far. It is restored onto a learner of the right shape. The
environments are not saved: a resumed run begins with fresh episodes.
"""

from __future__ import annotations

import dataclasses
import json
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from agym_jax.changes import describe, flags_of
from agym_jax.data.npz import read_npz, write_npz
from agym_jax.errors import DamagedFileError
from agym_jax.policy.networks import Architecture

from ..configs import LearnConfig
from ..errors import CheckpointMismatchError, CheckpointWarning

FORMAT = 2
KEEP = 3
UNIMPORTANT = (
    "save_dir", "fresh", "log_interval", "save_interval", "devices", "hosts", "logger", "num_candidates", "candidates_until",
)  # fmt: skip
"""Settings whose changes are not told; of the last two, ``train.runs.candidates`` tells."""


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


def _file(folder: Path, steps: int) -> Path:
    return folder / f"step_{steps:012d}.npz"


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
    path = _file(folder, steps_of(learner))
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
    theirs: dict[str, Any] = {"changes": {}, **meta["compatibility"]}
    trainer = compatibility.get("trainer", theirs.get("trainer"))
    if theirs.get("trainer") != trainer:
        raise CheckpointMismatchError(
            f"{path} belongs to a run of train.{theirs.get('trainer')}, but this is train.{trainer}. Continue it "
            f"with agym-jax {theirs.get('trainer')}, choose another --save-dir, or start over "
            f"with --fresh (which moves the old run aside)."
        )
    found = {name: _told(theirs, name) for name in compatibility}
    others = [
        name
        for name, value in compatibility.items()
        if name not in ("changes", "lanes") and found[name] != value
    ]
    differ = [f"{name} is {found[name]!r}, this run has {compatibility[name]!r}" for name in others]
    advice = _network_flags({name: found[name] for name in others}) + advice
    if theirs.get("lanes") != compatibility.get("lanes"):
        trained, here = (_trainings(x.get("lanes")) for x in (theirs, compatibility))
        differ.append(f"it is of {trained}, this run of {here}")
    if changed := describe(theirs["changes"], compatibility.get("changes", {}), "in the run"):
        differ.append(changed)
    if differ:
        raise CheckpointMismatchError(f"{path} does not fit: {'; '.join(differ)}. {advice}")
    try:
        return Checkpoint(path, arrays_to_tree(arrays, template), meta)
    except CheckpointMismatchError as error:
        raise CheckpointMismatchError(f"{path} does not fit: {error}. {advice}") from None


def _told(compatibility: Mapping[str, Any], name: str) -> Any:
    """What a checkpoint says of a name; an option of networks that came after it is at the default of ``Architecture``."""
    return compatibility.get(name, getattr(Architecture, name.rpartition(".")[2], None))


def _network_flags(found: Mapping[str, Any]) -> str:
    """Say which flags make the networks of a checkpoint, of what differs ("robot.value_hidden" -> sizes); "" if none does."""
    named = ((*name.rpartition(".")[::2], value) for name, value in found.items())
    settings = {
        setting: value for agent, setting, value in named if agent and hasattr(LearnConfig, setting)
    }
    return f"Its networks were made with {flags_of(settings)}. " if settings else ""


def _trainings(lanes: Sequence[str] | None) -> str:
    """Say how many trainings go on side by side, and which; None is one."""
    return "1 training" if lanes is None else f"{len(lanes)} trainings ({', '.join(lanes)})"


def load_newest(folder: Path, template: Any, compatibility: Mapping[str, Any]) -> Checkpoint | None:
    """The newest checkpoint that is whole; damaged ones are skipped with a ``CheckpointWarning``.

    Args:
        folder: where checkpoints lie; it may not exist.
        template: learner of the right structure.
        compatibility: see ``load_checkpoint``.

    Returns:
        The checkpoint, or None if there is none in which something has been learned.

    Raises:
        DamagedFileError: there are checkpoints, and all are damaged.
        CheckpointMismatchError: the newest whole one belongs to something else.
    """
    # that of step 0 only says that a run has begun, with settings that may change: nothing has been learned
    files = [path for path in checkpoint_files(folder) if path != _file(folder, 0)]
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


def say_resumed(
    say: Callable[[str], None], meta: Mapping[str, Any], config: Any, steps: int
) -> None:
    """Say where a run goes on, and which settings differ from before.

    Args:
        say: is told.
        meta: of the checkpoint.
        config: dataclass of the settings now.
        steps: environment steps of the checkpoint.
    """
    say(f"Continuing from step {steps:,} with fresh episodes (--fresh starts over).")
    ours, theirs = json.loads(json.dumps(dataclasses.asdict(config))), meta.get("config", {})
    for name, value in ours.items():
        if name not in UNIMPORTANT and name in theirs and theirs[name] != value:
            say(f"  {name} is now {value!r}; it was {theirs[name]!r}.")
