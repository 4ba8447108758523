"""Compiled environments that many tests share, random rollouts, and the same people in C MuJoCo."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from functools import cache
from typing import Any, NamedTuple
from unittest import mock

import jax
import mujoco
import numpy as np

import agym_jax
from agym_jax.sim.scene import compose
from agym_jax.spec import Pose
from agym_jax.state import Episode
from agym_jax.wrappers import VectorEnv, vectorize

BATCH = 8
TASK_METHODS = ("init", "advance", "rewards", "observe", "success")
MJX_FUNCTIONS = ("step", "forward", "kinematics", "make_data")
STATIC, ACTIVE = "ScratchItchJaco-v0", "ScratchItchJacoHuman-v0"


class CompiledBatch(NamedTuple):
    """A batch of environments, its compiled functions, and how often Python has run each.

    ``calls`` counts, for each function, the calls of the task's methods and of MJX while JAX traced it.
    """

    env: VectorEnv
    reset: Any
    step: Any
    traces: dict[str, int]
    calls: dict[str, Counter[str]]


class Rollout(NamedTuple):
    """What a random policy saw: NumPy, time first."""

    first: Any  # state after reset
    last: Any  # state at the end
    actions: np.ndarray  # (T, B, A)
    obs: np.ndarray  # (T + 1, B, O)
    reward: np.ndarray  # (T, B)
    metrics: dict[str, np.ndarray]  # (T, B)


@contextmanager
def counted(env: Any, calls: Counter[str]) -> Iterator[None]:
    """Count the calls of a task's methods and of MJX's functions by an environment."""
    from agym_jax.sim.mjx import mjx  # takes a second that other tests need not wait

    with ExitStack() as stack:
        for owner, names in ((type(env.task), TASK_METHODS), (mjx, MJX_FUNCTIONS)):
            for name in names:
                original = getattr(owner, name)

                def count(
                    *words: Any, _name: str = name, _original: Any = original, **more: Any
                ) -> Any:
                    calls[_name] += 1
                    return _original(*words, **more)

                stack.enter_context(mock.patch.object(owner, name, count))
        yield


@cache
def compile_batch(name: str) -> CompiledBatch:
    """``BATCH`` environments on MJX; compiled when they are first called."""
    env = vectorize(agym_jax.make(name, impl="jax"), BATCH)
    traces = {"reset": 0, "step": 0}
    calls: dict[str, Counter[str]] = {"reset": Counter(), "step": Counter()}

    def reset(key: jax.Array) -> Any:
        traces["reset"] += 1  # a Python side effect happens when JAX traces, and only then
        with counted(env, calls["reset"]):
            return env.reset(key)

    def step(state: Any, action: jax.Array) -> Any:
        traces["step"] += 1
        with counted(env, calls["step"]):
            return env.step(state, action)

    return CompiledBatch(env, jax.jit(reset), jax.jit(step), traces, calls)


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
