"""Compiled environments that many tests share, random rollouts, and the same people in C MuJoCo."""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import mujoco
import numpy as np

import agym_jax
from agym_jax.sim.scene import compose
from agym_jax.spec import Pose
from agym_jax.state import Episode
from agym_jax.wrappers import VectorEnv, vectorize

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


def compile_batch(name: str) -> CompiledBatch:
    """``BATCH`` environments on MJX; compiled when they are first called."""
    env = vectorize(agym_jax.make(name, impl="jax"), BATCH)
    traces = {"reset": 0, "step": 0}

    def reset(key: jax.Array) -> Any:
        traces["reset"] += 1  # a Python side effect happens when JAX traces, and only then
        return env.reset(key)

    def step(state: Any, action: jax.Array) -> Any:
        traces["step"] += 1
        return env.step(state, action)

    return CompiledBatch(env, jax.jit(reset), jax.jit(step), traces)


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
