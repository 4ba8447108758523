"""Runs that are killed again and again: what is lost, and whether they end as runs that were stopped cleanly do.

    python -m benchmarks.kills --kills 100 --folder /tmp/kills --json benchmarks/results/kills.jsonl

Trains, and evaluates what was trained, by the commands that a user gives, and kills these processes at random moments:
while they import, compile, train, write and evaluate. The same command is given again after each kill. What is on disk
is checked every time. At the end each run is repeated in one process that stops at the same checkpoints without being
killed: policy and curve must be the same, bit by bit. (A resumed run has fresh episodes, so it differs from one that
was never stopped.)

Goes on where it was if ``--folder`` has an unfinished measurement; ``--minutes`` ends a session of it.
"""

from __future__ import annotations

import dataclasses
import json
import os
import random
import signal
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import tyro

from agym_jax.data.npz import PART, read_npz
from benchmarks.child import ChildError
from benchmarks.keep import keep
from train.configs import Count, PPOConfig, config_for
from train.envs import make_env
from train.ppo import train
from train.runs.checkpoint import checkpoint_files
from train.runs.folder import RunFolder

SIGNALS = (signal.SIGKILL,) * 3 + (signal.SIGTERM, signal.SIGINT)
PROGRAM = (sys.executable, "-m", "agym_jax")
WRITING = 0.25
"""Share of the kills that wait for a file that is being written."""
PATIENCE = 5.0
"""Seconds [s] that they wait; files are written within milliseconds, and may be missed."""
TIMES = ("seconds", "steps_per_second")
"""Columns of a curve that no two runs share."""
Row = dict[str, Any]


@dataclass(frozen=True)
class KillsConfig:
    """Flags of ``python -m benchmarks.kills``."""

    folder: Path
    """Where the runs are made."""
    env_name: str = "ReachingJaco-v0"
    """Environment id, on C MuJoCo."""
    kills: Count = 100
    """How many in all."""
    kills_of_a_run: Count = 20
    """After which a run is left alone until it is complete."""
    num_env_steps: Count = 24_000
    """Environment steps of a run."""
    num_envs: Count = 8
    """Environments."""
    interval: Count = 3
    """Updates between two log lines, and between two checkpoints."""
    session: float = 15.0
    """Seconds [s]: a process is killed at a moment between 0 and this; about twice what it takes to begin."""
    minutes: float = 1e9
    """When to leave the rest to the next session."""
    seed: int = 1
    """Of the first run, and of the moments."""
    json: Path | None = None
    """File to which the result is added as a JSON line."""


def environment() -> dict[str, str]:
    """Variables of the processes: the settings are those of a CPU."""
    return {**os.environ, "JAX_PLATFORMS": "cpu"}


def settings(config: KillsConfig, seed: int, folder: Path) -> PPOConfig:
    """Of a run, in Python."""
    return dataclasses.replace(
        config_for(config.env_name, platform="cpu"),
        impl="native", seed=seed, save_dir=str(folder), num_env_steps=config.num_env_steps, num_envs=config.num_envs,
        log_interval=config.interval, save_interval=config.interval, policy_hidden=(16,), value_hidden=(16,),
        ppo_epoch=2, num_mini_batch=2, logger=("tensorboard",),
    )  # fmt: skip


def commands(config: KillsConfig, seed: int, folder: Path) -> list[list[str]]:
    """Of a run, on the command line: train, then evaluate."""
    s = settings(config, seed, folder)
    flags = {
        name: getattr(s, name)
        for name in ("impl", "seed", "save_dir", "num_env_steps", "num_envs", "log_interval", "save_interval",
                     "policy_hidden", "value_hidden", "ppo_epoch", "num_mini_batch", "logger")
    }  # fmt: skip
    words = ["--env-name", config.env_name]
    for name, value in flags.items():
        values = value if isinstance(value, tuple) else (value,)
        words += [f"--{name.replace('_', '-')}", *map(str, values)]
    measure = ["--env-name", config.env_name, "--load-dir", str(folder), "--impl", "native"]
    measure += ["--num-episodes", "8", "--json", str(folder / "evaluation.jsonl")]
    return [["train", *words], ["evaluate", *measure]]


