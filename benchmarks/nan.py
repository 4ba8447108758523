"""Does the physics ever break? A hundred million steps: NaN, lost contacts, force peaks.

python -m benchmarks.nan --impl warp --num-envs 16384
python -m benchmarks.nan --policy shipped --env-name FeedingJaco-v0
python -m benchmarks.nan --policy shipped --env-name BedBathingSawyer-v0 --memory 0.3 4

An interrupt (Ctrl-C) ends the search; the result then is that of the steps made so far.
"""

from __future__ import annotations

import math
import signal
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import jax
import jax.numpy as jnp
import numpy as np
import tyro

import agym_jax
from agym_jax.flags import Count
from benchmarks.keep import keep
from benchmarks.rollout import CHUNK, first_state, make_batch, run_steps, zero_totals

FORCES = ("force/on_human", "force/tool", "force/peak_on_human")
LOWEST, DECADES, PER_DECADE = 1e-3, 8, 400  # bins of 0.6 % from 1 mN on
BINS = DECADES * PER_DECADE


@dataclass(frozen=True)
class NanConfig:
    """Flags of ``python -m benchmarks.nan``."""

    env_name: str = "ScratchItchJaco-v0"
    """Environment id."""
    impl: str = "auto"
    """Physics: "jax", "warp", "auto"."""
    num_envs: Count = 16_384
    """Environments side by side."""
    policy: Literal["random", "shipped"] = "random"
    """Actions: drawn at random, or by the mode of the policy that ships."""
    memory: tuple[float, ...] = ()
    """Time constants of the memory [s]: with the shipped policy, the one with this memory."""
    num_steps: Count = 100_000_000
    """Steps in all, rounded up."""
    seed: int = 0
    """Of environments and actions."""
    json: Path | None = None
    """File to which the result is added as a JSON line."""


def bin_of(force: jax.Array) -> jax.Array:
    """Bin of a force [N]; 0 is everything below ``LOWEST``, the last everything above."""
    place = jnp.log10(jnp.maximum(force, LOWEST) / LOWEST) * PER_DECADE
    return jnp.clip(place, 0, BINS - 1).astype(jnp.int32)


def force_of_bin(number: int) -> float:
    """Upper end of a bin [N]."""
    return LOWEST * 10 ** ((number + 1) / PER_DECADE)


def percentile(counts: np.ndarray, share: float) -> float:
    """Force [N] below which a share of all steps lies, to the width of a bin; 0 in the first."""
    number = int(np.searchsorted(np.cumsum(counts), share * counts.sum()))
    return 0.0 if number == 0 else force_of_bin(number)


def add_forces(totals: dict[str, jax.Array], state: Any) -> dict[str, jax.Array]:
    """Maximum and histogram of each force."""
    out = dict(totals)
    for name in FORCES:
        force = state.metrics[name]
        out[f"{name}/max"] = jnp.maximum(out[f"{name}/max"], jnp.max(force))
        out[f"{name}/counts"] = out[f"{name}/counts"].at[bin_of(force)].add(1)
    return out


@contextmanager
def noted_interrupt() -> Iterator[Callable[[], bool]]:
    """Note the first interrupt; what is yielded says whether there was one. The second is as usual.

    An exception would not do: raised in a function that Warp has registered with XLA, it ends the process.
    """
    noted = False
    before = signal.getsignal(signal.SIGINT)

    def note(*_: object) -> None:
        nonlocal noted
        noted = True
        signal.signal(signal.SIGINT, before)

    signal.signal(signal.SIGINT, note)
    try:
        yield lambda: noted
    finally:
        signal.signal(signal.SIGINT, before)


def search(config: NanConfig) -> dict[str, Any]:
    """Run all steps; returns the fields of the result line."""
    key, key_reset = jax.random.split(jax.random.PRNGKey(config.seed))
    venv = make_batch(config.env_name, config.impl, config.num_envs, config.memory)
    act = None if config.policy == "random" else agym_jax.load_policy(config.env_name, venv.env)
    state = jax.jit(lambda key: first_state(venv, key))(key_reset)
    empty = {f"{name}/max": jnp.zeros(()) for name in FORCES}
    empty |= {f"{name}/counts": jnp.zeros(BINS, jnp.int32) for name in FORCES}
    empty |= zero_totals()
    run = jax.jit(run_steps(venv, add_forces, act=act)).lower(state, key, empty).compile()
    chunks = math.ceil(config.num_steps / (CHUNK * config.num_envs))
    sums: dict[str, Any] = {}
    start = said = time.perf_counter()
    done = 0
    with noted_interrupt() as stop:
        while done < chunks and not (done and stop()):
            state, totals = run(state, jax.random.fold_in(key, done), empty)
            totals = jax.device_get(totals)
            done += 1
            for name, value in totals.items():
                new = np.asarray(
                    value, np.int64 if np.issubdtype(value.dtype, np.integer) else None
                )
                old = sums.get(name, np.zeros_like(new))
                sums[name] = np.maximum(old, new) if name.endswith("/max") else old + new
            if time.perf_counter() - said > 10:
                said = time.perf_counter()
                print(f"{done / chunks:4.0%}  NaN {sums['nan']}", file=sys.stderr, flush=True)
    seconds = time.perf_counter() - start
    forces = {}
    for name in FORCES:
        forces[f"{name}/max"] = float(sums[f"{name}/max"])
        highest = percentile(sums[f"{name}/counts"], 0.9999)
        forces[f"{name}/p99.99"] = min(highest, forces[f"{name}/max"])
    return {
        "env": config.env_name,
        "impl": venv.impl,
        "num_envs": config.num_envs,
        "policy": config.policy,
        **({"memory": " ".join(f"{time:g}" for time in config.memory)} if config.memory else {}),
        "total_steps": done * CHUNK * config.num_envs,
        "seed": config.seed,
        "nan": int(sums["nan"]),
        "overflow": int(sums["overflow"]),
        "episodes": int(sums["episodes"]),
        "seconds": round(seconds, 1),
        **forces,
    }


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; returns the exit status, 1 if contacts were lost."""
    config = tyro.cli(NanConfig, prog="python -m benchmarks.nan", args=arguments)
    fields = keep("nan", lambda: search(config), config.json)
    return 2 if fields is None else 1 if fields["overflow"] else 0


if __name__ == "__main__":
    sys.exit(main())
