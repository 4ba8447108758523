"""Train and choose policies of many environments: ``agym-jax suite --only Jaco --num-seeds 8``.

Every environment gets a run with several seeds (``train``, or ``coop`` where the person acts too), then a choice
among them (``select``, over one set of people, reported over another), and a film of the chosen one (``enjoy``), as
processes of their own: one at a time on each GPU of the machine. A table and a picture of all runs are in the save
folder (``results.md``, ``curves.png``) and grow with each environment. Rerunning the same command goes on where it was
stopped: finished runs are kept, unfinished ones resumed from their checkpoint.
"""

from __future__ import annotations

import json
import math
import os
import signal
import sys
import threading
import time
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor, as_completed
from dataclasses import dataclass, field
from pathlib import Path
from queue import SimpleQueue
from typing import Annotated, Any

import tyro

import agym_jax
from agym_jax.data.npz import check_writable, write_file
from agym_jax.errors import AgymError, UnknownNameError, checked_count
from agym_jax.interrupts import raise_again
from agym_jax.registry import parse

from .configs import config_for
from .errors import ConfigError, check_save_dir
from .flags import Count, parse_count
from .runs.children import Children, claim, own_program, visible_gpus
from .runs.overview import JOURNAL, markdown, read_rows, selection_of, training_summary
from .runs.plots import plot_runs
from .runs.progress import duration

FILM = "clip.gif"
LINE_PERIOD = 60.0  # seconds between lines about the whole
TRAINING = 0.9  # share of training in the work on an environment; the rest is measuring
PATIENCE = 60.0  # seconds for a training of an earlier session to save its state and end


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
    """Folder of the runs, the logs and the results."""
    parallel: Count = 1
    """Environments trained at the same time on each GPU."""
    gpus: Count = 0
    """GPUs to spread them over, each training on one; 0 = all there are."""
    steps: tuple[str, ...] = ()
    """Steps of a seed where the trainer's default does not suit: NAME=STEPS, such as Dressing=6e6."""
    flags: str = ""
    """Further flags of train and coop: --flags="--num-envs 2048 --lr 1e-3"."""
    shipped: bool = True
    """Measure the policies that ship with agym_jax too, over the people of the report."""
    clips: bool = True
    """Film an episode of each chosen policy, on the CPU while the next environments train."""

    def __post_init__(self) -> None:
        """Refuse what means nothing, before anything is built."""
        for name in ("num_seeds", "num_episodes", "parallel"):
            checked_count(f"--{name.replace('_', '-')}", getattr(self, name))
        check_save_dir(self.save_dir)