@dataclass
class Disk:
    """What a run has on disk.

    Attributes:
        config: flags.
        folder: of the run.
    """

    config: KillsConfig
    folder: RunFolder

    @property
    def batch(self) -> int:
        """Steps between two rows of the curve."""
        return self.config.interval * self.config.num_envs * PPOConfig.num_steps

    def rows(self) -> list[Row]:
        """The curve.

        Raises:
            ValueError: a line is not whole.
        """
        path = self.folder.curve
        return (
            [json.loads(line) for line in path.read_text().splitlines()] if path.is_file() else []
        )

    def parts(self) -> list[Path]:
        """Files that are being written, or were when a process was killed."""
        folders = (self.folder.path, self.folder.checkpoints)
        return [part for folder in folders for part in folder.glob(f".*{PART}")]

    def saved(self) -> int:
        """Steps of the newest checkpoint."""
        files = checkpoint_files(self.folder.checkpoints)
        return int(files[0].stem.removeprefix("step_")) if files else 0

    def faults(self) -> list[str]:
        """What is wrong with it: damaged files, rows that are missing, doubled, or others than in the checkpoint."""
        found, rows = [], self.rows()
        steps = [row["env_steps"] for row in rows]
        if steps != [min((i + 1) * self.batch, self.total) for i in range(len(steps))]:
            found.append(f"rows of steps {steps}")
        for path in checkpoint_files(self.folder.checkpoints):
            kept = read_npz(path)[1]["curve"]
            if rows[: len(kept)] != kept:
                found.append(f"{path.name} has another curve")
        policy = self.folder.path / "policy.npz"
        if policy.is_file() and read_npz(policy)[1]["env_steps"] > self.saved():
            found.append("the policy is newer than the checkpoint")
        return found

    @property
    def total(self) -> int:
        """Steps of the whole run."""
        batch = self.config.num_envs * PPOConfig.num_steps
        return -(-self.config.num_env_steps // batch) * batch


def wait_for(process: subprocess.Popen, seconds: float, writing: Callable[[], Any] | None) -> bool:
    """Wait for a moment, and then, if asked, for a file that is being written; whether the process still runs."""
    deadline = time.monotonic() + seconds
    while process.poll() is None and time.monotonic() < deadline:
        time.sleep(0.005)
    deadline = time.monotonic() + PATIENCE
    while process.poll() is None and writing and time.monotonic() < deadline and not writing():
        time.sleep(0)  # a file is there for a millisecond
    return process.poll() is None


def one_kill(words: Sequence[str], disk: Disk, delay: float, chance: random.Random) -> Row | None:
    """Start a command, kill it, and look at what is left; None if it was finished before.

    Raises:
        ChildError: it failed by itself, or left something that is not whole.
    """
    folder = disk.folder.path.parent
    before, rows_before = disk.saved(), len(disk.rows())
    sent = chance.choice(SIGNALS)
    writing = chance.random() < WRITING and words[0] == "train"
    said_path = folder / "said.txt"
    with said_path.open("w") as said:
        process = subprocess.Popen(
            [*PROGRAM, *words], stdout=said, stderr=subprocess.STDOUT, env=environment()
        )
        try:
            alive = wait_for(process, delay, disk.parts if writing else None)
            process.send_signal(sent)
            status = process.wait(timeout=120)
        finally:
            process.kill()
    text = said_path.read_text()
    if not alive or (status == 0 and sent != signal.SIGKILL):
        if status:
            raise ChildError(f"{words[0]} failed ({status}):\n{text[-2000:]}")
        return None
    faults = disk.faults()
    if faults:
        raise ChildError(f"After {sent.name}: {'; '.join(faults)}")
    rows, saved = disk.rows(), disk.saved()
    phase = "starting"
    if words[0] == "evaluate":
        phase = "evaluating"
    elif disk.parts():
        phase = "writing"
    elif "steps/s" in text or saved > before:
        phase = "training"
    lost = rows[-1]["env_steps"] - saved if rows and phase != "starting" else 0
    return {
        "signal": sent.name, "phase": phase, "status": status, "from": before, "saved": saved, "lost": lost,
        "traceback": "Traceback" in text, "rows": [rows_before, len(rows)], "delay": round(delay, 2),
    }  # fmt: skip


def stopped_cleanly(
    config: KillsConfig, seed: int, stops: Sequence[int], folder: Path
) -> RunFolder:
    """The same run in this process, which stops at the same checkpoints and is never killed."""
    env, wanted = make_env(config.env_name, "native"), settings(config, seed, folder)
    for stop in [*stops, None]:
        train(env, wanted, on_log=lambda row, policy, stop=stop: row["env_steps"] == stop)
    return RunFolder(str(folder), config.env_name)


def differences(one: RunFolder, other: RunFolder) -> list[str]:
    """In what policies and curves of two runs differ; times do not count."""
    arrays = [read_npz(x.path / "policy.npz")[0] for x in (one, other)]
    found = [name for name in arrays[0] if not np.array_equal(arrays[0][name], arrays[1][name])]
    curves = [
        [{k: v for k, v in json.loads(line).items() if k not in TIMES} for line in x.curve.read_text().splitlines()]
        for x in (one, other)
    ]  # fmt: skip
    return found + (["curve"] if curves[0] != curves[1] else [])


def logged_otherwise(folder: RunFolder) -> list[str]:
    """Columns of the curve that TensorBoard reads otherwise from the run's log."""
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

    read = EventAccumulator(str(folder.path / "tensorboard"))
    read.Reload()
    rows, found = [json.loads(line) for line in folder.curve.read_text().splitlines()], []
    for name in rows[0].keys() - {"env_steps"}:
        wanted = [(x["env_steps"], np.float32(x[name])) for x in rows if x[name] is not None]
        tag = name if "/" in name else f"train/{name}"
        there = tag in read.Tags()["scalars"]
        have = [(x.step, np.float32(x.value)) for x in read.Scalars(tag)] if there else []
        found += [f"log of {name}"] if have != wanted else []
    return found


def finish(words: Sequence[str], folder: Path) -> None:
    """Give a command once more, and let it end.

    Raises:
        ChildError: it failed.
    """
    found = subprocess.run([*PROGRAM, *words], capture_output=True, text=True, env=environment())
    (folder / "said.txt").write_text(found.stdout + found.stderr)
    if found.returncode:
        raise ChildError(f"{words[0]} failed:\n{(found.stdout + found.stderr)[-2000:]}")


def one_run(
    config: KillsConfig, state: Row, save: Callable[[], None], over: Callable[[], bool]
) -> None:
    """Kill a run until it has had its share, let it finish, and compare it; returns early when time is over."""
    seed = state["seed"]
    folder = config.folder / f"run_{seed}"
    folder.mkdir(parents=True, exist_ok=True)
    disk = Disk(config, RunFolder(str(folder), config.env_name))
    for words in commands(config, seed, folder):
        while not over():
            mine = [x for x in state["kills"] if x["run"] == seed]
            share = config.kills_of_a_run - (2 if words[0] == "train" else 0)
            if len(mine) >= share or len(state["kills"]) >= config.kills:
                break
            chance = random.Random(1000 * config.seed + len(state["kills"]))
            kill = one_kill(words, disk, chance.uniform(0.0, config.session), chance)
            if kill is None:
                break
            state["kills"].append({"run": seed, **kill})
            save()
            print(len(state["kills"]), kill, flush=True)
        if over():
            return
        finish(words, folder)
    faults = disk.faults() + [str(x) for x in disk.parts()]
    if faults or disk.saved() != disk.total or len(disk.rows()) != -(-disk.total // disk.batch):
        raise ChildError(f"Run {seed} is not whole at its end: {faults}")
    lines = (folder / "evaluation.jsonl").read_text().splitlines()
    evaluated = [json.loads(line)["env"] for line in lines]
    stops = sorted({x["saved"] for x in state["kills"] if x["run"] == seed} - {0, disk.total})
    clean = stopped_cleanly(config, seed, stops, config.folder / f"clean_{seed}")
    differ = differences(disk.folder, clean) + logged_otherwise(disk.folder)
    state["runs"].append(
        {"run": seed, "stops": stops, "differ": differ, "evaluated": len(evaluated)}
    )
    state["seed"] += 1
    save()
    print(f"run {seed}: stopped at {stops}, differs in {differ or 'nothing'}", flush=True)


def measure(config: KillsConfig) -> Row | None:
    """The fields of a result; None if the session ended before all kills were made.

    Raises:
        ChildError: something was lost, or failed.
    """
    path, deadline = config.folder / "state.json", time.monotonic() + 60 * config.minutes
    config.folder.mkdir(parents=True, exist_ok=True)
    state: Row = {"seed": config.seed, "kills": [], "runs": []}
    if path.is_file():
        state = json.loads(path.read_text())

    def save() -> None:
        path.write_text(json.dumps(state))

    def over() -> bool:
        return time.monotonic() > deadline

    while not over() and (
        len(state["kills"]) < config.kills or state["kills"][-1]["run"] == state["seed"]
    ):
        one_run(config, state, save, over)
    kills = state["kills"]
    if len(kills) < config.kills or kills[-1]["run"] == state["seed"]:
        return None
    disk = Disk(config, RunFolder("", config.env_name))
    return {
        "env": config.env_name,
        "impl": "native",
        "kills": len(kills),
        "signals": Counter(x["signal"] for x in kills),
        "phases": Counter(x["phase"] for x in kills),
        "runs": len(state["runs"]),
        "steps": disk.total,
        "interval": disk.batch,
        "lost_most": max(x["lost"] for x in kills),
        "lost_most_interrupted": max(
            (x["lost"] for x in kills if x["signal"] != "SIGKILL"), default=0
        ),
        "tracebacks": sum(x["traceback"] for x in kills),
        "differing_runs": sum(bool(x["differ"]) for x in state["runs"]),
    }


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; returns the exit status, 3 if there is more to do."""
    config = tyro.cli(KillsConfig, prog="python -m benchmarks.kills", args=arguments)
    # what a shell starts in the background ignores SIGINT, and so would the processes that are to be killed by it
    signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        fields = measure(config)
    except ChildError as error:
        print(error, file=sys.stderr)
        return 2
    if fields is None:
        return 3
    return 2 if keep("kills", lambda: fields, config.json) is None else 0


if __name__ == "__main__":
    sys.exit(main())
