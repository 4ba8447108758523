"""What PyTorch's tensors cost: steps of ``TorchVectorEnv`` beside those of the same batch in its own loop.

    python -m benchmarks.torch_overhead --num-envs 4096 --json benchmarks/results/torch_overhead.jsonl

Both loops run in Python, one call a step, with the same actions, in turn; the loop without PyTorch calls the (compiled) ``step`` of
``agym_jax.wrappers.vectorize``, as a user of JAX would, and reads nothing. On a GPU this needs a PyTorch with CUDA beside JAX's, on one GPU:
XLA_PYTHON_CLIENT_PREALLOCATE=false leaves memory to it.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jax
import numpy as np
import tyro

from agym_jax.errors import checked_count
from benchmarks.keep import keep

WARM_UPS = 4
"""Runs of each loop before the first that counts: programs are compiled, kernels loaded, and Warp captures a CUDA graph for every
set of buffers that it meets (over 100 in the first runs of ScratchItchJaco, which once made the loop without PyTorch the slower one)."""


@dataclass(frozen=True)
class OverheadConfig:
    """Flags of ``python -m benchmarks.torch_overhead``."""

    env_name: str = "ReachingJaco-v0"
    """Environment id."""
    impl: str = "auto"
    """Physics: "native" on a CPU, "warp" or "jax" on a GPU."""
    num_envs: int = 256
    """Environments side by side."""
    steps: int = 50
    """Of every environment in one measurement."""
    repeats: int = 10
    """Measurements of each loop; the median of their ratios counts."""
    seed: int = 0
    """Of environments and actions."""
    json: Path | None = None
    """File to which the result is added as a JSON line."""


def measure(config: OverheadConfig) -> dict[str, Any]:
    """Fields of the result line.

    Raises:
        AgymError: PyTorch is missing or cannot use the device, or there is no such environment.
    """
    for name in ("num_envs", "steps", "repeats"):
        checked_count(f"--{name.replace('_', '-')}", getattr(config, name))
    from agym_jax.adapters.torch import TorchVectorEnv, torch

    envs = TorchVectorEnv(config.env_name, config.num_envs, config.impl)
    size = config.num_envs, envs.action_space.shape[0]
    actions = np.random.default_rng(config.seed).uniform(-1, 1, (config.steps, *size))
    tensors = torch.tensor(actions, dtype=torch.float32, device=envs.device)
    arrays = [envs.array(tensor) for tensor in tensors]
    envs.reset(config.seed)
    batch, native = envs.envs, envs.core.impl == "native"
    step = batch.step if native else jax.jit(batch.step)

    def plain() -> Iterator[None]:
        state = envs.state
        for array in arrays:
            state = step(state, array)
        yield
        jax.block_until_ready(state.obs)

    def in_torch() -> Iterator[None]:
        for tensor in tensors:
            envs.step(tensor)
        yield
        if envs.device.type == "cuda":
            torch.cuda.synchronize(envs.device)

    loops = plain, in_torch
    for loop in loops * WARM_UPS:
        list(loop())
    # repeats, loops, (until the calls have returned, until they are done) [s]
    seconds = np.array([[_seconds(loop()) for loop in loops] for _ in range(config.repeats)])
    whole = seconds[..., 1]
    ratios = whole[:, 1] / whole[:, 0]
    speeds = config.steps * config.num_envs / np.median(whole, 0)
    # of the calling thread, which may return before a step is done [ms]
    calls = 1e3 * np.median(seconds[..., 0], 0) / config.steps
    return {
        "env": config.env_name,
        "impl": envs.core.impl,
        "num_envs": config.num_envs,
        "steps": config.steps,
        "repeats": config.repeats,
        "steps_per_s": round(speeds[0]),
        "steps_per_s_torch": round(speeds[1]),
        "call_ms": round(float(calls[0]), 3),
        "call_ms_torch": round(float(calls[1]), 3),
        "overhead_percent": round(100 * float(np.median(ratios) - 1), 2),
        "overhead_percent_min": round(100 * float(ratios.min() - 1), 2),
        "overhead_percent_max": round(100 * float(ratios.max() - 1), 2),
        "torch": str(torch.__version__),
    }


def _seconds(loop: Iterator[None]) -> tuple[float, float]:
    """Until a loop has made its calls, and until what they started is done [s]."""
    began = time.perf_counter()
    next(loop)
    called = time.perf_counter() - began
    next(loop, None)
    return called, time.perf_counter() - began


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; returns the exit status."""
    config = tyro.cli(OverheadConfig, prog="python -m benchmarks.torch_overhead", args=arguments)
    return 0 if keep("torch_overhead", lambda: measure(config), config.json) else 2


if __name__ == "__main__":
    sys.exit(main())
