"""How XLA compiles for tests: quickly. Most tests run a program for a few steps only, so that compiling it takes most of their time."""

from __future__ import annotations

import os
from importlib.metadata import version
from typing import Any

import jax

KNOWN = {
    "": "--xla_backend_optimization_level=0",
    # others may lack one of these, and an unknown flag ends the process
    "0.10.2": "--xla_backend_optimization_level=0 --xla_llvm_disable_expensive_passes=true "
    "--xla_cpu_use_fusion_emitters=false --xla_cpu_parallel_codegen_split_count=1 "
    "--xla_cpu_experimental_ynn_fusion_type= --xla_cpu_multi_thread_eigen=false",
}
"""Beginning of a version of jaxlib -> flags; together they halve the time of tests/sim/test_parity.py and tests/matter/test_cloth.py (118 to 61 s of CPU time)."""


FRAMES = "jax_traceback_in_locations_limit"
"""Frames of Python that each operation is given when JAX lowers it. One, not ten: an eighth less CPU time in tests/train/test_learner.py and test_seeds.py (56.6 to 49.7 s)."""
RUN_QUICKLY: Any = {"xla_backend_optimization_level": 3}
"""Options of a ``jax.jit`` for a small program that runs for minutes of simulated time."""


def compile_quickly() -> None:
    """Set ``XLA_FLAGS`` and ``FRAMES`` of this process and of those that it starts, unless they are set."""
    flags = max((x for x in KNOWN if version("jaxlib").startswith(x)), key=len)
    os.environ.setdefault("XLA_FLAGS", KNOWN[flags])
    jax.config.update(FRAMES, int(os.environ.setdefault(FRAMES.upper(), "1")))


def with_devices(count: int) -> dict[str, str]:
    """Environment variables of a process with several CPU devices."""
    flags = f"{os.environ.get('XLA_FLAGS', '')} --xla_force_host_platform_device_count={count}"
    return {"XLA_FLAGS": flags.strip(), "JAX_PLATFORMS": "cpu"}
