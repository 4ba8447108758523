# ruff: noqa: D103
"""Mistakes in a robot, tool, seat or task of a newcomer's: each is refused by name before MuJoCo is asked."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from agym_jax.data.assets import asset_path
from agym_jax.errors import AgymError, MissingAssetError, SpecError, UnknownNameError
from agym_jax.offline.base_search import search
from agym_jax.robots import ROBOTS
from agym_jax.sim.scene import build_scene, compose
from agym_jax.spec import RobotSpec, Task
from agym_jax.tasks import TASKS
from agym_jax.tasks.scratch_itch import ScratchItch

SCRATCH, REACH, LIFT = TASKS["ScratchItch"], TASKS["Reaching"], TASKS["ArmManipulation"]
JACO = ROBOTS["Jaco"]
ROBOT_FILE = """
<mujoco>
  <worldbody>
    <body name="base">
      <site name="torso"/>
      <geom name="base_collision" type="box" size="0.1 0.1 0.1"/>
      <body name="arm">
        <joint name="turn" axis="0 0 1" range="-1 1" limited="true"/>
        <inertial pos="0 0 0" mass="1" diaginertia="0.1 0.1 0.1"/>
        <geom name="hand_collision" type="capsule" fromto="0 0 0 0 0 0.2" size="0.05"/>
        <site name="hand"/>
      </body>
    </body>
  </worldbody>
