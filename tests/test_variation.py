# ruff: noqa: D103
"""Robots that differ from episode to episode: what is drawn does what it says, and nothing else changes."""

from __future__ import annotations

import dataclasses
from functools import cache
from typing import Any

import gymnasium
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import agym_jax
from agym_jax import RobotVariation, observe
from agym_jax.changes import arguments_of
from agym_jax.errors import ArgumentError
from agym_jax.sim.episode import make_episode, model_fields
from agym_jax.variation import RobotDraw, delayed, sample_robot, sensed_by

NAME, BED = "ReachingJaco-v0", "ArmManipulationJaco-v0"
ALL = RobotVariation((0.5, 2.0), (0.5, 1.5), (0, 3), (0.0, 0.01), (0.0, 0.02), (0.0, 0.5))
KEY = jax.random.key(5)


@cache
def make(robot: RobotVariation | None = None, name: str = NAME) -> agym_jax.Env:
    return agym_jax.make(name, impl="native", robot=robot)


def observations(robot: RobotVariation | None, actions: np.ndarray) -> np.ndarray:
    env = make(robot)
    state = env.reset(KEY)
    seen = [state.obs]
    for action in actions:
        state = env.step(state, action)
        seen.append(state.obs)
    return np.stack(seen)


def actions_of(n: int) -> np.ndarray:
    return np.random.default_rng(0).uniform(-1, 1, (n, 7)).astype(np.float32)


@pytest.mark.jit
def test_what_is_off_is_not_there():
    env = make(RobotVariation())
    assert env.variation is None and env.changes == {}
    state, usual = env.reset(KEY), make().reset(KEY)
    assert jax.tree.structure(state) == jax.tree.structure(usual)
    assert state.episode.robot is None and state.episode.sent is None
    only = sample_robot(KEY, RobotVariation(strength=(0.5, 1.0)))
    assert only is not None and len(jax.tree.leaves(only)) == 1


@pytest.mark.jit
def test_factors_of_one_and_no_delay_change_no_bit():
    """And the person, the pose and the placement are those without."""
    one = (1.0, 1.0 + 1e-9)  # which is 1 in float32
    robot = RobotVariation(friction=one, strength=one)
    same = observations(robot, actions_of(4))
    np.testing.assert_array_equal(same, observations(None, actions_of(4)))
    drawn = make(robot).reset(KEY).episode.robot
    assert drawn.friction == 1.0 and drawn.strength == 1.0 and drawn.latency is None


@pytest.mark.jit
def test_actions_arrive_later_by_the_latency():
    late = observations(RobotVariation(latency=(2, 2)), actions_of(6))
    shifted = np.concatenate([np.zeros((2, 7), np.float32), actions_of(6)[:4]])
    np.testing.assert_array_equal(late, observations(None, shifted))
    assert np.abs(late - observations(None, actions_of(6))).max() > 0.01


def test_the_line_of_actions_moves_on():
    robot = RobotDraw(latency=jnp.int32(1), longest=3)
    sent = jnp.zeros((3, 2))
    for i in range(1, 5):
        arrived, sent = delayed(robot, sent, jnp.full(2, float(i)))
        assert arrived[0] == i - 1 and sent.shape == (3, 2)
    np.testing.assert_array_equal(sent[:, 0], [4.0, 3.0, 2.0])
    now, _ = delayed(dataclasses.replace(robot, latency=jnp.int32(0)), sent, jnp.ones(2))
    assert now[0] == 1.0


@pytest.mark.slow
@pytest.mark.jit
def test_weak_motors_move_the_arm_less():
    env, weak = make(), make(RobotVariation(strength=(0.05, 0.05)))
    push = np.ones(7, np.float32)
    moved = []
    for one in (env, weak):
        state = one.reset(KEY)
        index = one.scene.index.robot_qpos
        moved.append(np.abs(one.step(state, push).data.qpos[index] - state.data.qpos[index]).sum())
    assert 0.01 < moved[1] < 0.7 * moved[0]


