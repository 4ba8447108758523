# ruff: noqa: D103
"""The viewer without a browser: what it draws, who drives, and what it refuses."""

from __future__ import annotations

import dataclasses
import importlib.util
import socket
from pathlib import Path
from typing import Any

import jax
import mujoco
import numpy as np
import pytest
from unshipped import hide_policies

import agym_jax
from agym_jax.human.population import Human
from agym_jax.policy import load_policy, save_policy
from agym_jax.policy.agents import baseline_policy
from agym_jax.viewer import command, shapes
from agym_jax.viewer.drive import JOINTS, TOOL, ZERO, Driver, ToolGoal, ToolReach
from agym_jax.viewer.moments import Moment
from agym_jax.viewer.people import Wishes, described

pytest.importorskip("viser")
from agym_jax.viewer.panels import short
from agym_jax.viewer.picture import Place, poses
from agym_jax.viewer.replay import ending
from agym_jax.viewer.stage import History, Stage, preview

ID = "ScratchItchJaco-v0"


# -- what is drawn ---------------------------------------------------------------------------------

VOLUMES = {"ball": 4 / 3 * np.pi, "box": 8.0, "rod": 2 * np.pi}


@pytest.mark.parametrize("name", VOLUMES)
def test_unit_meshes_are_closed_and_face_outwards(name: str):
    mesh = shapes.unit(name)
    a, b, c = (mesh.vertices[mesh.faces[:, i]].astype(float) for i in range(3))
    volume = np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6
    assert volume == pytest.approx(VOLUMES[name], rel=0.06)
    assert (
        np.abs(np.cross(b - a, c - a).sum(axis=0)).max() < 1e-4
    )  # no hole: normals add up to nothing


def test_copies_lie_where_the_geoms_are():
    spec = mujoco.MjSpec()
    body = spec.worldbody.add_body(pos=(1, 2, 3), quat=(0.5, 0.5, 0.5, 0.5))
    body.add_joint(axis=(0, 0, 1))
    body.add_geom(type=mujoco.mjtGeom.mjGEOM_CAPSULE, size=(0.1, 0.4, 0), rgba=(1, 0, 0, 1))
    place = Place(spec.compile(), np.array([10.0, 0, 0]))
    place.pose(np.zeros(1))
    copies = shapes.copies_of(place.model, shapes.drawn_geoms(place.model, moving=True))
    assert set(copies) == {"tube", "ball"}
    np.testing.assert_allclose(copies["tube"].scales, [[0.1, 0.1, 0.4]])
    positions, _ = poses([(place, copies["ball"])])
    np.testing.assert_allclose(sorted(positions.tolist()), [[10.6, 2, 3], [11.4, 2, 3]], atol=1e-6)
    assert shapes.drawn_geoms(place.model, moving=False) == []


def test_frames_between_two_moments_lie_between_them():
    before = Moment(np.zeros((1, 2)), (np.zeros((1, 3, 3)),))
    after = Moment(np.ones((1, 2)), (np.full((1, 3, 3), [[np.nan], [2.0], [4.0]]),))
    found = before.towards(after, 0.25)
    np.testing.assert_allclose(found.qpos, 0.25)
    np.testing.assert_allclose(found.points[0][0, :, 0], [np.nan, 0.5, 1.0])


def test_names_of_joints_lose_what_all_begin_with():
    assert short(("j2s7s300_joint_1", "j2s7s300_joint_2")) == ["joint 1", "joint 2"]
    assert short(("r_shoulder_pan_joint", "r_elbow_flex_joint")) == ["shoulder pan", "elbow flex"]


# -- who is there and who drives -------------------------------------------------------------------


@pytest.mark.parametrize(
    ("success", "said"),
    [
        ((0, 0, 1, 1), "success from 0.3 s on"),
        ((0, 1, 0, 1), "success from 0.4 s on"),
        ((1, 1, 1, 1), "success from 0.1 s on"),
        ((1, 1, 1, 0), "no success in 0.4 s"),
        ((0, 0, 0, 0), "no success in 0.4 s"),
    ],
)
def test_a_page_says_from_when_on_success_holds_until_the_end(success: tuple, said: str):
    history = History()
    for i, value in enumerate(success):
        history.add((i + 1) * 0.1, {"success": np.array([value])}, np.zeros(1))
    assert ending(history) == said


def person(**changes: float) -> Human:
    values: dict[str, Any] = dict.fromkeys(("stature", "girth", "strength", "limit_scale"), 1.0)
    tremor = np.array([0.0, 0.0], np.float32)
    return Human(**{"sex": 0.0, "tremor": tremor, **values, **changes})


def test_a_person_is_described_by_what_is_special():
    assert described(person()) == "man, no impairment"
    words = described(person(sex=1.0, stature=0.9, tremor=np.array([0.1, -0.2])))
    assert words == "woman, height × 0.90, tremor 11°"


@pytest.fixture(scope="module")
def stage() -> Stage:
    env = agym_jax.make(ID, impl="native")
    stage = Stage(env, Driver(env, None))
    stage.begin(1001)
    return stage


