"""Control steps per second of Assistive Gym v0.1 on its own engine, with random actions, resets included.

    python -m benchmarks.assistive_gym_speed ScratchItchJaco-v0 --processes 2 --machine NAME --json benchmarks/results/cpu.jsonl

Run it with the Python in which Assistive Gym was built (CONTRIBUTING.md says how) and its folder on the Python path; of
agym_jax it needs this folder alone, from whose parent it is run. Assistive Gym runs one environment in a process, so there is a process for each core.
``--machine`` is as in ``benchmarks.cpu``, so that both are compared.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import os
import subprocess
import time
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from benchmarks.in_assistive_gym import EPISODE_LENGTH, make_env, parse, reset


def episodes(task: str, robot: str, count: int, seed: int) -> tuple[float, float, float]:
    """Whole episodes in this process.

    Returns:
        Seconds that passed, seconds of CPU time, and of the latter those for resets.
    """
    env, random = make_env(task, robot), np.random.default_rng(seed)
    reset(env, seed)  # the first one reads files
    resets, cpu, start = 0.0, time.process_time(), time.perf_counter()
    for episode in range(count):
        begun = time.process_time()
        reset(env, 1000 * seed + episode)
        resets += time.process_time() - begun
        for _ in range(EPISODE_LENGTH):
            env.step(random.uniform(-1.0, 1.0, env.action_space.shape))
    return time.perf_counter() - start, time.process_time() - cpu, resets


def commit() -> str | None:
    """Git commit of this checkout; None outside of one."""
    git = ["git", "-C", str(Path(__file__).parent), "rev-parse", "HEAD"]
    return subprocess.run(git, capture_output=True, text=True).stdout.strip() or None


def main() -> None:
    """Measure, and print or keep the line."""
    flags = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    flags.add_argument("env_name")
    flags.add_argument("--processes", type=int, default=2)
    flags.add_argument("--num-episodes", type=int, default=10, help="of each process")
    flags.add_argument("--machine", required=True, help="name of this machine in the tables")
    flags.add_argument("--json", type=Path, help="file that a line with the result is appended to")
    given = flags.parse_args()
    task, robot = parse(given.env_name)
    load = round(os.getloadavg()[0], 2)
    jobs = [(task, robot, given.num_episodes, 1 + seed) for seed in range(given.processes)]
    with multiprocessing.get_context("spawn").Pool(given.processes) as pool:
        times = pool.starmap(episodes, jobs)
    passed, cpu, resets = (np.array(x) for x in zip(*times, strict=True))
    steps = given.num_episodes * EPISODE_LENGTH
    line = {
        "kind": "cpu", "measured": "speed", "env": given.env_name, "impl": "assistive-gym", "commit": commit(),
        "num_envs": given.processes, "steps": steps * given.processes,
        "steps_per_s": round(float(np.sum(steps / passed))),
        "cpu_steps_per_s": round(steps * given.processes / float(cpu.sum())),
        "reset_seconds": round(float(resets.mean()) / given.num_episodes, 3),
        "machine": given.machine, "load_before": load,
        "device": {"platform": "cpu", "kind": given.machine, "cpu_cores": given.processes},
        "time": datetime.now(UTC).isoformat(timespec="seconds"),
    }  # fmt: skip
    print(json.dumps(line, indent=1))
    if given.json:
        with given.json.open("a") as file:
            file.write(json.dumps(line, sort_keys=True) + "\n")


if __name__ == "__main__":
    main()