def test_only_contacts_of_tool_and_robot_and_only_the_robots_motors_vary():
    env = make(ALL, BED)
    scene, spec = env.scene, env.task.human
    sample, *_ = jax.jit(env._sample_episode)(KEY)
    episode = make_episode(scene, spec, sample, np)
    usual = dataclasses.replace(episode, robot=None)
    muscles = env.controller.muscles(episode.human)
    ours, theirs = (model_fields(scene, scene.model, x, muscles) for x in (episode, usual))
    model, names = scene.model, []
    for one, other in zip(model.pair_geom1, model.pair_geom2, strict=True):
        names.append(f"{model.geom(one).name} {model.geom(other).name}")
    of_robot = np.array(["robot/" in x or "tool" in x for x in names])
    assert 0 < of_robot.sum() < len(names)
    factor = np.asarray(ours["pair_friction"]) / model.pair_friction
    np.testing.assert_allclose(factor[of_robot], episode.robot.friction, rtol=1e-6)
    np.testing.assert_allclose(factor[~of_robot], 1.0, rtol=1e-6)
    assert "pair_friction" not in theirs
    bounds = [np.array(x["dof_frictionloss"]) for x in (ours, theirs)]
    bounds[1][scene.index.robot_dof] *= episode.robot.strength
    np.testing.assert_allclose(bounds[0], bounds[1], rtol=1e-6)
    assert np.all(bounds[0][scene.index.robot_dof] > 0)


def test_noise_is_as_large_as_it_says_and_leaves_turns_turns():
    task = make().task
    record, layout = task.robot_obs, observe.layout(task.robot_obs)
    true = np.zeros(observe.size(record), np.float32)
    for name in ("hand_quat_w", "head_quat_w"):
        true[layout[name].start] = 1.0
    drawn = sample_robot(KEY, dataclasses.replace(ALL, position_noise=(0.01, 0.01)))
    assert drawn is not None
    see = jax.vmap(lambda step: sensed_by(drawn, record, jnp.asarray(true), step))
    seen = np.asarray(see(jnp.arange(2000)))
    np.testing.assert_allclose(seen[:, layout["hand_pos_torso"]].std(axis=0), 0.01, rtol=0.1)
    angle = float(drawn.noise[1])
    np.testing.assert_allclose(seen[:, layout["arm_angles"]].std(axis=0), angle, rtol=0.1)
    quats = seen[:, layout["hand_quat_w"]]
    np.testing.assert_allclose(np.linalg.norm(quats, axis=1), 1.0, rtol=1e-5)
    turns = 2 * np.linalg.norm(quats[:, 1:], axis=1)
    assert np.sqrt((turns**2).mean() / 3) == pytest.approx(angle, rel=0.1)
    np.testing.assert_array_equal(seen[7], np.asarray(see(jnp.array([7])))[0])


@pytest.mark.slow
@pytest.mark.jit
def test_noise_is_on_what_the_robot_sees_and_on_nothing_else():
    noisy, usual = make(RobotVariation(angle_noise=(0.01, 0.01))), make()
    states = [env.reset(KEY) for env in (noisy, usual)]
    for _ in range(3):
        states = [
            env.step(x, np.zeros(7, np.float32))
            for env, x in zip((noisy, usual), states, strict=True)
        ]
    ours, theirs = states
    layout = observe.layout(usual.task.robot_obs)
    off = ours.obs - theirs.obs
    assert np.all(off[layout["arm_angles"]] != 0) and np.abs(off).max() < 0.06
    np.testing.assert_array_equal(off[layout["hand_pos_torso"]], 0.0)
    assert ours.metrics == theirs.metrics
    np.testing.assert_array_equal(ours.data.qpos, theirs.data.qpos)