@dataclass(frozen=True)
class Outcome:
    """What became of one environment.

    Attributes:
        env_name: its id.
        line: the selection's result; None if something failed.
        seconds: of training and choosing.
        problem: the last lines of what failed, if something did.
        kept: whether it was finished before this session.
    """

    env_name: str
    line: Mapping[str, Any] | None
    seconds: float
    problem: str = ""
    kept: bool = False


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
        gpus: names of the GPUs; none leaves the choice of devices to JAX.
        children: the processes.
        films: environment -> its film, in the making; gives the end of the log if it failed.
        slots: GPUs that are free, one entry for each process that may use one.
    """

    config: SuiteConfig
    program: tuple[str, ...] = field(default_factory=own_program)
    gpus: Sequence[str] = ()
    children: Children = field(default_factory=Children)
    films: dict[str, Future] = field(default_factory=dict)
    slots: SimpleQueue = field(default_factory=SimpleQueue)

    def __post_init__(self) -> None:
        """Fill the slots."""
        cores = os.cpu_count() or 1
        self._lock, self._filming = threading.Lock(), ThreadPoolExecutor(max(1, cores // 4))
        for _ in range(self.width):
            for gpu in self.gpus or [""]:
                self.slots.put(gpu)

    @property
    def width(self) -> int:
        """Processes on each GPU."""
        return max(1, self.config.parallel)

    def all(self, ids: Sequence[str]) -> Iterator[Outcome]:
        """What became of each environment, as soon as that is known."""
        with ThreadPoolExecutor(self.width * max(1, len(self.gpus))) as pool:
            waiting = [pool.submit(self.one, name) for name in ids]
            try:
                for done in as_completed(waiting):
                    yield done.result()
            finally:  # also where somebody stops the suite
                for future in waiting:
                    future.cancel()

    def one(self, env_name: str) -> Outcome:
        """Train, choose, and order a film."""
        start, gpu = time.perf_counter(), self.slots.get()
        try:
            outcome = self._one(env_name, gpu, start)
        finally:
            self.slots.put(gpu)
        if outcome.line and self.config.clips and not self.children.stopping:
            self.films[env_name] = self._filming.submit(self._film, env_name)
        return outcome

    def finish(self) -> dict[str, str]:
        """Wait for the films; environment -> the end of the log of those that failed."""
        failed = {name: film.result() for name, film in self.films.items()}
        self._filming.shutdown()
        return {name: problem for name, problem in failed.items() if problem}

    def _one(self, env_name: str, gpu: str, start: float) -> Outcome:
        c, run = self.config, Path(self.config.save_dir) / env_name
        if line := selection_of(run):
            return Outcome(env_name, line, time.perf_counter() - start, kept=True)
        train = [
            "coop" if parse(env_name).active else "train", "--env-name", env_name,
            "--num-seeds", str(c.num_seeds), "--save-dir", c.save_dir,
            *steps_of(c.steps, env_name), *c.flags.split(),
        ]  # fmt: skip
        result = str(run / "selection.jsonl")
        select = ["select", str(run), "--num-episodes", str(c.num_episodes), "--json", result]
        select += [] if c.shipped else ["--no-shipped"]
        environment = {"CUDA_VISIBLE_DEVICES": gpu} if gpu else {}
        if self.width > 1:
            preallocate = os.environ.get("XLA_PYTHON_CLIENT_PREALLOCATE", "false")
            environment["XLA_PYTHON_CLIENT_PREALLOCATE"] = preallocate
        for words in (train, select) if c.num_seeds > 1 else (train,):
            if problem := self._run(words, env_name, environment):
                return Outcome(env_name, None, time.perf_counter() - start, problem)
        return Outcome(env_name, selection_of(run) or {}, time.perf_counter() - start)

    def _film(self, env_name: str) -> str:
        folder = Path(self.config.save_dir)
        film = folder / env_name / FILM
        if film.is_file():
            return ""
        words = ["enjoy", "--env-name", env_name, "--load-dir", str(folder), "--clip", str(film)]
        size = ["--width", "320", "--height", "240"]
        return self._run([*words, *size], env_name, {"JAX_PLATFORMS": "cpu"}, "film.log")

    def _run(
        self, words: Sequence[str], env_name: str, environment: Mapping[str, str], log: str = "log"
    ) -> str:
        """Run one command, with its output in a log; returns the end of that if it failed."""
        path = Path(self.config.save_dir) / f"{env_name}.{log}"
        about = {"env": env_name, "command": words[0]}
        with path.open("a") as file:
            if not claim(file, PATIENCE):
                return f"Another process is working on it: the one that writes {path}."
            self._close(about, path)
            began, timer = time.time(), time.perf_counter()
            self._note({**about, "began": began, "gpu": environment.get("CUDA_VISIBLE_DEVICES")})
            print("$", *words, file=file, flush=True)
            status = self.children.run([*self.program, *words], file, environment)
        took = time.perf_counter() - timer
        self._note({**about, "ended": time.time(), "seconds": round(took, 1), "status": status})
        lines = path.read_text(errors="replace").splitlines()
        return "\n".join(lines[-5:]) or f"exit status {status}" if status else ""

    def _close(self, about: Mapping[str, Any], log: Path) -> None:
        """Note the time of a command that was killed together with the suite, up to its last words."""
        path = Path(self.config.save_dir) / JOURNAL
        rows = [row for row in read_rows(path) if about.items() <= row.items()]
        if rows and "began" in rows[-1] and log.is_file():
            seconds = round(max(0.0, log.stat().st_mtime - rows[-1]["began"]), 1)
            self._note({**about, "seconds": seconds, "status": None})

    def _note(self, row: Mapping[str, Any]) -> None:
        with self._lock, (Path(self.config.save_dir) / JOURNAL).open("a") as file:
            print(json.dumps(row), file=file, flush=True)


@dataclass
class Whole:
    """How far all environments together are.

    Attributes:
        config: flags.
        ids: environments.
        first: share that was done when this session began.
        start: when that was.
    """

    config: SuiteConfig
    ids: Sequence[str]

    def __post_init__(self) -> None:
        """Look at what is there."""
        self._known: dict[str, float] = {}
        self.start, self.first = time.perf_counter(), self.share()

    def of(self, env_name: str) -> float:
        """Share of an environment's training and measuring that is done."""
        run = Path(self.config.save_dir) / env_name
        if self._known.get(env_name) == 1.0 or selection_of(run):
            return 1.0
        rows, settings = read_rows(run / "curve.jsonl"), run / "config.json"
        if not rows:
            return 0.0
        total = json.loads(settings.read_text())["config"]["num_env_steps"]
        return TRAINING * min(1.0, rows[-1]["env_steps"] / total)

    def share(self) -> float:
        """Share of the whole that is done, where every environment counts by the steps it needs."""
        weights = {name: self._steps(name) for name in self.ids}
        self._known = {name: self.of(name) for name in self.ids}
        done = math.fsum(weights[name] * self._known[name] for name in self.ids)
        return done / math.fsum(weights.values())

    def _steps(self, env_name: str) -> float:
        named = steps_of(self.config.steps, env_name)
        return float(parse_count(named[1]) if named else config_for(env_name).num_env_steps)

    def words(self) -> str:
        """A line about the whole: what is done, what runs, and how long it may still take."""
        now = self.share()
        gone, gained = time.perf_counter() - self.start, now - self.first
        left = f", about {duration(gone * (1 - now) / gained)} left" if gained > 1e-3 else ""
        going = [f"{name} {x:.0%}" for name, x in self._known.items() if 0 < x < 1]
        finished = sum(x == 1 for x in self._known.values())
        return (
            f"    {now:4.0%} of the whole, {finished} of {len(self.ids)} finished after {duration(gone)}{left}"
            + (f"   ({', '.join(going)})" if going else "")
        )


