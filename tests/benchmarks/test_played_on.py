# ruff: noqa: D103
"""Recorded episodes are played on from their states. The recording is made here: Assistive Gym is not needed."""

from __future__ import annotations

import importlib
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import agym_jax
from agym_jax.errors import ArgumentError
from benchmarks import played_on
from benchmarks.played_on import PlayedOnConfig, begin, by_contact, played, touching

NAME, STEPS = "BedBathingSawyer-v0", 12


@pytest.fixture(scope="module")
def env() -> agym_jax.Env:
    return agym_jax.make(NAME, impl="native")


@pytest.fixture(scope="module")
def states(env: agym_jax.Env) -> dict[str, np.ndarray]:
    """An episode of random actions, as ``states_in_assistive_gym`` writes it."""
    state = env.reset(jax.random.PRNGKey(3))
    human, place, pose = state.episode.human, state.episode.placement, state.episode.pose
    tremor = np.zeros(10)
    tremor[: np.size(human.tremor)] = human.tremor
    start = {
        "seed": 3, "success": False, "sex": float(human.sex), "limit_scale": float(human.limit_scale), "strength": float(human.strength),
        "tremor": tremor, "base": np.r_[place.base_pos, place.base_quat], "chest": np.r_[pose.root_pos, pose.root_quat],
        "body": np.asarray(pose.angles), "obs": np.asarray(state.obs),
    }  # fmt: skip
    index, kept, actions = env.scene.index, [], []
    rng = np.random.default_rng(0)
    for k in range(STEPS + 1):
        q, v = np.asarray(state.data.qpos), np.asarray(state.data.qvel)
        kept.append((q[index.robot_qpos], v[index.robot_dof]))
        if k < STEPS:
            actions.append(rng.uniform(-1, 1, 7))
            state = env.step(state, jnp.asarray(actions[-1], jnp.float32))
    q, qd = (np.array(x) for x in zip(*kept, strict=True))
    still, force = np.zeros((STEPS + 1, 10)), np.zeros((STEPS + 1, 4))
    force[6:, 1] = 5.0
    steps = {"q": q, "qd": qd, "person_q": still, "person_qd": still, "force": force, "action": np.array(actions)}  # fmt: skip
    kinds = np.array(["tool on seat", "robot on seat", "tool on person", "robot on person"])
    return {name: np.array([x]) for name, x in (start | steps).items()} | {"kinds": kinds}


@pytest.mark.jit
def test_an_episode_begins_as_recorded(env, states):
    np.testing.assert_allclose(begin(env, states, 0).obs, states["obs"][0], atol=1e-4)
    other = dict(states, obs=states["obs"] + 0.1)
    with pytest.raises(ArgumentError, match=r"seed 3 is off by 0\.1.*another robot"):
        begin(env, other, 0)


@pytest.mark.jit
def test_actions_played_on_from_a_state_end_where_the_episode_does(env, states):
    config = PlayedOnConfig(NAME, Path("none.npz"), steps=3, every=3)
    here, there, forces = played(env, states, config)
    assert here.shape == there.shape == (4, 7) and np.abs(there).max() > 0.1
    off = np.abs(here - there)
    # a state lacks what the motors knew of the physics step before
    assert np.median(off) < 2e-3 and off.max() < 0.03
    np.testing.assert_allclose(forces[:, 1], [0.0, 1.25, 5.0, 5.0])


def test_states_are_told_apart_by_what_touches_what():
    there = np.zeros((4, 2))
    here = np.array([[0.1, -0.2], [0.3, 0.0], [0.0, 0.4], [0.5, 0.0]])
    forces = np.array([[0, 0, 0, 0], [0, 9, 0, 0], [9, 0, 9, 0], [0, 9, 0, 0.1]], float)
    found = by_contact(
        here, there, forces, ["tool on seat", "robot on seat", "tool on person", "robot on person"]
    )
    assert {kind: tuple(x.values()) for kind, x in found.items()} == {
        "nothing": (1, 0.2, 0.0, 0.2), "robot on seat": (2, 0.4, 0.0, 0.4), "several": (1, 0.4, 0.0, 0.4),
    }  # fmt: skip
    assert list(found["nothing"]) == ["states", "off", "turned there", "turned here"]


