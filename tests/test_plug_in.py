# ruff: noqa: D103
"""A robot and a task of a newcomer's, in ``toy_plug_in.py`` outside of the package, work like ours."""

from __future__ import annotations

import dataclasses
import importlib
import re
import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

import gymnasium
import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

import agym_jax
from agym_jax.data.banks import Placement, bank_path, load_bank
from agym_jax.env import AssistiveEnv
from agym_jax.errors import (
    MissingAssetError,
    MissingPlacementError,
    SpecError,
    UnknownNameError,
)
from agym_jax.math3d import rotation_matrix
from agym_jax.offline import placements
from agym_jax.registry import parse, register_robot, register_task
from agym_jax.robots import ROBOTS
from agym_jax.sim.motors import Aim, Motors
from agym_jax.sim.scene import build_scene, compose
from agym_jax.spec import Pose
from agym_jax.tasks import TASKS

OUR_TASKS, OUR_ROBOTS = tuple(TASKS), tuple(ROBOTS)
SIZE = 8
NAME = "WavingToybot-v0"


@pytest.fixture(scope="module")
def toy(tmp_path_factory: pytest.TempPathFactory) -> Iterator[ModuleType]:
    """The newcomer's module, imported; banks go to a temporary folder; all undone afterwards."""
    ids = agym_jax.list_envs()
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("AGYM_JAX_PLACEMENTS", str(tmp_path_factory.mktemp("placements")))
        module = importlib.import_module("toy_plug_in")
        try:
            yield module
        finally:
            del TASKS["Waving"], ROBOTS["Toybot"], sys.modules["toy_plug_in"]
    assert (tuple(TASKS), tuple(ROBOTS)) == (OUR_TASKS, OUR_ROBOTS)
    assert agym_jax.list_envs() == ids


@pytest.fixture(scope="module")
def bank(toy: ModuleType) -> Path:
    """A small bank, built as a user builds it."""
    assert placements.main(["build", f"toy_plug_in:{NAME}", "--size", str(SIZE)]) == 0
    return bank_path(toy.WAVING, toy.TOYBOT)


def _with_file(toy: ModuleType, folder: Path, old: str, new: str):
    """The toy robot with another MJCF."""
    path = folder / "changed.xml"
    path.write_text(Path(toy.TOYBOT.model).read_text().replace(old, new))
    return dataclasses.replace(toy.TOYBOT, model=str(path))


# -- ids ---------------------------------------------------------------------------------------


def test_importing_the_file_gives_ids_for_every_partner(toy: ModuleType):
    pairs = [(task, "Toybot") for task in (*OUR_TASKS, "Waving")]
    pairs += [("Waving", robot) for robot in OUR_ROBOTS]
    wanted = {f"{task}{robot}{human}-v0" for task, robot in pairs for human in ("", "Human")}
    ids = agym_jax.list_envs()
    assert wanted <= set(ids)
    assert len(ids) == len(set(ids)) == 2 * (len(OUR_TASKS) + 1) * (len(OUR_ROBOTS) + 1)
    recipe = parse("WavingToybotHuman-v0")
    assert recipe.task is toy.WAVING and recipe.robot is toy.TOYBOT and recipe.active


def test_gymnasium_knows_the_ids_when_told_again(toy: ModuleType):
    assert NAME not in gymnasium.registry
    before = set(gymnasium.registry)
    agym_jax.register_envs()
    try:
        assert NAME in gymnasium.registry and "ReachingToybotHuman-v0" in gymnasium.registry
    finally:
        for name in set(gymnasium.registry) - before:
            del gymnasium.registry[name]


def test_a_name_that_is_taken_is_refused(toy: ModuleType):
    with pytest.raises(SpecError, match="There is a task 'Waving' already"):
        register_task(dataclasses.replace(toy.WAVING, above=0.5))
    with pytest.raises(SpecError, match="There is a robot 'Toybot' already"):
        register_robot(dataclasses.replace(toy.TOYBOT, base_height=0.1))
    with pytest.raises(SpecError, match="There is a task 'Reaching' already"):
        register_task(dataclasses.replace(toy.WAVING, name="Reaching"))
    assert TASKS["Waving"] is toy.WAVING and ROBOTS["Toybot"] is toy.TOYBOT


