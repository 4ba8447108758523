"""Compiled environments, once a session: each costs most of a minute of a cold run."""

from __future__ import annotations

import os
import signal
from collections.abc import Iterator
from typing import Any, NamedTuple

import jax
import mujoco
import numpy as np
import pytest

import agym_jax
from agym_jax.jax_settings import enable_compilation_cache
from agym_jax.sim.scene import compose
from agym_jax.spec import Pose
from agym_jax.state import Episode
from agym_jax.wrappers import VectorEnv, vectorize

enable_compilation_cache()  # also for the small programs of tests that build no environment

BATCH = 8
STATIC, ACTIVE = "ScratchItchJaco-v0", "ScratchItchJacoHuman-v0"


class CompiledBatch(NamedTuple):
    """A batch of environments, its compiled functions, and how often Python has run each."""

    env: VectorEnv
    reset: Any
    step: Any
    traces: dict[str, int]


class Rollout(NamedTuple):
    """What a random policy saw: NumPy, time first."""

    first: Any  # state after reset
    last: Any  # state at the end
    actions: np.ndarray  # (T, B, A)
    obs: np.ndarray  # (T + 1, B, O)
    reward: np.ndarray  # (T, B)
    metrics: dict[str, np.ndarray]  # (T, B)


def _compiled(name: str) -> CompiledBatch:
    env = vectorize(agym_jax.make(name, impl="jax"), BATCH)
    traces = {"reset": 0, "step": 0}

    def reset(key: jax.Array) -> Any:
        traces["reset"] += 1  # a Python side effect happens when JAX traces, and only then
        return env.reset(key)

    def step(state: Any, action: jax.Array) -> Any:
        traces["step"] += 1
        return env.step(state, action)

    return CompiledBatch(env, jax.jit(reset), jax.jit(step), traces)


def compiled_human(env: Any, episode: Episode) -> mujoco.MjModel:
    """One episode's scene in C MuJoCo, compiled from scratch."""
    p, place = episode.human, episode.placement
    base = Pose(tuple(map(float, place.base_pos)), tuple(map(float, place.base_quat)))  # ty: ignore
    return compose(
        env.task,
        env.robot,
        env.active,
        float(p.sex),
        float(p.stature),
        float(p.girth),
        float(p.limit_scale),
        jax.tree.map(np.asarray, episode.pose),
        base,
    )


SHARED = ("batch", "rollout")
"""Session fixtures that compile an environment: all tests that use one run on one worker."""
SECONDS = {
    "compiled environment": 150, "tests/train/test_coop.py": 120, "tests/sim/test_c_mujoco.py": 90,
    "tests/tasks/test_dressing.py": 60, "tests/matter/test_cloth_kernel.py": 50,
    "tests/offline/test_base_search.py": 50, "tests/tasks/test_meals.py": 40,
    "tests/matter/test_containers.py": 35, "tests/train/test_ppo.py": 30,
    "tests/matter/test_cloth.py": 30, "tests/matter/test_particles.py": 30,
}  # fmt: skip
"""What the longest groups take, roughly (2 cores, cold cache): these begin first, so that workers end together."""


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Group tests for ``--dist loadgroup``: those of a file, and those that share a compiled environment."""

    def group(item: pytest.Item) -> str:
        if set(SHARED) & set(getattr(item, "fixturenames", ())):
            return "compiled environment"
        mark = item.get_closest_marker("xdist_group")
        return mark.args[0] if mark else item.nodeid.split("::")[0]

    for item in items:
        item.add_marker(pytest.mark.xdist_group(group(item)), append=False)
    items.sort(key=lambda item: -SECONDS.get(group(item), 0))


@pytest.fixture(scope="session")
def batch() -> CompiledBatch:
    """Eight environments of a person who does not act."""
    return _compiled(STATIC)


@pytest.fixture(scope="session")
def rollout(batch: CompiledBatch) -> Rollout:
    """Thirty random steps."""
    actions = np.random.default_rng(0).uniform(-1, 1, (30, BATCH, batch.env.action_size))
    return roll(batch, 0, actions.astype(np.float32))


def roll(batch: CompiledBatch, seed: int, actions: np.ndarray) -> Rollout:
    """Play given actions from a seed."""
    state = first = batch.reset(jax.random.PRNGKey(seed))
    seen = []
    for action in actions:
        state = batch.step(state, action)
        seen.append(jax.device_get((state.info["final_observation"], state.reward, state.metrics)))
    obs, reward, metrics = jax.tree.map(lambda *x: np.stack(x), *seen)
    obs = np.concatenate([np.asarray(first.obs)[None], obs])
    return Rollout(first, state, actions, obs, reward, metrics)


@pytest.fixture(scope="session")
def static_env() -> agym_jax.Env:
    """The environment of one environment, not compiled."""
    return agym_jax.make(STATIC, impl="jax")


@pytest.fixture(scope="session")
def active_env() -> agym_jax.Env:
    """The same with a person who acts."""
    return agym_jax.make(ACTIVE, impl="jax")


@pytest.fixture
def restored_settings() -> Iterator[None]:
    """What a command line of ``train`` sets in this process is as before after the test."""
    handler = signal.getsignal(signal.SIGTERM)
    yield
    signal.signal(signal.SIGTERM, handler)


@pytest.fixture
def raycast(monkeypatch: pytest.MonkeyPatch) -> None:
    """Draw without OpenGL."""
    monkeypatch.setitem(os.environ, "AGYM_JAX_RENDER", "raycast")
