"""What a killed run loses: nothing but the steps after its last checkpoint.

    python -m benchmarks.resume --env-name ReachingJacoHuman-v0 --num-env-steps 4e5

Trains with several seeds. Then trains with the first seed again, kills that process (SIGKILL) on its way, gives the
same command once more, and compares where it ends with where the unbroken runs end.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import tyro

from agym_jax.flags import Count
from agym_jax.policy.check import train_command
from benchmarks.child import ChildError
from benchmarks.keep import keep
from train.runs.folder import RunFolder

LATEST = 0.1  # share of the curve that says how a run ends
Row = dict[str, Any]


@dataclass(frozen=True)
class ResumeConfig:
    """Flags of ``python -m benchmarks.resume``."""

    env_name: str = "ReachingJacoHuman-v0"
    """Environment id; one whose person acts too is trained by train.coop."""
    num_env_steps: Count = 400_000
    """Environment steps of a run."""
    seeds: Count = 3
    """How many unbroken runs."""
    kill_at: float = 0.5
    """Share of the steps after which the broken run is killed."""
    impl: str = "auto"
    """Physics: "jax", "warp", "auto"."""
    json: Path | None = None
    """File to which the result is added as a JSON line."""


def start(config: ResumeConfig, seed: int, folder: Path) -> subprocess.Popen:
    """Start training in another process; what it says goes to a file in ``folder``."""
    flags = {"impl": config.impl, "num-env-steps": config.num_env_steps, "seed": seed, "save-dir": folder}  # fmt: skip
    words = [word for name, value in flags.items() for word in (f"--{name}", str(value))]
    command = [
        sys.executable,
        "-m",
        "agym_jax",
        *train_command(config.env_name).split()[1:],
        *words,
    ]
    folder.mkdir(exist_ok=True)
    with (folder / "said.txt").open("a") as said:
        return subprocess.Popen(command, stdout=said, stderr=subprocess.STDOUT)


def finish(process: subprocess.Popen, folder: Path) -> None:
    """Wait for a run.

    Raises:
        ChildError: it failed; with the end of what it said.
    """
    if process.wait():
        raise ChildError(f"Training failed:\n{(folder / 'said.txt').read_text()[-2000:]}")


def curve(config: ResumeConfig, folder: Path) -> list[Row]:
    """The learning curve so far; a line that is still being written is left out."""
    path = RunFolder(str(folder), config.env_name).curve
    lines = path.read_text().split("\n")[:-1] if path.is_file() else []
    return [json.loads(line) for line in lines]


def end(rows: Sequence[Row]) -> dict[str, float]:
    """Mean return and success of the last rows that saw an episode end.

    Raises:
        ChildError: none did.
    """
    seen = [row for row in rows if row["return"] is not None]
    if not seen:
        raise ChildError("No episode ended; use a higher --num-env-steps or --kill-at.")
    last = seen[-max(1, round(LATEST * len(seen))) :]
    return {name: sum(row[name] for row in last) / len(last) for name in ("return", "success")}


def broken(config: ResumeConfig, seed: int, folder: Path) -> tuple[int, int]:
    """Train, kill on the way, and train on.

    Returns:
        The last step that the killed process wrote down, and the step from which the next went on.

    Raises:
        ChildError: a run failed, or ended before it could be killed.
    """
    process = start(config, seed, folder)
    try:
        while process.poll() is None:
            rows = curve(config, folder)
            if rows and rows[-1]["env_steps"] >= config.kill_at * config.num_env_steps:
                break
            time.sleep(0.05)
        else:
            finish(process, folder)
            raise ChildError("The run ended before it could be killed; use a lower --kill-at.")
    finally:
        process.kill()
        process.wait()
    killed_at = curve(config, folder)[-1]["env_steps"]
    finish(start(config, seed, folder), folder)
    about = json.loads((folder / config.env_name / "config.json").read_text())
    return killed_at, about["resumed_from_step"] or 0


def measure(config: ResumeConfig) -> Row:
    """The fields of a result: how each unbroken run ends, and the broken one.

    Raises:
        ChildError: a run failed.
    """
    unbroken = []
    with tempfile.TemporaryDirectory() as scratch:
        for seed in range(1, config.seeds + 1):
            folder = Path(scratch) / f"seed{seed}"
            finish(start(config, seed, folder), folder)
            unbroken.append(end(curve(config, folder)))
            print(f"seed {seed}: {unbroken[-1]}", flush=True)
        folder = Path(scratch) / "broken"
        killed_at, resumed_from = broken(config, 1, folder)
        rows = curve(config, folder)
    found = end(rows)
    print(f"seed 1, killed at {killed_at:,}, resumed from {resumed_from:,}: {found}", flush=True)
    return {
        "env": config.env_name,
        "steps": rows[-1]["env_steps"],
        "unbroken": unbroken,
        "broken": found,
        "killed_at": killed_at,
        "resumed_from": resumed_from,
        "before": end([row for row in rows if row["env_steps"] <= resumed_from]),
    }


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; returns the exit status."""
    config = tyro.cli(ResumeConfig, prog="python -m benchmarks.resume", args=arguments)
    return 2 if keep("resume", lambda: measure(config), config.json) is None else 0


if __name__ == "__main__":
    sys.exit(main())
