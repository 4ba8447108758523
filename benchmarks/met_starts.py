"""Episodes whose placement, as first drawn, begins inside the person who lies there: what they would do, and what they do.

    python -m benchmarks.met_starts --impl native --num-steps 2
    python -m benchmarks.met_starts --impl warp

Actions are drawn at random. "before" takes the placement that is drawn first, "now" another one that does not meet the
person, as the environment does (``sim.starts``).
"""

from __future__ import annotations

import copy
import dataclasses
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import tyro

import agym_jax
from agym_jax.errors import ArgumentError
from agym_jax.flags import Count
from agym_jax.wrappers import vectorize
from benchmarks.keep import keep

CHUNK = 8192  # episodes that are drawn at once
ROUGH = 300.0  # N


@dataclass(frozen=True)
class MetStartsConfig:
    """Flags of ``python -m benchmarks.met_starts``."""

    env_name: str = "BedBathingJaco-v0"
    """Environment id, of a task in which people lie."""
    impl: str = "auto"
    """Physics: "jax", "warp", "native", "auto"."""
    num_draws: Count = 262_144
    """Episodes among which those are looked for, rounded up to whole batches of 8,192."""
    num_steps: Count = 200
    """Control steps of each of them."""
    seed: int = 0
    """Of episodes and actions."""
    json: Path | None = None
    """File to which the result is added as a JSON line."""


def met(env: Any, blind: Any, config: MetStartsConfig) -> tuple[int, jax.Array]:
    """How many episodes were drawn, and the keys of those that draw another placement than ``blind``'s (n, 2)."""
    angles = [
        jax.jit(jax.vmap(lambda key, x=x: x._sample_episode(key)[0][2].arm_angles))
        for x in (env, blind)
    ]
    found, draws = [], -(-config.num_draws // CHUNK)
    for i in range(draws):
        keys = jax.random.split(jax.random.fold_in(jax.random.PRNGKey(config.seed), i), CHUNK)
        now, before = (np.asarray(draw(keys)) for draw in angles)
        found.append(np.asarray(keys)[np.any(now != before, axis=1)])
    return draws * CHUNK, jnp.asarray(np.concatenate(found))


def play(venv: Any, keys: jax.Array, config: MetStartsConfig) -> dict[str, Any]:
    """Play episodes with random actions; how many went NaN or were rough, and the largest force [N]."""
    reset, step = (jax.jit(x) if venv.env.physics.traceable else x for x in (venv.reset, venv.step))
    peak, nan = np.zeros(venv.num_envs), np.zeros(venv.num_envs, bool)
    state = reset(keys)
    for i in range(config.num_steps):
        key = jax.random.fold_in(jax.random.PRNGKey(config.seed), i)
        shape = (venv.num_envs, venv.action_size)
        state = step(state, jax.random.uniform(key, shape, minval=-1.0, maxval=1.0))
        peak = np.fmax(peak, np.asarray(state.metrics["force/peak_on_human"]))
        nan |= np.asarray(state.metrics["nan"]) > 0
    return {"nan": int(nan.sum()), "rough": int((peak > ROUGH).sum()), "peak": float(peak.max())}


def measure(config: MetStartsConfig) -> dict[str, Any]:
    """Look for the episodes and play them; returns the fields of the result line."""
    env = agym_jax.make(config.env_name, impl=config.impl)
    if env._starts.meets is None:
        raise ArgumentError(
            f"{config.env_name}: there is no table of whom its placements meet, because nobody lies there in a settled posture."
        )
    blind = copy.copy(env)
    blind._starts = dataclasses.replace(env._starts, meets=None)
    draws, keys = met(env, blind, config)
    fields = {
        "env": config.env_name, "impl": env.impl, "seed": config.seed, "draws": draws, "starts": len(keys),
        "num_steps": config.num_steps, "rough_above": ROUGH,
    }  # fmt: skip
    for name, starts in (("before", blind._starts), ("now", env._starts)):
        one = agym_jax.make(config.env_name, impl=config.impl, num_envs=len(keys))
        one._starts = starts
        venv = vectorize(one, len(keys))
        fields |= {f"{name}/{k}": v for k, v in play(venv, keys, config).items()}
        print(f"{name}: {len(keys)} episodes played", file=sys.stderr, flush=True)
    return fields


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; returns the exit status."""
    config = tyro.cli(MetStartsConfig, prog="python -m benchmarks.met_starts", args=arguments)
    return 0 if keep("met-starts", lambda: measure(config), config.json) else 2


if __name__ == "__main__":
    sys.exit(main())
