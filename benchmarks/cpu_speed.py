"""Steps per second on a CPU, in this process: see ``benchmarks.cpu``."""

from __future__ import annotations

import statistics
import time
from typing import Any

import jax
import numpy as np

from agym_jax.jax_settings import enable_compilation_cache
from benchmarks.rollout import make_batch
from benchmarks.training_speed import TrainingSpeedConfig
from benchmarks.training_speed import measure as measure_training
from train.envs import is_native
from train.learning.execution import StepwiseEnv

PARTS = 3
"""Of the measurement; the median counts."""


def speed(env_name: str, impl: str, num_envs: int, seconds: float) -> dict[str, Any]:
    """A batch with random actions.

    The environments are staggered, so some begin anew in every step. A step is called from Python, as training does.

    Args:
        env_name: environment id.
        impl: "native" or "jax".
        num_envs: environments.
        seconds: how long steps are counted, at least one in each part.
    """
    enable_compilation_cache()
    begun = time.perf_counter()
    venv = make_batch(env_name, impl, num_envs)
    venv = venv if is_native(venv) else StepwiseEnv(venv)
    key_reset, key_stagger = jax.random.split(jax.random.PRNGKey(0))
    state = venv.stagger(venv.reset(key_reset), key_stagger)
    random = np.random.default_rng(0)

    def step(state: Any) -> Any:
        action = random.uniform(-1.0, 1.0, (num_envs, venv.action_size)).astype(np.float32)
        return jax.block_until_ready(venv.step(state, action))

    state = step(state)
    ready = time.perf_counter()
    state = step(state)
    speeds, nan, steps, cpu = [], 0.0, 0, time.process_time()
    for _ in range(PARTS):
        count, start = 0, time.perf_counter()
        while not count or time.perf_counter() - start < seconds / PARTS:
            state, count = step(state), count + 1
            nan += float(np.sum(state.metrics["nan"]))
        speeds.append(count * num_envs / (time.perf_counter() - start))
        steps += count * num_envs
    cpu = time.process_time() - cpu
    return {
        "env": env_name,
        "impl": impl,
        "num_envs": num_envs,
        "steps": steps,
        "steps_per_s": round(statistics.median(speeds)),
        "steps_per_s_min": round(min(speeds)),
        "steps_per_s_max": round(max(speeds)),
        "cpu_steps_per_s": round(steps / cpu),
        "start_seconds": round(ready - begun, 1),
        "nan": int(nan),
    }


def training(env_name: str, impl: str, updates: int) -> dict[str, Any]:
    """PPO with the settings that a task has on a CPU, after its first update."""
    config = TrainingSpeedConfig(env_name=env_name, learners=(1,), updates=updates, impl=impl)
    cpu, start = time.process_time(), time.perf_counter()
    fields = measure_training(config, 1, 1)
    return fields | {
        "cpu_seconds": round(time.process_time() - cpu, 1),
        "seconds": round(time.perf_counter() - start, 1),
    }