@pytest.mark.parametrize(
    ("name", "command"),
    [
        ("WavingJacoHuman-v0", r"agym-jax placements build toy_plug_in:WavingJaco-v0$"),
        ("ReachingToybot-v0", r"agym-jax placements build ReachingToybot-v0 \(with my_module:"),
    ],
)
def test_an_id_without_a_bank_says_how_to_build_it(toy: ModuleType, name: str, command: str):
    with pytest.raises(MissingPlacementError, match=command):
        agym_jax.make(name)


def test_an_id_may_name_its_module(toy: ModuleType):
    assert parse(f"toy_plug_in:{NAME}") == parse(NAME)
    assert parse(f"toy_plug_in:{NAME}").name == NAME


def test_the_builder_says_which_id_it_does_not_know(toy: ModuleType, capsys):
    assert placements.main(["build", "WavingToybo-v0"]) == 1
    said = capsys.readouterr().err
    assert "Did you mean 'WavingToybot-v0'?" in said and "the robot 'Toybo' does not" in said
    with pytest.raises(UnknownNameError, match="Did you mean 'WavingToybot-v0'"):
        agym_jax.make("WavngToybot-v0")


# -- scenes ------------------------------------------------------------------------------------


def test_the_scene_has_the_toys_joints_motors_and_contacts(toy: ModuleType):
    joints = toy.TOYBOT.arms["right"].joints
    model = compose(toy.WAVING, toy.TOYBOT)
    assert model.nq == model.nv == len(joints) == 7
    bounds = [model.joint(f"robot/{x}").frictionloss[0] for x in joints]
    assert bounds == [toy.WAVING.control.max_torque] * 7
    pairs = {model.sensor(i).name for i in range(model.nsensor)}
    assert "robot_human|robot/hand_collision|human/head" in pairs
    active = build_scene(toy.WAVING, toy.TOYBOT, active=True)
    assert active.moving == toy.WAVING.human.joints and active.model.nq == 7 + 4


def test_c_mujoco_simulates_the_toy(toy: ModuleType):
    model = compose(toy.WAVING, toy.TOYBOT, active=True, base=Pose((-3.0, 0.0, 1.0)))
    data, dofs = mujoco.MjData(model), _motors(model, "robot/")
    assert len(_motors(model, "human/")) == 4  # the person's muscles
    control = toy.WAVING.control
    motors = Motors.of(model, dofs, control.time_step)
    aim = Aim(np.full(7, 0.25), control.rate, control.max_torque)
    for _ in range(1000):
        motors.prepare(model, data, aim)
        mujoco.mj_step(model, data)
    assert not any(warning.number for warning in data.warning)
    # nothing pulls at the robot: it goes where its motors want it
    np.testing.assert_allclose(data.qpos[dofs], 0.25, atol=0.01)


@pytest.mark.parametrize("visual", [False, True])
def test_every_pair_with_ours_compiles(toy: ModuleType, visual: bool):
    for task in OUR_TASKS:
        model = compose(TASKS[task], toy.TOYBOT, visual=visual)
        assert len(_motors(model, "robot/")) == 7
    for robot in OUR_ROBOTS:
        model = compose(toy.WAVING, ROBOTS[robot], visual=visual)
        assert len(_motors(model, "robot/")) == 7


def _motors(model: mujoco.MjModel, whose: str) -> np.ndarray:
    """Dofs with a motor, of joints whose names begin so."""
    driven = np.flatnonzero(model.dof_frictionloss)
    return driven[[model.joint(j).name.startswith(whose) for j in model.dof_jntid[driven]]]


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('"bend_2"', '"bend_two"', r"has no joint 'bend_2'. Did you mean"),
        ('site name="torso"', 'site name="chest"', r"has no site 'torso'.*There are: chest, hand"),
        ("hand_collision", "palm_collision", r"no geom 'hand_coll.*Did you mean 'palm_collision'"),
    ],
)
def test_a_name_that_the_file_lacks_is_named(toy, tmp_path, old, new, message):
    with pytest.raises(SpecError, match="Toybot's file .*" + message):
        compose(toy.WAVING, _with_file(toy, tmp_path, old, new))


def test_a_link_without_inertia_is_named(toy: ModuleType, tmp_path: Path):
    wrist = re.search(r'<inertial[^>]*mass="0.5"[^>]*/>', Path(toy.TOYBOT.model).read_text())
    assert wrist
    with pytest.raises(ValueError, match=r"mass and inertia of moving bodies[\s\S]*robot/wrist"):
        compose(toy.WAVING, _with_file(toy, tmp_path, wrist[0], ""))


