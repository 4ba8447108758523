"""How one environment feels on a CPU: first step cold and warm, then speed, alone and in 64 worlds.

    python -m benchmarks.cpu --json benchmarks/results/cpu.jsonl

"Cold" is a fresh process with an empty compilation cache, "warm" a fresh process with the cache that
the cold one filled. Times count from the start of the process, imports included.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import tyro

from agym_jax.errors import AgymError

FIRST_STEP = """
import time
start = time.perf_counter()
import json, sys
import jax, jax.numpy as jnp, agym_jax
env = agym_jax.make(sys.argv[1], impl="jax")
reset, step = jax.jit(env.reset), jax.jit(env.step)
state = jax.block_until_ready(reset(jax.random.PRNGKey(0)))
at_reset = time.perf_counter()
action = jnp.full(env.action_size, 0.1)
state = jax.block_until_ready(step(state, action))
at_step = time.perf_counter()
for _ in range(300):
    state = step(state, action)
jax.block_until_ready(state)
speed = 300 / (time.perf_counter() - at_step)
print(json.dumps([at_reset - start, at_step - start, speed]))
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
    """Worlds side by side."""
    json: Path | None = None
    """File to which the result is added as a JSON line."""


class ChildError(AgymError, RuntimeError):
    """A measuring process that failed."""


def _child(code: str, *arguments: str, cache: str) -> Any:
    """What a fresh process prints as JSON in its last line."""
    environment = {**os.environ, "AGYM_JAX_CACHE": cache, "JAX_PLATFORMS": "cpu"}
    done = subprocess.run(
        [sys.executable, "-c", code, *arguments], capture_output=True, text=True, env=environment
    )
    if done.returncode:
        raise ChildError(f"A measuring process failed:\n{done.stderr[-2000:]}")
    return json.loads(done.stdout.strip().splitlines()[-1])


def measure(env_name: str, num_envs: int) -> dict[str, Any]:
    """All three processes, one after the other; returns the fields of the result line."""
    with tempfile.TemporaryDirectory() as cache:
        cold = _child(FIRST_STEP, env_name, cache=cache)
        warm = _child(FIRST_STEP, env_name, cache=cache)
    batch = _child(BATCH, env_name, str(num_envs), cache="off")
    return {
        "env": env_name,
        "impl": "jax",
        "cold_reset_seconds": round(cold[0], 2),
        "cold_step_seconds": round(cold[1], 2),
        "warm_reset_seconds": round(warm[0], 2),
        "warm_step_seconds": round(warm[1], 2),
        "single_steps_per_s": round(warm[2]),
        "num_envs": num_envs,
        "steps_per_s": batch["steps_per_s"],
        "steps_per_s_min": batch["steps_per_s_min"],
        "steps_per_s_max": batch["steps_per_s_max"],
        "compile_seconds": batch["compile_seconds"],
        "nan": batch["nan"],
        "overflow": batch["overflow"],
    }


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; returns the exit status."""
    config = tyro.cli(CpuConfig, prog="python -m benchmarks.cpu", args=arguments)
    os.environ["JAX_PLATFORMS"] = "cpu"  # before the record asks JAX for its device
    from train.record import append_record, record

    try:
        fields = measure(config.env_name, config.num_envs)
    except ChildError as error:
        print(error, file=sys.stderr)
        return 2
    print("\n".join(f"{name:<24} {value}" for name, value in fields.items()))
    if config.json:
        append_record(config.json, record("cpu", **fields))
    return 0


if __name__ == "__main__":
    sys.exit(main())
