# ruff: noqa: D103
"""Batches of C MuJoCo: the same bits however many environments and threads, and every episode anew."""

from __future__ import annotations

import dataclasses
from operator import itemgetter
from typing import Any

import jax
import numpy as np
import pytest

import agym_jax
from agym_jax.errors import ActionError
from agym_jax.wrappers import NativeVectorEnv, vectorize

pytestmark = pytest.mark.jit
STEPS = 6
KEYS = jax.random.split(jax.random.PRNGKey(5), 40)


@pytest.fixture(scope="module")
def env() -> agym_jax.Env:
    return agym_jax.make("ScratchItchJaco-v0", impl="native")


def _actions(env: Any, num_envs: int) -> np.ndarray:
    shape = (STEPS, 40, env.action_size)
    return np.random.default_rng(0).uniform(-1, 1, shape).astype(np.float32)[:, :num_envs]


def _late(state: Any, rows: Any, env: Any) -> Any:
    """The state with some clocks two steps before the end of their episodes."""
    clocks = np.array(state.episode.step)
    clocks[rows] = env.episode_length - 2
    return state.replace(episode=dataclasses.replace(state.episode, step=clocks))


def _play(venv: Any, num_envs: int) -> list[Any]:
    """States of a batch in which two environments begin again."""
    states = [_late(venv.reset(KEYS[:num_envs]), [0, -1], venv)]
    for action in _actions(venv, num_envs):
        states.append(venv.step(states[-1], action))
    return states


def _same(mine: Any, theirs: Any) -> None:
    jax.tree.map(np.testing.assert_array_equal, mine, theirs)


@pytest.fixture(scope="module")
def forty(env: agym_jax.Env) -> list[Any]:
    return _play(NativeVectorEnv(env, 40, num_threads=2), 40)


def test_threads_and_batch_size_change_no_bit(env: agym_jax.Env, forty: list[Any]):
    _same(_play(NativeVectorEnv(env, 40, num_threads=1), 40), forty)
    alone = jax.tree.map(lambda x: x[[0, 39]], forty)
    both = NativeVectorEnv(env, 2)
    state = _late(both.reset(KEYS[np.array([0, 39])]), [0, 1], env)
    for action, theirs in zip(_actions(env, 40)[:, [0, 39]], alone[1:], strict=True):
        state = both.step(state, action)
        _same(state, theirs)


def test_a_batch_is_its_environments_one_by_one(env: agym_jax.Env, forty: list[Any]):
    for i in (0, 7, 39):
        state = env.reset(KEYS[i])
        if i != 7:
            state = _late(state.replace(episode=state.episode), ..., env)
        for action, theirs in zip(_actions(env, 40)[:, i], forty[1:], strict=True):
            state, theirs = env.step(state, action), jax.tree.map(itemgetter(i), theirs)
            final = theirs.info["final_observation"]
            np.testing.assert_array_equal(state.obs, final)
            if state.done:
                state = env.reset_where(state, True)
            _same(state.replace(info={}), theirs.replace(info={}))


def test_who_is_done_begins_again_as_somebody_else(env: agym_jax.Env, forty: list[Any]):
    before, ended, after = forty[1], forty[2], forty[3]
    np.testing.assert_array_equal(np.flatnonzero(ended.done), [0, 39])
    np.testing.assert_array_equal(ended.info["truncation"], ended.done)
    np.testing.assert_array_equal(ended.episode.step[[0, 1, 39]], [0, 2, 0])
    np.testing.assert_array_equal(after.episode.step[[0, 1, 39]], [1, 3, 1])
    anew = (ended.info["final_observation"] != ended.obs).any(axis=1)
    np.testing.assert_array_equal(np.flatnonzero(anew), [0, 39])
    fresh = env.reset(jax.random.split(before.key[0])[0])
    np.testing.assert_array_equal(fresh.obs, ended.obs[0])
    np.testing.assert_array_equal(fresh.episode.rows.body_pos, ended.episode.rows.body_pos[0])
    assert (before.episode.placement.arm_angles[0] != ended.episode.placement.arm_angles[0]).any()


def test_a_step_leaves_the_state_that_it_was_given(env: agym_jax.Env):
    venv = vectorize(env, 3)
    state, other = venv.reset(KEYS[:3]), venv.reset(KEYS[3:6])
    before = jax.tree.map(np.array, state)
    action = _actions(env, 3)[0]
    first = venv.step(state, action)
    venv.step(other, -action)  # other people in the same rows
    _same(venv.step(jax.device_get(before), action), first)
    _same(state, before)


def test_one_that_breaks_does_not_stop_the_others(env: agym_jax.Env):
    venv = vectorize(env, 3)
    state, action = venv.reset(KEYS[:3]), _actions(env, 3)[0]
    sound = venv.step(state, action)
    numbers = np.array(state.data.numbers)
    broken = state.data.replace()
    broken.qvel[1] = 1e30
    after = venv.step(state.replace(data=broken), action)
    np.testing.assert_array_equal(after.metrics["nan"], [0, 1, 0])
    np.testing.assert_array_equal(after.done, [0, 1, 0])
    np.testing.assert_array_equal(after.info["truncation"], [0, 1, 0])
    np.testing.assert_array_equal(after.info["final_observation"][1], state.obs[1])
    np.testing.assert_array_equal(after.obs[[0, 2]], sound.obs[[0, 2]])
    assert np.isfinite(after.obs).all() and after.episode.step[1] == 0
    np.testing.assert_array_equal(state.data.numbers, numbers)


def test_actions_of_another_shape_are_refused(env: agym_jax.Env):
    venv = vectorize(env, 3)
    with pytest.raises(
        ActionError, match=r"batch of 3 takes actions of shape \(3, 7\), got \(2, 7\)"
    ):
        venv.step(venv.reset(KEYS[:3]), np.zeros((2, 7)))
