"""How fast environments are on a CPU: steps of many side by side, training, and how soon the first step comes.

    taskset -c 0,1 python -m benchmarks.cpu --json benchmarks/results/cpu.jsonl

Everything runs on the cores that this process may use, and each figure comes from a process of its own:

- ``speed``: control steps/s of a batch with random actions, resets included, on C MuJoCo (``native``) and on MJX (``jax``).
- ``training``: steps/s of ``train.ppo``, acting and learning included.
- ``latency``: seconds from the start of the process, Python's own start and imports included, to the first state and
  the first step of one environment; "cold" with an empty compilation cache, "warm" with the one that the cold start filled.
  One environment is stepped as people do who look at it, through Gymnasium, on C MuJoCo.

``cpu_steps_per_s`` is steps per second of CPU time, on all cores together: other programs change it less than the time that
passes. Assistive Gym's own speed is measured by ``benchmarks.assistive_gym_speed``.
"""

from __future__ import annotations

import os
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import tyro

from agym_jax.errors import checked_count
from agym_jax.tasks import TASKS
from benchmarks.child import run_child
from benchmarks.keep import keep

STEPS = 1000  # of one environment, after the first
UPDATES = 10  # of a training
LATENCY = """
import sys, time
import gymnasium, numpy as np, agym_jax
began, name, steps = float(sys.argv[1]), sys.argv[2], int(sys.argv[3])
env = gymnasium.make(name)
assert env.unwrapped.core.impl == "native"
env.reset(seed=0)
at_reset = time.time()
action = np.full(env.action_space.shape, 0.1, np.float32)
env.step(action)
at_step = time.time()
for i in range(steps):
    if env.step(action)[3]:
        env.reset()
print([at_reset - began, at_step - began, steps / (time.time() - at_step)])
"""
SPEED = """
import json, sys
from benchmarks.cpu_speed import speed
print(json.dumps(speed(sys.argv[1], sys.argv[2], int(sys.argv[3]), float(sys.argv[4]))))
"""
TRAINING = """
import json, sys
from benchmarks.cpu_speed import training
print(json.dumps(training(sys.argv[1], sys.argv[2], int(sys.argv[3]))))
"""
Measured = Literal["speed", "training", "latency"]


@dataclass(frozen=True)
class CpuConfig:
    """Flags of ``python -m benchmarks.cpu``."""

    env_name: tuple[str, ...] = tuple(f"{task}Jaco-v0" for task in TASKS)
    """Environment ids."""
    measure: tuple[Measured, ...] = ("speed", "training")
    """What to measure of each."""
    impl: tuple[Literal["native", "jax"], ...] = ("native", "jax")
    """Physics whose speed is measured; training and latency are measured on C MuJoCo."""
    num_envs: tuple[int, ...] = (64, 256)
    """Environments side by side."""
    seconds: float = 10.0
    """How long the steps of a batch are counted [s], in three parts."""
    machine: str = ""
    """Name of this machine in the tables; by default that of its CPU. Lines of one machine are compared."""
    json: Path | None = None
    """File to which each result is added as a JSON line."""

    def __post_init__(self) -> None:
        """Refuse what means nothing, before anything is built."""
        for count in self.num_envs:
            checked_count("--num-envs", count)


def latency(env_name: str) -> dict[str, Any]:
    """One environment, cold and warm: seconds to the first state and to the first step, and steps/s."""
    with tempfile.TemporaryDirectory() as cache:
        cold, warm = (
            run_child(LATENCY, repr(time.time()), env_name, str(STEPS), AGYM_JAX_CACHE=cache)
            for _ in range(2)
        )
    return {
        "env": env_name,
        "impl": "native",
        "cold_reset_seconds": round(cold[0], 2),
        "cold_step_seconds": round(cold[1], 2),
        "warm_reset_seconds": round(warm[0], 2),
        "warm_step_seconds": round(warm[1], 2),
        "single_steps_per_s": round(warm[2]),
    }


def _lines(config: CpuConfig) -> Iterator[tuple[str, Any]]:
    """What is measured, and the function that does so, one after the other."""
    for name in config.env_name:
        if "latency" in config.measure:
            yield "latency", lambda name=name: latency(name)
        if "speed" in config.measure:
            for impl in config.impl:
                for count in config.num_envs:
                    words = (name, impl, str(count), str(config.seconds))
                    yield "speed", lambda words=words: run_child(SPEED, *words)
        if "training" in config.measure:
            words = (name, "native", str(UPDATES))
            yield "training", lambda words=words: run_child(TRAINING, *words)


def _kept(measured: str, measure: Any, config: CpuConfig) -> Mapping[str, Any] | None:
    """One line, with the load that other programs made before."""
    from train.runs.record import device  # asks JAX

    about = {"machine": config.machine or device()["kind"]}
    about["load_before"] = round(os.getloadavg()[0], 2)
    return keep("cpu", lambda: {"measured": measured, **measure(), **about}, config.json)


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; returns the exit status."""
    config = tyro.cli(CpuConfig, prog="python -m benchmarks.cpu", args=arguments)
    os.environ["JAX_PLATFORMS"] = "cpu"  # for the children, and for the record, which asks JAX
    kept = [_kept(measured, measure, config) for measured, measure in _lines(config)]
    return 2 if None in kept else 0


if __name__ == "__main__":
    sys.exit(main())
