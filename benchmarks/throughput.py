"""Control steps per second of the whole environment under random actions, resets included.

    python -m benchmarks.throughput --impl jax warp --num-envs 1024 4096 16384

Every configuration runs in a process of its own, without JAX's compilation cache: compile time and
memory are its own. The environments are staggered, so some episode ends and resets in every step. NaN
environments are counted; a lost contact (overflow) makes the run fail.
"""

from __future__ import annotations

import statistics
import subprocess
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jax
import tyro

from agym_jax.errors import AgymError
from benchmarks.rollout import (
    CHUNK,
    first_state,
    make_batch,
    peak_memory_mb,
    run_steps,
    zero_totals,
)
from train.runs.record import append_record, record


@dataclass(frozen=True)
class ThroughputConfig:
    """Flags of ``python -m benchmarks.throughput``."""

    env_name: tuple[str, ...] = ("ScratchItchJaco-v0",)
    """Environment ids."""
    impl: tuple[str, ...] = ("auto",)
    """Physics: "jax", "warp", "auto"."""
    num_envs: tuple[int, ...] = (1024, 4096, 16384)
    """Environments side by side."""
    steps: int = 500
    """Steps of every environment in one measurement, rounded up to whole calls of 50 if it is more."""
    repeats: int = 5
    """Measurements; the median counts."""
    seed: int = 0
    """Of environments and actions."""
    json: Path | None = None
    """File to which each result is added as a JSON line."""


def measure(
    env_name: str, impl: str, num_envs: int, steps: int, repeats: int, seed: int
) -> dict[str, Any]:
    """One configuration in this process.

    Args:
        env_name: environment id.
        impl: physics.
        num_envs: environments.
        steps: of every environment in one measurement.
        repeats: measurements.
        seed: of environments and actions.

    Returns:
        Fields of the result line.
    """
    jax.config.update("jax_enable_compilation_cache", False)
    key, key_reset = jax.random.split(jax.random.PRNGKey(seed))
    chunk = min(steps, CHUNK)
    chunks = -(-steps // chunk)
    start = time.perf_counter()
    venv = make_batch(env_name, impl, num_envs)
    begin = jax.jit(lambda key: first_state(venv, key)).lower(key_reset).compile()
    state, totals = begin(key_reset), zero_totals()
    run = jax.jit(run_steps(venv, steps=chunk)).lower(state, key, totals).compile()
    compiled = time.perf_counter()
    state, totals = jax.block_until_ready(run(state, key, totals))  # Warp loads its kernels here
    warm = time.perf_counter()
    speeds = []
    for repeat in range(repeats):
        began = time.perf_counter()
        for call in range(chunks):
            key_call = jax.random.fold_in(key, 1 + repeat * chunks + call)
            state, totals = run(state, key_call, totals)
        jax.block_until_ready((state, totals))
        speeds.append(chunks * chunk * num_envs / (time.perf_counter() - began))
    total_steps = (repeats * chunks + 1) * chunk * num_envs
    return {
        "env": env_name,
        "impl": venv.impl,
        "num_envs": num_envs,
        "steps": chunks * chunk,
        "repeats": repeats,
        "seed": seed,
        "compile_seconds": round(compiled - start, 2),
        "first_call_seconds": round(warm - compiled, 2),
        "steps_per_s": round(statistics.median(speeds)),
        "steps_per_s_min": round(min(speeds)),
        "steps_per_s_max": round(max(speeds)),
        "nan": int(totals["nan"]),
        "overflow": int(totals["overflow"]),
        "episodes": int(totals["episodes"]),
        "reward_per_step": float(totals["reward"]) / total_steps,
        "peak_memory_mb": peak_memory_mb(),
    }


def shown(line: dict[str, Any]) -> str:
    """The result for people."""
    memory = line["peak_memory_mb"]
    return (
        f"{line['env']} {line['impl']:<4} {line['num_envs']:>6} environments: "
        f"{line['steps_per_s']:>9,} steps/s "
        f"({line['steps_per_s_min']:,} to {line['steps_per_s_max']:,} in "
        f"{line['repeats']}), compiled in {line['compile_seconds']:.0f} s, first call "
        f"{line['first_call_seconds']:.1f} s, NaN {line['nan']}, overflow {line['overflow']}"
        + (f", {memory:,.0f} MB" if memory else "")
    )


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; returns the exit status, 1 if a configuration failed."""
    c = tyro.cli(ThroughputConfig, prog="python -m benchmarks.throughput", args=arguments)
    if min(c.steps, c.repeats, *c.num_envs) < 1:
        print("--steps, --repeats and --num-envs must be at least 1.", file=sys.stderr)
        return 2
    wanted = [(e, i, n) for e in c.env_name for i in c.impl for n in c.num_envs]
    if len(wanted) == 1:
        try:
            fields = measure(*wanted[0], c.steps, c.repeats, c.seed)
        except AgymError as error:
            print(f"{type(error).__name__}: {error}", file=sys.stderr)
            return 2
        print(shown(fields), flush=True)
        if c.json:
            append_record(c.json, record("throughput", **fields))
        if fields["overflow"]:
            print("Failed: contacts were lost; this speed does not count.", file=sys.stderr)
        return 1 if fields["overflow"] else 0
    failed = 0
    for env_name, impl, num_envs in wanted:
        command = [sys.executable, "-m", "benchmarks.throughput", "--env-name", env_name]
        command += ["--impl", impl, "--num-envs", str(num_envs), "--steps", str(c.steps)]
        command += ["--repeats", str(c.repeats), "--seed", str(c.seed)]
        command += ["--json", str(c.json)] if c.json else []
        status = subprocess.run(command).returncode
        if status:
            print(f"{env_name} {impl} {num_envs}: exit status {status}", file=sys.stderr)
        failed += status != 0
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
