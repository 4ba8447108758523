"""Train and choose policies of many environments: ``agym-jax suite --only Jaco --num-seeds 8``.

Every environment gets a run with several seeds (``train``, or ``coop`` where the person acts too) and then a choice
among them (``select``), as processes of their own: several at a time, and spread over the GPUs of the machine.
Rerunning the same command goes on where it was stopped: finished runs are kept, unfinished ones resumed.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from queue import SimpleQueue
from typing import Annotated, Any

import tyro

import agym_jax
from agym_jax.data.npz import check_writable
from agym_jax.errors import AgymError, UnknownNameError
from agym_jax.registry import parse

from .configs import Count
from .errors import ConfigError
from .runs.progress import duration


@dataclass(frozen=True)
class SuiteConfig:
    """Flags of ``agym-jax suite``."""

    only: Annotated[tuple[str, ...], tyro.conf.arg(metavar="NAME ...")] = ()
    """Parts of ids, such as Jaco or ScratchItchPR2-v0, trained in this order; without them, all environments."""
    num_seeds: Count = 8
    """Seeds of each environment."""
    num_episodes: Count = 1000
    """Episodes over which a seed is chosen, and of others over which it is reported."""
    save_dir: str = "trained_suite"
    """Folder of the runs, the logs and the results (selections.jsonl)."""
    parallel: Count = 1
    """Environments trained at the same time on each GPU."""
    gpus: Count = 1
    """GPUs to spread them over; 0 or 1 leaves the choice of devices to JAX."""
    steps: tuple[str, ...] = ()
    """Steps of a seed where the trainer's default does not suit: NAME=STEPS, such as Dressing=6e6."""
    flags: str = ""
    """Further flags of train and coop: --flags="--num-envs 2048 --lr 1e-3"."""


@dataclass(frozen=True)
class Outcome:
    """What became of one environment.

    Attributes:
        env_name: its id.
        line: the selection's result; None if something failed.
        seconds: of training and choosing.
        problem: the last lines of what failed, if something did.
    """

    env_name: str
    line: Mapping[str, Any] | None
    seconds: float
    problem: str = ""


def suite_ids(only: Sequence[str]) -> list[str]:
    """Ids whose names contain one of the parts, in the order of the parts.

    Raises:
        UnknownNameError: a part is in no id.
    """
    ids = list(agym_jax.list_envs())
    for part in only:
        if not any(part in name for name in ids):
            raise UnknownNameError("environment", part, ids)
    found = [name for part in only or [""] for name in ids if part in name]
    return list(dict.fromkeys(found))


def steps_of(steps: Sequence[str], env_name: str) -> list[str]:
    """The flag for the steps of an environment, from the longest NAME that its id begins with.

    Raises:
        ConfigError: an entry is not NAME=STEPS.
    """
    found = ("", "")
    for entry in steps:
        name, equals, count = entry.partition("=")
        if not (name and equals and count):
            raise ConfigError(f"--steps takes NAME=STEPS, such as Dressing=6e6, got {entry!r}.")
        if env_name.startswith(name) and len(name) > len(found[0]):
            found = (name, count)
    return ["--num-env-steps", found[1]] if found[1] else []


@dataclass
class Runner:
    """Runs the processes of the suite.

    Attributes:
        config: flags.
        program: how a command of the trainer is started.
        slots: indices of GPUs that are free, one entry for each process that may use one.
    """

    config: SuiteConfig
    program: tuple[str, ...] = (sys.executable, "-m", "agym_jax")
    slots: SimpleQueue = field(default_factory=SimpleQueue)

    def __post_init__(self) -> None:
        """Fill the slots."""
        for _ in range(max(1, self.config.parallel)):
            for gpu in range(max(1, self.config.gpus)):
                self.slots.put(gpu)

    def all(self, ids: Sequence[str]) -> Iterator[Outcome]:
        """Outcomes in the order of the ids, each as soon as it and those before it are there."""
        with ThreadPoolExecutor(max(1, self.config.parallel) * max(1, self.config.gpus)) as pool:
            yield from pool.map(self.one, ids)

    def one(self, env_name: str) -> Outcome:
        """Train and choose."""
        start, gpu = time.perf_counter(), self.slots.get()
        try:
            return self._one(env_name, gpu, start)
        finally:
            self.slots.put(gpu)

    def _one(self, env_name: str, gpu: int, start: float) -> Outcome:
        c, folder = self.config, Path(self.config.save_dir)
        result = folder / env_name / "selection.jsonl"
        train = [
            "coop" if parse(env_name).active else "train", "--env-name", env_name,
            "--num-seeds", str(c.num_seeds), "--save-dir", str(folder),
            *steps_of(c.steps, env_name), *c.flags.split(),
        ]  # fmt: skip
        select = [
            "select", str(folder / env_name), "--num-episodes", str(c.num_episodes),
            "--json", str(result),
        ]  # fmt: skip
        if not result.is_file():
            for words in (train, select) if c.num_seeds > 1 else (train,):
                if problem := self._run(words, env_name, gpu):
                    return Outcome(env_name, None, time.perf_counter() - start, problem)
        line = json.loads(result.read_text().splitlines()[-1]) if result.is_file() else {}
        return Outcome(env_name, line, time.perf_counter() - start)

    def _run(self, words: Sequence[str], env_name: str, gpu: int) -> str:
        """Run one command, with its output in a log; returns the end of that if it failed."""
        log, environ = Path(self.config.save_dir) / f"{env_name}.log", dict(os.environ)
        if self.config.gpus > 1:
            environ["CUDA_VISIBLE_DEVICES"] = str(gpu)
        if self.config.parallel > 1:
            environ.setdefault("XLA_PYTHON_CLIENT_PREALLOCATE", "false")
        with log.open("a") as file:
            print("$", *words, file=file, flush=True)
            done = subprocess.run(
                [*self.program, *words], stdout=file, stderr=subprocess.STDOUT, env=environ
            )
        return "" if done.returncode == 0 else "\n".join(log.read_text().splitlines()[-5:])


def describe(outcome: Outcome) -> str:
    """A line of the table, or what failed."""
    name, took = f"{outcome.env_name:<28}", duration(outcome.seconds)
    if outcome.line is None:
        return f"{name} failed after {took}:\n{outcome.problem}"
    if not outcome.line:
        return f"{name} trained in {took}"
    x = outcome.line
    return (
        f"{name} chosen {x['chosen_success']:6.1%}   of {len(x['seeds'])} seeds: interquartile mean "
        f"{x['success_iqm']:6.1%}, worst {min(x['success_of_seeds']):6.1%}   {took}"
    )


def main(
    arguments: Sequence[str] | None = None, prog: str = f"python -m {__package__}.suite"
) -> int:
    """The command line; returns the exit status."""
    config = tyro.cli(SuiteConfig, prog=prog, args=arguments, description=__doc__)
    try:
        ids = suite_ids(config.only)
        for name in ids:
            steps_of(config.steps, name)
        check_writable(Path(config.save_dir))
    except AgymError as error:
        print(f"{type(error).__name__}: {error}", file=sys.stderr)
        return 2
    failed = 0
    print(
        f"{len(ids)} environments, {config.num_seeds} seeds each, into {config.save_dir}",
        flush=True,
    )
    for number, outcome in enumerate(Runner(config).all(ids), 1):
        failed += outcome.line is None
        print(f"{number:>3}/{len(ids)}  {describe(outcome)}", flush=True)
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
