"""Runs the processes of a suite: training, choosing and filming, a number of environments at a time on each GPU."""

from __future__ import annotations

import json
import os
import shlex
import threading
import time
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor, as_completed
from dataclasses import dataclass, field
from pathlib import Path
from queue import SimpleQueue
from typing import Any

from agym_jax.changes import flags_of
from agym_jax.data.npz import append_line
from agym_jax.memory import MEMORY
from agym_jax.policy.check import meant_for
from agym_jax.policy.files import run_file
from agym_jax.policy.policy import read_policy
from agym_jax.registry import parse

from ..runs.overview import JOURNAL, read_rows, selection_of
from .children import Children, claim, own_program
from .plan import SuiteConfig, flags_for, least_for, steps_for

FILM = "clip.gif"
PATIENCE = 60.0  # seconds for a training of an earlier session to save its state and end


@dataclass(frozen=True)
class Outcome:
    """What became of one environment.

    Attributes:
        env_name: its id.
        line: the selection's result; None if something failed.
        seconds: of training and choosing.
        problem: the last lines of what failed, if something did.
        kept: how it was finished, if that was before this session.
    """

    env_name: str
    line: Mapping[str, Any] | None
    seconds: float
    problem: str = ""
    kept: str = ""


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
        except OSError as error:  # such as a full disk; the other environments go on
            problem = f"{type(error).__name__}: {error}"
            outcome = Outcome(env_name, None, time.perf_counter() - start, problem)
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
        run, commands = Path(self.config.save_dir) / env_name, self._commands(env_name)
        if line := selection_of(run):
            kept = self._finished(env_name, commands)
            return Outcome(env_name, line, time.perf_counter() - start, kept=kept)
        environment = {"CUDA_VISIBLE_DEVICES": gpu} if gpu else {}
        if self.width > 1:
            preallocate = os.environ.get("XLA_PYTHON_CLIENT_PREALLOCATE", "false")
            environment["XLA_PYTHON_CLIENT_PREALLOCATE"] = preallocate
        for words in commands:
            if problem := self._run(words, env_name, environment):
                return Outcome(env_name, None, time.perf_counter() - start, problem)
        return Outcome(env_name, selection_of(run) or {}, time.perf_counter() - start)

    def _commands(self, env_name: str) -> list[list[str]]:
        """What is run for an environment: training, and with several seeds the choice among them."""
        c, run = self.config, Path(self.config.save_dir) / env_name
        steps = steps_for(c, env_name)
        train = [
            "coop" if parse(env_name).active else "train", "--env-name", env_name,
            "--num-seeds", str(c.num_seeds), "--save-dir", c.save_dir,
            *(["--num-env-steps", steps] if steps else []), *flags_for(c, env_name),
        ]  # fmt: skip
        select = ["select", str(run), "--num-episodes", str(c.num_episodes)]
        select += [] if c.shipped else ["--no-shipped"]
        select += ["--default-settings"] if c.default_settings else []
        select += ["--by", c.by] if c.by != "auto" else []
        least = least_for(c, env_name)
        select += ["--at-least", *least] if least else []
        return [train, select] if c.num_seeds > 1 else [train]

    def _finished(self, env_name: str, commands: Sequence[Sequence[str]]) -> str:
        """How an environment was finished before: by these commands, or by others, which its log tells."""
        log = self._log(env_name)
        told = log.read_text(errors="replace").splitlines() if log.is_file() else []
        if all(_line(words) in told for words in commands):
            return "finished before"
        return f"finished before, with other arguments ({log})"

    def _film(self, env_name: str) -> str:
        folder = Path(self.config.save_dir)
        film = folder / env_name / FILM
        if film.is_file():
            return ""
        words = ["enjoy", "--env-name", env_name, "--load-dir", str(folder), "--clip", str(film)]
        size = ["--width", "320", "--height", "240"]
        words += [*size, *_settings_of(run_file(folder / env_name, "robot"))]
        return self._run(words, env_name, {"JAX_PLATFORMS": "cpu"}, "film.log")

    def _run(
        self, words: Sequence[str], env_name: str, environment: Mapping[str, str], log: str = "log"
    ) -> str:
        """Run one command, with its output in a log; returns the end of that if it failed."""
        path = self._log(env_name, log)
        about = {"env": env_name, "command": words[0]}
        with path.open("a") as file:
            if not claim(file, PATIENCE):
                return f"Another process is working on it: the one that writes {path}."
            self._close(about, path)
            began, timer = time.time(), time.perf_counter()
            self._note({**about, "began": began, "gpu": environment.get("CUDA_VISIBLE_DEVICES")})
            print(_line(words), file=file, flush=True)
            status = self.children.run([*self.program, *words], file, environment)
        took = time.perf_counter() - timer
        self._note({**about, "ended": time.time(), "seconds": round(took, 1), "status": status})
        lines = path.read_text(errors="replace").splitlines()
        return "\n".join(lines[-5:]) or f"exit status {status}" if status else ""

    def _log(self, env_name: str, kind: str = "log") -> Path:
        return Path(self.config.save_dir) / f"{env_name}.{kind}"

    def _close(self, about: Mapping[str, Any], log: Path) -> None:
        """Note the time of a command that was killed together with the suite, up to its last words."""
        path = Path(self.config.save_dir) / JOURNAL
        rows = [row for row in read_rows(path) if about.items() <= row.items()]
        if rows and "began" in rows[-1] and log.is_file():
            seconds = round(max(0.0, log.stat().st_mtime - rows[-1]["began"]), 1)
            self._note({**about, "seconds": seconds, "status": None})

    def _note(self, row: Mapping[str, Any]) -> None:
        with self._lock:
            append_line(Path(self.config.save_dir) / JOURNAL, json.dumps(row))


def _line(words: Sequence[str]) -> str:
    """The line of a log that begins what a command prints."""
    return f"$ {' '.join(words)}"


def _settings_of(policy: Path) -> list[str]:
    """Flags of the settings that a policy is for, but for its memory, which it brings along; none if it does not exist."""
    meant = meant_for(read_policy(policy).info) if policy.is_file() else {}
    return shlex.split(flags_of({name: x for name, x in meant.items() if name != MEMORY}))