</mujoco>
"""


def with_human(task: Task, **changes: Any) -> Task:
    """The task with another person."""
    human = dataclasses.replace(task.human, **changes)
    return dataclasses.replace(task, human=human)  # pyrefly: ignore


def with_tool(**changes: Any) -> Task:
    return dataclasses.replace(SCRATCH, tool=dataclasses.replace(SCRATCH.tool, **changes))


def with_seat(**changes: Any) -> Task:
    return dataclasses.replace(SCRATCH, seat=dataclasses.replace(SCRATCH.seat, **changes))


def with_arm(robot: RobotSpec = JACO, **changes: Any) -> RobotSpec:
    arm = dataclasses.replace(robot.arms["right"], **changes)
    return dataclasses.replace(robot, arms={"left": arm, "right": arm})


@pytest.fixture
def stick(tmp_path: Path) -> RobotSpec:
    """The simplest robot: a capsule on a box."""
    path = tmp_path / "stick.xml"
    path.write_text(ROBOT_FILE)
    robot = with_arm(
        joints=("turn",), end_effector="hand", tool_frame="hand", gripper=(), links=("hand_collision",)
    )  # fmt: skip
    return dataclasses.replace(
        robot,
        name="Stick",
        model=str(path),
        torso="torso",
        rest={},
        trunk=(),
        near_trunk=(),
        near_mount=(),
        solid_mounts={},
    )


def changed(robot: RobotSpec, old: str, new: str) -> RobotSpec:
    """The robot, its file edited in place."""
    text = Path(robot.model).read_text()
    assert old in text
    Path(robot.model).write_text(text.replace(old, new))
    return robot


# -- the person --------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (
            {"joints": ("neck_x", "head_xx")},
            r"joint in Reaching's HumanSpec\.joints: 'head_xx'\. Did you mean 'head_x'\?",
        ),
        (
            {"pose": {"r_elbo_x": -1.0}},
            r"joint in Reaching's HumanSpec\.pose: 'r_elbo_x'\. Did you mean 'r_elbow_x'\?",
        ),
        (
            {"pose_range": {"Head_Z": 0.5}},
            r"joint in Reaching's HumanSpec\.pose_range: 'Head_Z'\. Did you mean 'head_z'\?",
        ),
        (
            {"passive_mode": "weld"},
            r"passive mode in Reaching's HumanSpec\.passive_mode: 'weld'\. Did you mean 'welded'\?.*limp",
        ),
        (
            {"limbs": ("hed", "chest")},
            r"link in Reaching's HumanSpec\.limbs: 'hed'\. Did you mean 'head'\?",
        ),
        (
            {"limbs": ("mouth",)},
            r"link in Reaching's HumanSpec\.limbs: 'mouth'",
        ),
        (
            {"impairments": ("none", "limit")},
            r"impairment in Reaching's HumanSpec\.impairments: 'limit'\. Did you mean 'limits'\?",
        ),
        ({"arm": "rigth"}, r"side in Reaching's HumanSpec\.arm: 'rigth'\. Did you mean 'right'\?"),
    ],
)  # fmt: skip
@pytest.mark.parametrize("active", [False, True])
def test_a_name_that_no_person_has_is_named(changes: dict, message: str, active: bool):
    with pytest.raises(UnknownNameError, match="Unknown " + message) as caught:
        build_scene(with_human(REACH, **changes), JACO, active)
    assert isinstance(caught.value, AgymError)


def test_a_person_without_any_impairment_is_refused():
    with pytest.raises(SpecError, match=r'impairments is empty.*healthy person is \("none",\)'):
        compose(with_human(REACH, impairments=()), JACO)


def test_a_comma_that_is_missing_is_told():
    with pytest.raises(SpecError, match=r"limbs is the text 'head'.*comma: \('head',\)"):
        compose(with_human(REACH, limbs="head"), JACO)
    with pytest.raises(SpecError, match=r"goals is the text 'mouth'.*comma: \('mouth',\)"):
        compose(dataclasses.replace(REACH, goals=("mouth",)), JACO)
    with pytest.raises(SpecError, match=r"Arm\.links is the text 'link_7_collision'"):
        compose(REACH, with_arm(links="link_7_collision"))


# -- the task ----------------------------------------------------------------------------------


def test_a_goal_that_no_person_has_is_named():
    task = dataclasses.replace(REACH, goals=(("mouth", "right_hnd"),))
    with pytest.raises(UnknownNameError, match=r"goals: 'right_hnd'\. Did you mean 'right_hand'"):
        search(task, JACO)


@pytest.mark.parametrize("goals", [(("right_hand",),), (("waist",), ("hips",), ("head",))])
def test_goals_are_as_many_as_arms(goals: tuple):
    with pytest.raises(SpecError, match=rf"has {len(goals)} for 2 \(left, right\)"):
        compose(dataclasses.replace(LIFT, goals=goals), JACO)
    with pytest.raises(SpecError, match=r"arms is empty"):
        compose(dataclasses.replace(LIFT, arms=(), goals=()), JACO)


def test_a_start_of_another_shape_is_told():
    @dataclasses.dataclass(frozen=True)
    class Flat(ScratchItch):
        """Forgets that a task may have two arms."""

        def start(self, key, robot):
            """One point instead of a row of it."""
            return jnp.zeros(3)

    with pytest.raises(SpecError, match=r"\.start must give one row.*shape \(1, 3\).*gives \(3,\)"):
        search(Flat(), JACO, size=2)


# -- the robot ---------------------------------------------------------------------------------


def _robot_motors(model: mujoco.MjModel) -> int:
    bounds = [
        model.joint(i).frictionloss[0]
        for i in range(model.njnt)
        if model.joint(i).name.startswith("robot/")
    ]
    return np.count_nonzero(bounds)


def test_the_stick_itself_is_fine(stick: RobotSpec):
    assert _robot_motors(compose(REACH, stick)) == 1


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"trunk": ("base_colision",)}, r"no geom 'base_colision'.*'base_collision'"),
        ({"near_mount": "base_collision"}, r"near_mount is the text 'base_collision'"),
        ({"near_trunk": "base_collision"}, r"near_trunk is the text 'base_collision'"),
        ({"mounts": {}, "solid_mounts": {"bed": ("top",)}}, r"solid_mounts has 'bed', its mounts do not"),
    ],
)  # fmt: skip
def test_what_hand_and_arm_may_touch_of_the_robot_has_to_exist(stick: RobotSpec, changes, message):
    with pytest.raises(SpecError, match=message):
        compose(REACH, dataclasses.replace(stick, **changes))


def test_a_pair_that_no_joint_moves_is_refused_or_left_out(stick: RobotSpec):
    """Between Sawyer's pedestal and an arm that lies still, forces were 1e14 N."""
    fixed = compose(REACH, dataclasses.replace(stick, trunk=("base_collision",)))
    touched = {fixed.geom(g).name for g in (*fixed.pair_geom1, *fixed.pair_geom2)}
    assert "robot/base_collision" in touched  # by the hand, not by the person
    wrong = with_arm(stick, links=("hand_collision", "base_collision"))
    with pytest.raises(SpecError, match=r"'.*' and 'robot/base_collision' form a contact pair"):
        compose(REACH, wrong)


@pytest.mark.parametrize("field", ["links", "joints"])
def test_an_arm_without_links_or_joints_is_refused(field: str):
    with pytest.raises(SpecError, match=rf"Jaco's Arm\.{field} is empty"):
        compose(SCRATCH, with_arm(**{field: ()}))


def test_a_hand_must_be_round_where_it_is_sensed(stick: RobotSpec):
    robot = changed(stick, 'type="capsule" fromto="0 0 0 0 0 0.2"', 'type="cylinder"')
    robot = changed(robot, 'size="0.05"', 'size="0.05 0.1"')
    message = r"Stick's file .*links\[0\].* 'hand_collision' is a cylinder.*capsule or sphere"
    with pytest.raises(SpecError, match=message):
        compose(REACH, robot)
    assert _robot_motors(compose(SCRATCH, robot)) == 1  # there it is the tool that is sensed