def test_steps_that_touch_are_counted_by_how_the_episode_ended():
    force = np.zeros((3, 4, 2))
    force[0, 1:, 1], force[1, 2, 1], force[:, 0, 0] = 1.0, 0.5, 9.0  # the start is no step
    states = {"force": force, "kinds": np.array(["a", "b"]), "success": np.array([False, True, True])}  # fmt: skip
    assert touching(states) == {
        "a": {"successes": [0, 0], "failures": [0]}, "b": {"successes": [1, 0], "failures": [3]},
    }  # fmt: skip


@pytest.mark.jit
@pytest.mark.slow
def test_the_command_plays_a_file(states, tmp_path, capsys):
    np.savez(tmp_path / "states.npz", **states)
    flags = ["--masses", "body", "--steps", "3"]
    assert played_on.main([NAME, str(tmp_path / "states.npz"), *flags]) == 0
    said = capsys.readouterr().out
    assert "episodes                 1" in said and "joint that turned farthest, rad" in said


def test_a_file_that_is_missing_is_named_with_what_records_it(tmp_path, capsys):
    assert played_on.main([NAME, str(tmp_path / "none.npz")]) == 1
    assert (
        "no such file. It is recorded in Assistive Gym, by benchmarks/states"
        in capsys.readouterr().err
    )


@pytest.fixture
def recorder(monkeypatch) -> Any:
    """The module that records, as it is imported beside Assistive Gym."""
    monkeypatch.syspath_prepend(Path(played_on.__file__).parent)
    monkeypatch.delitem(sys.modules, "states_in_assistive_gym", raising=False)
    return importlib.import_module("states_in_assistive_gym")


def test_forces_are_added_up_by_what_touches_what(recorder, monkeypatch):
    touches = {("robot", "bed"): [(8, 2.0), (9, 3.0)], ("robot", "human"): [(9, 4.0), (9, 5.0)]}
    contact = lambda link, newtons: (0, 0, 0, link, 0, 0, 0, 0, 0, newtons)  # noqa: E731
    bullet = SimpleNamespace(
        getContactPoints=lambda bodyA, bodyB, physicsClientId: [contact(*x) for x in touches[bodyA, bodyB]],
        getNumJoints=lambda body, **_: 3, getJointInfo=lambda body, j, **_: (0, 0, 4 if j == 1 else 0),
        getJointStates=lambda body, jointIndices, **_: [(float(j), 0.5) for j in jointIndices],
        getDynamicsInfo=lambda body, link, **_: (0, 0, 0, (0.1, 0, 0), (0, 0, 0, 1)),
        getBasePositionAndOrientation=lambda body, **_: ((1.1, 2.0, 3.0), (0, 0, 0, 1)),
        invertTransform=lambda pos, quat: (tuple(-np.array(pos)), quat),
        multiplyTransforms=lambda pos, quat, other, turn: (tuple(np.add(pos, other)), quat),
    )  # fmt: skip
    monkeypatch.setitem(sys.modules, "pybullet", bullet)
    world = SimpleNamespace(human_limit_scale=1.0, human_strength=1.0, human_impairment="none")
    env = SimpleNamespace(
        id=0, world_creation=world, gender="female", robot="robot", human="human", bed="bed", robot_left_arm_joint_indices=[5, 6]
    )  # fmt: skip
    found = recorder.Recorder(env, "ArmManipulation", "jaco", 7)
    found.add()
    np.testing.assert_allclose(found.steps[0]["force"], [3.0, 2.0, 9.0, 0.0])
    np.testing.assert_allclose(found.steps[0]["q"], [5.0, 6.0])
    np.testing.assert_allclose(found.start["base"], [1.0, 2.0, 3.0, 1.0, 0.0, 0.0, 0.0])
    np.testing.assert_allclose(found.start["body"], [0.0, 2.0])  # joint 1 does not move
    assert found.start["sex"] == 1.0


def test_states_are_recorded_in_bed_alone(recorder, monkeypatch):
    monkeypatch.setattr(sys, "argv", ["states", "FeedingJaco-v0", "none.npz", "out.npz"])
    with pytest.raises(SystemExit, match="FeedingJaco-v0: states are recorded in BedBathing and ArmManipulation alone"):  # fmt: skip
        recorder.main()