def write_results(config: SuiteConfig, ids: Sequence[str]) -> None:
    """The table and the picture of all runs that are finished, into the save folder."""
    folder = Path(config.save_dir)
    there = [(selection_of(folder / name), training_summary(folder / name)) for name in ids]
    runs = [(selection, training) for selection, training in there if selection]
    if runs:
        write_file(folder / "results.md", markdown(runs).encode())
        plot_runs(folder / "curves.png", [training for _, training in runs if training])


def describe(outcome: Outcome) -> str:
    """A line of the table, or what failed."""
    name = f"{outcome.env_name:<28}"
    took = "finished before" if outcome.kept else duration(outcome.seconds)
    if outcome.line is None:
        return f"{name} failed after {took}:\n{outcome.problem}"
    if not outcome.line:
        return f"{name} trained in {took}"
    x = outcome.line
    gentle = f", gently {x['chosen_gentle_success']:.1%}" if "chosen_gentle_success" in x else ""
    return (
        f"{name} chosen {x['chosen_success']:6.1%}{gentle}   of {len(x['seeds'])} seeds: interquartile mean "
        f"{x['success_iqm']:6.1%}, worst {min(x['success_of_seeds']):6.1%}   {took}"
    )


def main(
    arguments: Sequence[str] | None = None,
    prog: str = f"python -m {__package__}.suite",
    program: tuple[str, ...] | None = None,
) -> int:
    """The command line; returns the exit status."""
    raise_again()
    try:
        config = tyro.cli(SuiteConfig, prog=prog, args=arguments, description=__doc__)
        ids = suite_ids(config.only)
        for name in ids:
            steps_of(config.steps, name)
        gpus = visible_gpus(config.gpus)
        check_writable(Path(config.save_dir))
    except AgymError as error:
        print(f"{type(error).__name__}: {error}", file=sys.stderr)
        return 2
    where = f"{len(gpus)} GPUs" if len(gpus) > 1 else "one device"
    print(
        f"{len(ids)} environments, {config.num_seeds} seeds each, on {where}, into {config.save_dir}",
        flush=True,
    )
    runner = Runner(config, program or own_program(), gpus)

    def stop(*_: Any) -> None:
        print("Stopping; trainings save their state ...", flush=True)
        runner.children.stop()  # first: nobody waits for a training that was not told
        raise KeyboardInterrupt

    before = [(number, signal.signal(number, stop)) for number in (signal.SIGINT, signal.SIGTERM)]
    try:
        return _run_all(config, ids, runner)
    except KeyboardInterrupt:
        runner.finish()
        print("Rerun the same command to continue.")
        return 130
    finally:
        for number, handler in before:
            signal.signal(number, handler)


def _run_all(config: SuiteConfig, ids: Sequence[str], runner: Runner) -> int:
    """Everything, with a line for each environment and one a minute for the whole; returns the exit status."""
    whole, over = Whole(config, ids), threading.Event()

    def tell() -> None:
        while not over.wait(LINE_PERIOD):
            print(whole.words(), flush=True)

    threading.Thread(target=tell, daemon=True).start()
    failed, used = 0, 0.0
    try:
        for number, outcome in enumerate(runner.all(ids), 1):
            failed += outcome.line is None
            used += 0.0 if outcome.kept else outcome.seconds
            print(f"{number:>3}/{len(ids)}  {describe(outcome)}", flush=True)
            if outcome.line:
                write_results(config, ids)
        for name, problem in runner.finish().items():
            print(f"No film of {name}:\n{problem}")
    finally:
        over.set()
    took = time.perf_counter() - whole.start
    print(
        f"{len(ids) - failed} of {len(ids)} environments in {duration(took)}; one after another, their trainings "
        f"and choices would take {duration(used)}. Results: {Path(config.save_dir) / 'results.md'}"
    )
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