def test_a_robot_needs_collision_geoms(stick: RobotSpec):
    changed(stick, "_collision", "_geom")
    robot = with_arm(stick, links=("hand_geom",))
    message = r"Stick's file .* has no geom with 'collision'.*It has: base_geom, hand_geom"
    with pytest.raises(SpecError, match=message):
        search(REACH, robot)


def test_a_link_that_the_search_would_not_see_is_refused(stick: RobotSpec):
    changed(stick, "hand_collision", "palm")
    with pytest.raises(SpecError, match=r"Stick's Arm\.links: 'palm' needs 'collision' in its name"):  # fmt: skip
        compose(REACH, with_arm(stick, links=("palm",)))


def test_a_joint_at_rest_that_the_file_lacks_is_named(stick: RobotSpec):
    robot = dataclasses.replace(stick, rest={"turm": 0.5})
    with pytest.raises(SpecError, match=r"has no joint 'turm'\. Did you mean 'turn'\?"):
        compose(REACH, robot)


# -- the tool and the seat ---------------------------------------------------------------------


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (
            {"geoms": ("scratcher_rod_colision",)},
            r"scratcher\.xml has no geom 'scratcher_rod_colision'\. Did you mean 'scratcher_rod_collision'",
        ),
        ({"tip": "tipp"}, r"has no site 'tipp'\. Did you mean|has no site 'tipp'\. There are"),
        ({"geoms": ()}, r"geoms is empty"),
        ({"n_working": 3}, r"has 2 geoms, of which n_working=3 .*1 to 2"),
        ({"parts": (1,)}, r"parts \(1,\) .* number of its geoms, 2"),
        ({"parts": (2, 0)}, r"parts \(2, 0\) .* at least 1"),
        ({"outline": "box_collision"}, r"has no geom 'box_collision'"),
        (
            {"outline": "scratcher_rod_collision"},
            r"outline 'scratcher_rod_collision' is one of its geoms",
        ),
    ],
)
def test_a_tool_that_does_not_fit_its_file_is_told(changes: dict, message: str):
    with pytest.raises(SpecError, match=r"The tool .*" + message):
        compose(with_tool(**changes), JACO)


def test_a_tool_must_be_round(tmp_path: Path):
    path = tmp_path / "brush.xml"
    text = '<geom name="brush_collision" type="box" size="0.1 0.1 0.1"/><site name="tip"/>'
    path.write_text(f'<mujoco><worldbody><body name="b">{text}</body></worldbody></mujoco>')
    task = with_tool(model=str(path), geoms=("brush_collision",), tip="tip")
    with pytest.raises(SpecError, match=r"ToolSpec\.geoms' 'brush_collision' is a box.*capsule"):
        compose(task, JACO)


def test_a_seat_that_does_not_fit_its_file_is_told():
    geom = SCRATCH.seat.geoms[0]
    with pytest.raises(
        SpecError, match=rf"The seat wheelchair.* has no geom .*Did you mean '{geom}"
    ):
        compose(with_seat(geoms=(geom.replace("_", "-"),)), JACO)


# -- files -------------------------------------------------------------------------------------


def test_a_missing_asset_says_what_there_is_and_how_to_name_ones_own():
    with pytest.raises(MissingAssetError, match=r"No asset 'robots/jako\.xml'.*'jaco\.xml'.*Path\("):  # fmt: skip
        asset_path("robots/jako.xml")
    with pytest.raises(MissingAssetError, match=r"has no folder 'robot'\. Did you mean 'robots'\?"):
        asset_path("robot/jaco.xml")


def test_a_missing_file_of_ones_own_says_what_its_folder_has(tmp_path: Path):
    for name in ("toy_robot.xml", "toy_robot.png"):
        (tmp_path / name).touch()
    wanted = (
        r"No file '.*toy_robott\.xml'.*Did you mean 'toy_robot\.xml'\? There are: toy_robot\.xml\.$"
    )
    with pytest.raises(MissingAssetError, match=wanted):
        asset_path(str(tmp_path / "toy_robott.xml"))
    (tmp_path / "robots").mkdir()
    wanted = r"has no folder 'robts'\. Did you mean 'robots'\?"
    with pytest.raises(MissingAssetError, match=wanted):
        asset_path(str(tmp_path / "robts" / "toy_robot.xml"))


def test_a_relative_path_that_is_there_should_be_absolute(tmp_path: Path, monkeypatch):
    (tmp_path / "mine.xml").touch()
    monkeypatch.chdir(tmp_path)
    with pytest.raises(MissingAssetError, match=r"mine\.xml is there: give that absolute path"):
        asset_path("mine.xml")
    assert asset_path(str(tmp_path / "mine.xml")) == tmp_path / "mine.xml"