def test_every_episode_draws_another_robot_within_the_ranges():
    drawn = jax.vmap(lambda key: sample_robot(key, ALL))(jax.random.split(KEY, 500))
    for name in ("friction", "strength", "latency"):
        low, high = getattr(ALL, name)
        values = np.asarray(getattr(drawn, name))
        assert values.min() >= low and values.max() <= high
        assert values.mean() == pytest.approx((low + high) / 2, rel=0.1)
    assert set(np.asarray(drawn.latency)) == {0, 1, 2, 3}
    assert np.all(np.asarray(drawn.noise).max(axis=0) <= [0.01, 0.02, 0.5])


@pytest.mark.jit
def test_it_belongs_to_what_the_environment_is():
    env = make(ALL)
    assert env.changes["robot.latency"] == [0, 3] and len(env.changes) == 6
    assert agym_jax.make(NAME, impl="native", **arguments_of(env.changes)).variation == ALL
    one: Any = gymnasium.make(NAME, robot=RobotVariation(latency=(2, 2))).unwrapped
    assert one.core.changes == {"robot.latency": [2, 2]}
    one.reset(seed=0)
    assert one.state.episode.robot.latency == 2


@pytest.mark.parametrize(
    ("fields", "told"),
    [
        ({"friction": (1.2, 0.8)}, "low <= high"),
        ({"friction": (-1.0, 1.0)}, "0 <= low"),
        ({"friction": 0.5}, "got 0.5"),
        ({"friction": [0.5, 1.0]}, "tuple"),
        ({"strength": (0.0, 1.0)}, "0 < low"),
        ({"strength": (0.5, float("nan"))}, "finite"),
        ({"latency": (0.5, 2)}, "whole"),
        ({"latency": (0, 21)}, "<= 20"),
        ({"latency": (True, 2)}, "whole"),
        ({"angle_noise": (0.0, float("inf"))}, "finite"),
        ({"rare_starts": 1.5}, "from 0 to 1, got 1.5"),
        ({"rare_starts": (0.0, 1.0)}, "from 0 to 1"),
        ({"rare_starts": float("nan")}, "from 0 to 1"),
        ({"rare_starts": True}, "got True"),
    ],
)
def test_ranges_that_make_no_sense_are_refused(fields, told):
    with pytest.raises(ArgumentError, match=told):
        RobotVariation(**fields)


@pytest.mark.parametrize("robot", ["Sawyer", {"friction": (0.8, 1.2)}, 3])
def test_what_is_no_variation_is_refused(robot):
    with pytest.raises(ArgumentError, match="RobotVariation"):
        agym_jax.make(NAME, robot=robot)


@pytest.mark.slow
@pytest.mark.jit
def test_mjx_has_the_same_robots_as_c_mujoco():
    """In a batch, whose model fields differ from environment to environment, and with auto-reset."""
    from agym_jax.wrappers import vectorize

    robot, seen = dataclasses.replace(ALL, friction=(0.1, 1.0)), []
    for impl in ("jax", "native"):
        envs = vectorize(agym_jax.make(NAME, impl=impl, robot=robot, episode_length=3), 4)
        reset, step = (jax.jit(f) if impl == "jax" else f for f in (envs.reset, envs.step))
        state = reset(jax.random.split(KEY, 4))
        strengths = [np.asarray(state.episode.robot.strength)]
        rows = [np.asarray(state.obs)]
        for action in actions_of(4):
            state = step(state, np.broadcast_to(action, (4, 7)))
            rows.append(np.asarray(state.obs))
            strengths.append(np.asarray(state.episode.robot.strength))
        assert len(set(strengths[0])) == 4 and np.all(strengths[0] == strengths[2])
        assert np.all(strengths[0] != strengths[4])  # another robot in the next episode
        seen.append((np.stack(rows), np.stack(strengths)))
    np.testing.assert_allclose(seen[0][1], seen[1][1], rtol=1e-6)
    np.testing.assert_allclose(seen[0][0], seen[1][0], atol=2e-3)