@pytest.mark.jit
def test_the_episode_is_that_of_enjoy(stage: Stage):
    stage.begin(7)
    key = jax.random.split(jax.random.PRNGKey(7))[0]
    state = agym_jax.make(ID, impl="native").reset(key)
    np.testing.assert_allclose(stage.state(0).obs, state.obs, atol=1e-6)


@pytest.mark.jit
def test_wishes_come_true_and_leave_the_rest_as_drawn(stage: Stage):
    stage.begin(7)
    before = stage.state(0).episode
    stage.wishes = Wishes(sex=1.0, stature=0.9, tremor=0.1)
    stage.begin(7)
    after = stage.state(0).episode
    stage.wishes = Wishes()
    assert (float(after.human.sex), float(after.human.stature)) == (1.0, np.float32(0.9))
    assert np.abs(after.human.tremor).max() == pytest.approx(0.1)
    assert after.human.girth == before.human.girth
    np.testing.assert_array_equal(after.placement.arm_angles, before.placement.arm_angles)
    assert after.pose.root_pos[2] < before.pose.root_pos[2]  # a shorter person sits lower
    np.testing.assert_allclose(after.pose.angles, before.pose.angles, atol=0.2)
    stage.begin(7)
    np.testing.assert_array_equal(stage.state(0).episode.human.tremor, before.human.tremor)


@pytest.mark.jit
def test_joints_go_where_the_user_asks(stage: Stage):
    stage.begin(1001)
    joints = stage.driver.joints["robot"]
    start = np.asarray(stage.states.data.qpos)[0, joints.qpos]
    stage.driver.modes["robot"] = JOINTS
    stage.driver.targets["robot"] = start + 0.1
    for _ in range(8):
        stage.step()
    found = np.asarray(stage.states.data.qpos)[0, joints.qpos]
    stage.driver.modes["robot"] = ZERO
    np.testing.assert_allclose(found, start + 0.1, atol=0.02)


@pytest.mark.jit
def test_the_tool_goes_where_the_gizmo_is(stage: Stage):
    stage.begin(1001)
    joints = stage.driver.joints["robot"]
    where = lambda: stage.arm.pose(np.asarray(stage.states.data.qpos)[0, joints.qpos])  # noqa: E731
    goal = ToolGoal(where().pos + np.array([-0.05, -0.05, 0.08]), where().quat)
    stage.driver.modes["robot"], stage.driver.goal = TOOL, goal
    for _ in range(15):
        stage.step()
    stage.driver.modes["robot"] = ZERO
    np.testing.assert_allclose(where().pos, goal.pos, atol=0.01)
    assert abs(where().quat @ goal.quat) > np.cos(0.05)


@pytest.mark.jit
def test_arrows_are_the_forces_that_the_environment_reports(stage: Stage):
    stage.begin(1001)
    joints = stage.driver.joints["robot"]
    arm: ToolReach = stage.arm
    target = stage.state(0).task.target_pos_w
    stage.driver.modes["robot"] = TOOL
    stage.driver.goal = ToolGoal(target, arm.pose(stage.state(0).data.qpos[joints.qpos]).quat)
    for _ in range(40):
        stage.step()
        drawn, told = stage.forces.forces, float(stage.states.metrics["force/on_human"][0])
        if told > 1.0:
            break
    stage.driver.modes["robot"] = ZERO
    assert told > 1.0 and drawn is not None
    pressed = np.linalg.norm(drawn.vectors[drawn.on_person], axis=1).sum()
    assert told <= pressed * 1.01  # the environment counts normal forces only
    assert pressed < 1.5 * told
    near = np.linalg.norm(drawn.points[drawn.on_person] - target, axis=1)
    assert near.min() < 0.15


@pytest.mark.parametrize(
    "name", ["ScratchItchJaco-v0", "DrinkingSawyerHuman-v0", "BedBathingPR2-v0"]
)
def test_a_typical_person_can_be_shown_before_anything_is_compiled(name: str):
    env = agym_jax.make(name, impl="native")
    place, moment = preview(env)
    place.pose(moment.qpos[0])
    low, high = place.data.geom_xpos.min(axis=0), place.data.geom_xpos.max(axis=0)
    assert np.all(high - low < 6.0) and high[2] > 0.8


def shown(monkeypatch, *words: str) -> Any:
    """The environment that a command line shows."""
    found = []
    monkeypatch.setattr(command, "serve", lambda _, env, *__: found.append(env))
    status = command.main([*words, "--port", "0"])
    return found[0] if status == 0 else None


@pytest.mark.parametrize("words", [[ID], ["--env-name", ID]])
def test_settings_of_the_command_line_are_those_of_enjoy(words, monkeypatch, capsys):
    asked = [*words, "--task.scratch", "3", "--episode-length", "50"]
    assert shown(monkeypatch, *asked) is None
    told = capsys.readouterr().err  # the policy that ships was trained without
    assert "task.scratch" in told and "--any-env" in told
    env = shown(monkeypatch, *asked, "--any-env")
    assert env.changes == {"task.scratch": 3.0, "episode_length": 50}


