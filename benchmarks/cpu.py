"""How one environment feels on a CPU: first step cold and warm, then speed, alone and in 64 environments.

    python -m benchmarks.cpu --json benchmarks/results/cpu.jsonl

"Cold" is a fresh process with an empty compilation cache, "warm" a fresh process with the cache that
the cold one filled. Times count from the start of the process, Python's own start and imports
included. One environment is stepped as people do who look at it, through Gymnasium, on C MuJoCo; the fields
that begin with ``mjx`` are one environment on MJX-JAX, whose ``reset`` and ``step`` are compiled whole.
"""

from __future__ import annotations

import os
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import tyro

from benchmarks.child import run_child
from benchmarks.keep import keep

STEPS = 1000  # after the first, for the speed
NATIVE = """
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
MJX = """
import sys, time
import jax, jax.numpy as jnp, agym_jax
began, name, steps = float(sys.argv[1]), sys.argv[2], int(sys.argv[3])
env = agym_jax.make(name, impl="jax")
reset, step = env.jit_functions()
state = jax.block_until_ready(reset(jax.random.PRNGKey(0)))
at_reset = time.time()
action = jnp.full(env.action_size, 0.1)
state = jax.block_until_ready(step(state, action))
at_step = time.time()
for _ in range(steps):
    state = step(state, action)
jax.block_until_ready(state)
print([at_reset - began, at_step - began, steps / (time.time() - at_step)])
"""
BATCH = """
import json, sys
from benchmarks.throughput import measure
print(json.dumps(measure(sys.argv[1], "jax", int(sys.argv[2]), 100, 5, 0)))
"""


@dataclass(frozen=True)
class CpuConfig:
    """Flags of ``python -m benchmarks.cpu``."""

    env_name: str = "ScratchItchJaco-v0"
    """Environment id."""
    num_envs: int = 64
    """Environments side by side."""
    json: Path | None = None
    """File to which the result is added as a JSON line."""


def measure_one(code: str, env_name: str) -> dict[str, float]:
    """One environment, cold and warm.

    Args:
        code: of a process that prints the seconds to the first state and to the first step, and steps/s.
        env_name: environment id.
    """
    with tempfile.TemporaryDirectory() as cache:
        cold, warm = (
            run_child(code, repr(time.time()), env_name, str(STEPS), AGYM_JAX_CACHE=cache)
            for _ in range(2)
        )
    return {
        "cold_reset_seconds": round(cold[0], 2),
        "cold_step_seconds": round(cold[1], 2),
        "warm_reset_seconds": round(warm[0], 2),
        "warm_step_seconds": round(warm[1], 2),
        "single_steps_per_s": round(warm[2]),
    }


def measure(env_name: str, num_envs: int) -> dict[str, Any]:
    """All processes, one after the other; returns the fields of the result line."""
    load = os.getloadavg()[0]
    one = measure_one(NATIVE, env_name)
    mjx = measure_one(MJX, env_name)
    batch = run_child(BATCH, env_name, str(num_envs), AGYM_JAX_CACHE="off")
    counted = (
        "steps_per_s", "steps_per_s_min", "steps_per_s_max", "compile_seconds", "nan", "overflow",
    )  # fmt: skip
    return {
        "env": env_name,
        "impl": "native",
        **one,
        **{f"mjx_{name}": value for name, value in mjx.items()},
        "num_envs": num_envs,
        "batch_impl": "jax",
        **{name: batch[name] for name in counted},
        "load_before": round(load, 2),
    }


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; returns the exit status."""
    config = tyro.cli(CpuConfig, prog="python -m benchmarks.cpu", args=arguments)
    os.environ["JAX_PLATFORMS"] = "cpu"  # for the children, and for the record, which asks JAX
    fields = keep("cpu", lambda: measure(config.env_name, config.num_envs), config.json)
    return 2 if fields is None else 0


if __name__ == "__main__":
    sys.exit(main())