def test_a_file_or_an_arm_that_is_not_there_is_named(toy: ModuleType):
    wrong = toy.TOYBOT.model.replace("toy_robot", "toy_robott")
    gone = dataclasses.replace(toy.TOYBOT, model=wrong)
    with pytest.raises(MissingAssetError, match=r"toy_robott.*Did you mean 'toy_robot\.xml'"):
        compose(toy.WAVING, gone)
    arm = toy.TOYBOT.arms["left"]
    with pytest.raises(SpecError, match="Toybot has no 'right' arm, only: left"):
        compose(toy.WAVING, dataclasses.replace(toy.TOYBOT, arms={"left": arm}))


# -- banks and environments --------------------------------------------------------------------


def test_the_bank_lies_outside_of_the_package_and_is_reported(bank: Path, capsys):
    assert bank.is_file() and not bank.is_relative_to(Path(agym_jax.__file__).parent.parent)
    assert placements.main(["report"]) == 0
    row = next(x for x in capsys.readouterr().out.splitlines() if "WavingToybot" in x)
    assert re.search(r"head \d+ %", row) and row.endswith(f"| {SIZE} |")


def test_the_bank_puts_the_hand_where_the_task_starts(toy: ModuleType, bank: Path):
    rows = load_bank(toy.WAVING, toy.TOYBOT)
    assert np.shape(rows.arm_angles) == (SIZE, 7) and np.shape(rows.base_pos) == (SIZE, 3)
    scene = build_scene(toy.WAVING, toy.TOYBOT)
    data, index = mujoco.MjData(scene.model), scene.index
    where = np.zeros((SIZE, 3))
    for i in range(SIZE):
        data.qpos[index.robot_qpos] = rows.arm_angles[i]
        mujoco.mj_kinematics(scene.model, data)
        turn = rotation_matrix(rows.base_quat[i], np)
        where[i] = turn @ data.site_xpos[index.tools[0].tip] + rows.base_pos[i]
        approach = turn @ data.site_xmat[index.tools[0].tip].reshape(3, 3)[:, 2]
        np.testing.assert_allclose(approach, (1.0, 0.0, 0.0), atol=0.02)
    low, reached = np.array([-0.4, -0.4, 1.1]), 0.03  # AG accepts a start pose within 3 cm
    assert (where > low - reached).all() and (where < low + 0.1 + reached).all()


@pytest.mark.parametrize("human", ["", "Human"])
def test_reset_and_step_have_the_declared_sizes(bank: Path, human: str):
    env = agym_jax.make(f"WavingToybot{human}-v0", impl="jax")
    assert env.action_sizes == ({"robot": 7, "human": 4} if human else {"robot": 7})
    assert env.observation_sizes == ({"robot": 10, "human": 8} if human else {"robot": 10})
    first = jax.eval_shape(env.reset, jax.random.PRNGKey(0))
    action = jax.ShapeDtypeStruct((env.action_size,), jnp.float32)
    second = jax.eval_shape(env.step, first, action)
    assert first.obs.shape == second.obs.shape == (env.observation_size,)
    assert first.reward.shape == second.reward.shape == ()
    assert jax.tree.structure(first) == jax.tree.structure(second)
    assert jax.tree.map(jnp.shape, first) == jax.tree.map(jnp.shape, second)
    assert {"reward/distance", "reward/preference_velocity", "success"} <= set(second.metrics)


def test_an_observation_of_another_size_is_named(toy: ModuleType):
    """Ours declare seven joint angles, so an arm of six fits none of them."""
    arm = dataclasses.replace(toy.TOYBOT.arms["right"], joints=toy.TOYBOT.arms["right"].joints[:6])
    robot = dataclasses.replace(toy.TOYBOT, name="Sixbot", arms={"right": arm})
    task = TASKS["Reaching"]
    row = Placement(np.zeros((1, 3)), np.array([[1.0, 0, 0, 0]]), np.zeros((1, 6)))
    placements.save_bank(row, bank_path(task, robot), {})
    env = AssistiveEnv(task, robot, impl="jax")
    assert env.action_size == 6
    with pytest.raises(SpecError, match=r"arm_angles is declared with 7 entries but has 6"):
        jax.eval_shape(env.reset, jax.random.PRNGKey(0))
