"""The result of a training run, and its one-line summary."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from agym_jax.policy.policy import Policy

from ..configs import LearnConfig
from .curve import Row
from .progress import duration


@dataclass(frozen=True)
class SeedResult:
    """The result of one seed of a run.

    Attributes:
        name: name of its folder.
        seed: the seed.
        policies: the trained policies by agent: "robot", "human", or "joint" for both together.
        curve: rows of the learning curve, from all sessions.
        stopped: why it was stopped before the others; empty if it was not.
    """

    name: str
    seed: int
    policies: Mapping[str, Policy]
    curve: list[Row]
    stopped: str = ""


@dataclass(frozen=True)
class TrainResult:
    """The result of a run.

    Attributes:
        seeds: the results of its seeds; if it was stopped before one candidate of each was chosen, of all candidates.
        learner: the learner, to continue in Python.
        config: settings with all automatic values filled in.
        curve: rows of the learning curve, from all sessions; with several seeds, those of ``combine_rows``.
        env_steps: environment steps of each seed, over all sessions.
        session_steps: environment steps of all seeds, and of their candidates, in this session.
        compile_seconds: time for tracing and compilation.
        train_seconds: training time of this session, including logging and saving.
        nan_steps: steps of this session in which an environment became non-finite.
        interrupted: whether the run was stopped by Ctrl-C, SIGTERM or ``on_log`` before the end.
        folder: folder of the files; None if nothing was written.
        unsaved: why the end of the run could not be saved, for example because the disk is full; empty if it was saved.
        saved_steps: environment steps of the newest checkpoint.
        of_candidates: whether it was stopped before one candidate of each seed was chosen.
    """

    seeds: list[SeedResult]
    learner: Any
    config: LearnConfig
    curve: list[Row]
    env_steps: int
    session_steps: int
    compile_seconds: float
    train_seconds: float
    nan_steps: int
    interrupted: bool
    folder: Path | None
    unsaved: str = ""
    saved_steps: int = 0
    of_candidates: bool = False

    @property
    def policies(self) -> Mapping[str, Policy]:
        """The policies by agent; those of the first seed if there are several."""
        return self.seeds[0].policies

    @property
    def policy(self) -> Policy:
        """The robot's policy, or the joint policy; that of the first seed if there are several."""
        return next(iter(self.policies.values()))

    @property
    def steps_per_second(self) -> float:
        """Environment steps per second of training, excluding compilation."""
        return self.session_steps / max(self.train_seconds, 1e-9)

    def after(self, before: TrainResult) -> TrainResult:
        """Return this result with the steps and times of an earlier part of the session added."""
        added = ("session_steps", "compile_seconds", "train_seconds", "nan_steps")
        sums = {name: getattr(self, name) + getattr(before, name) for name in added}
        return replace(self, **sums)

    def last(self, name: str) -> float | None:
        """Return the last known value of a column of the curve."""
        row = self.last_row(name)
        return None if row is None else row[name]

    def last_row(self, name: str) -> Row | None:
        """Return the last row of the curve in which a column is known."""
        return next((row for row in reversed(self.curve) if row.get(name) is not None), None)


def unsaved(result: TrainResult) -> str:
    """Say that the end of a run is not on disk."""
    return (
        f"SaveFolderError: The end of this run is not on disk: {result.unsaved}. Make room and rerun the same "
        f"command, which continues from step {result.saved_steps:,}."
    )


def summary(result: TrainResult) -> str:
    """Summarise the result in one line, and say where the files are."""

    def shown(name: str, form: str) -> str:
        value = result.last(name)
        return "unknown" if value is None else format(value, form)

    config = result.config
    word = "stopped at" if result.interrupted else "trained"
    nan = f", {result.nan_steps} environment steps went NaN" if result.nan_steps else ""
    seeds, spread, gentle = "", "", ""
    if result.last("gentle") is not None:
        gentle = f", gentle {shown('gentle', '.0%')}"
    if len(result.seeds) > 1:
        kind = "candidates" if result.of_candidates else "seeds"
        seeds = f" with each of {len(result.seeds)} {kind}"
        spread = f" ({shown('success_min', '.0%')} to {shown('success_max', '.0%')})"
    ended = result.last_row("return")  # the last one in which episodes ended
    older = ended and ended["env_steps"] < result.env_steps
    at = f" (at step {ended['env_steps']:,})" if older else ""
    measured = "too few for an episode that began in this run to end"
    if ended:
        measured = (
            f"return {shown('return', '.1f')}, success {shown('success', '.0%')}{spread}{gentle}, force "
            f"{shown('force', '.2f')} N{at}"
        )
    text = (
        f"{config.env_name}: {word} {result.env_steps:,} steps{seeds}, {measured}{nan}. Compiled in "
        f"{duration(result.compile_seconds)}, trained {result.session_steps:,} steps "
        f"in {duration(result.train_seconds)} ({result.steps_per_second:,.0f} steps/s)."
    )
    for seed in result.seeds:
        text += f"\n{seed.name} was stopped: it diverged {seed.stopped}." if seed.stopped else ""
    if result.folder:
        text += f"\n{_files(result, result.folder)}"
    return text


def _files(result: TrainResult, folder: Path) -> str:
    """Say where the files are; and, at the end of a run with several seeds, how to choose one."""
    if len(result.seeds) == 1:
        what = "Policy" if len(result.policies) == 1 else "Policies"
        return f"{what}, curve.png, curve.jsonl, checkpoints: {folder}"
    if result.of_candidates:
        return f"curve.png, curve.jsonl, checkpoints of the candidates: {folder}"
    run = folder / "SETTING" if "/" in result.seeds[0].name else folder  # one of a sweep's, or all
    text = f"curve.png, curve.jsonl, checkpoints: {folder}; each seed's policy: {run / 'seed_N'}"
    if result.interrupted or result.unsaved:
        return text
    return f"{text}\nChoose a seed: agym-jax select {run}"