def test_settings_are_the_policys_where_nothing_else_is_asked_for(tmp_path, monkeypatch, capsys):
    policy = load_policy(ID)
    changes = {"episode_length": 50}
    info = {**policy.info, "changes": changes, "meant_for": changes}
    save_policy(tmp_path / "mine.npz", dataclasses.replace(policy, info=info))
    words = [ID, "--policy", str(tmp_path / "mine.npz")]
    assert shown(monkeypatch, *words).changes == {"episode_length": 50}
    assert "in training" not in capsys.readouterr().out
    env = shown(monkeypatch, *words, "--humans.impairments", "tremor")
    assert env.changes == {"episode_length": 50, "humans.impairments": ["tremor"]}
    said = "Differs from training: humans.impairments is the default in training, ['tremor'] here."
    assert said in capsys.readouterr().out


def test_flags_come_before_the_settings_of_the_policy(tmp_path, monkeypatch):
    policy = load_policy(ID)
    changes = {"task.scratch": 3.0, "humans.sizes": "continuous"}
    info = {**policy.info, "changes": changes, "meant_for": changes}
    save_policy(tmp_path / "mine.npz", dataclasses.replace(policy, info=info))
    words = [ID, "--policy", str(tmp_path / "mine.npz")]
    env = shown(monkeypatch, *words, "--humans.sizes", "ag", "--any-env", "--task.scratch", "2")
    assert env.changes == {}  # they are the defaults, and asked for
    env = shown(monkeypatch, *words, "--any-env", "--task.preferences.velocity", "0.5")
    assert env.changes == changes | {"task.preferences.velocity": 0.5}  # the others stay


def test_policies_sample_as_in_enjoy(stage: Stage):
    act = baseline_policy("random", stage.env.action_size)
    driver = Driver(stage.env, act, deterministic=False)
    keys = jax.random.split(jax.random.PRNGKey(7))[1]
    driver.begin(7, np.asarray(keys)[None])
    for key in jax.random.split(keys, stage.env.episode_length)[:2]:
        found = driver.action(stage.states, stage.arm)
        np.testing.assert_allclose(found, act(stage.states.obs[:1], key), atol=1e-6)


# -- what is refused -------------------------------------------------------------------------------

BAD = {
    "ScratchItchJacko-v0": (["ScratchItchJacko-v0"], "did you mean 'Jaco'"),
    "no people": ([ID, "--grid", "0"], "--grid must be a whole number of at least 1"),
    "too many": ([ID, "--grid", "1000"], "at most 64"),
    "not a page": ([ID, "--export", "page.gif"], "must end in .html"),
    "steps without a page": ([ID, "--steps", "5", "--port", "0"], "--steps requires --export"),
    "no steps": ([ID, "--export", "page.html", "--steps", "0"], "--steps must be"),
    "no such port": ([ID, "--port", "70000"], "--port must be from 0 to 65535"),
    "no such address": ([ID, "--host", "999.1.1.1", "--port", "0"], "Cannot serve at"),
    "no such visuals": ([ID, "--visuals", "mesh", "--port", "0"], "Did you mean 'meshes'?"),
    "a seed below 0": ([ID, "--seed", "-1", "--port", "0"], "--seed must be from 0"),
    "no such policy": ([ID, "--policy", "mine.npz", "--port", "0"], "No policy 'mine.npz'"),
}


@pytest.mark.parametrize("what", BAD)
def test_bad_input_is_refused_before_anything_is_built(what: str, monkeypatch, capsys, tmp_path):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(agym_jax, "make", lambda *_, **__: pytest.fail("an environment was built"))
    words, said = BAD[what]
    assert command.main(words) == 2
    assert said in capsys.readouterr().err
    assert not list(Path().iterdir())


def test_a_port_that_is_in_use_is_told_with_another(capsys: pytest.CaptureFixture):
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        assert command.main([ID, "--port", str(port)]) == 2
    assert f"--port {port + 1}" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("ScratchItchSawyerHuman-v0", "the robot uses that of ScratchItchSawyer-v0, and the person does nothing"),
        ("ScratchItchSawyer-v0", "No policy is shipped for ScratchItchSawyer-v0: nobody acts"),
    ],
)  # fmt: skip
def test_without_a_policy_something_else_drives(name: str, said: str, monkeypatch):
    hide_policies(monkeypatch, name)
    told = []
    command.policy_files(command.ViewConfig(env_name=name), told.append)
    assert said in "".join(told)


def test_one_policy_for_robot_and_person_drives_both(tmp_path: Path):
    policy = load_policy(ID)
    for agent, human in (("robot", "zero"), ("joint", None)):
        file = tmp_path / f"{agent}.npz"
        save_policy(file, dataclasses.replace(policy, info={**policy.info, "agent": agent}))
        config = command.ViewConfig(env_name="ScratchItchJacoHuman-v0", policy=str(file))
        found = command.policy_files(config, print)
        assert found is not None and found.human == human


def test_without_viser_the_extra_is_named(monkeypatch, capsys: pytest.CaptureFixture):
    monkeypatch.setattr(importlib.util, "find_spec", lambda *_: None)
    assert command.main([ID]) == 2
    assert 'pip install "agym_jax[view]"' in capsys.readouterr().err
