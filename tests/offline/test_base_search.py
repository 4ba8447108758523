# ruff: noqa: D102, D103
"""Banks of start placements and the search that makes them, in C MuJoCo with everything solid."""

from __future__ import annotations

import dataclasses
import json
from dataclasses import dataclass
from functools import cache
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

import agym_jax
from agym_jax.data.banks import Placement, load_bank, load_mouths
from agym_jax.errors import MissingPlacementError, SpecError
from agym_jax.human import pose as human_pose
from agym_jax.math3d import rotation_matrix
from agym_jax.offline import placements
from agym_jax.offline.base_search import ITERATIONS, REACHED, Reach, search
from agym_jax.offline.clearance import Clearance
from agym_jax.offline.start_goals import draw_goals, goal_quat, goals_of
from agym_jax.robots import ROBOTS
from agym_jax.sim.scene import compose
from agym_jax.spec import BaseSearch, RobotSpec, Task
from agym_jax.tasks import TASKS
from agym_jax.tasks.arm_manipulation import ArmManipulation
from agym_jax.tasks.bed_bathing import BedBathing
from agym_jax.tasks.scratch_itch import ScratchItch

PAIRS = [(task, robot) for task in TASKS for robot in ROBOTS]
# tasks.md sections 2 to 8: where the steered links start, each of them +- 5 cm
START = {
    "ScratchItch": ((-0.55, 0.0, 0.8),),
    "BedBathing": ((-0.6, 0.2, 1.0),),
    "Feeding": ((-0.15, -0.65, 1.15),),  # above the bowl, which is drawn as well
    "Drinking": ((-0.2, -0.5, 1.0),),
    "Dressing": ((0.45, -0.3, 1.2),),
    "ArmManipulation": ((-0.9, 0.7, 0.8), (-0.9, -0.3, 0.8)),
    "Reaching": ((-0.15, -0.4, 1.0),),
}
TURNED = 0.06
"""Quaternions that are 0.03 apart, AG's threshold, are turned by this angle [rad]."""
JACO_STARTS = {"ScratchItch": ((-0.5, 0.0, 0.8),), "ArmManipulation": ((-0.9, 0.4, 1.0),)}


def row_of(bank: Placement, i: int) -> Placement:
    return jax.tree.map(lambda x: np.asarray(x)[i], bank)


class Stage:
    """A pair's man and woman in the pose in which an episode begins, with every shape solid."""

    def __init__(self, task: Task, robot: RobotSpec):
        self.arms = robot.arms_for(task)
        self.batch = []
        moving = task.human.moving(active=False)
        for sex in (0.0, 1.0):
            model = compose(task, robot, sex=sex, solid=True)
            data = mujoco.MjData(model)
            pose = human_pose.typical(task.human, sex)
            angles = human_pose.start_angles(pose, moving, 1.0, np)
            for joint, angle in zip(moving, angles, strict=True):
                data.qpos[model.joint(f"human/{joint}").qposadr[0]] = angle
            self.batch.append((model, data))
        self.joints = [f"robot/{j}" for arm in self.arms for j in arm.joints]

    def put(self, place: Placement) -> None:
        for model, data in self.batch:
            root = model.body_rootid[model.joint(self.joints[0]).bodyid[0]]
            model.body_pos[root], model.body_quat[root] = place.base_pos, place.base_quat
            for joint, angle in zip(self.joints, place.arm_angles, strict=True):
                data.qpos[model.joint(joint).qposadr[0]] = angle
            mujoco.mj_kinematics(model, data)

    def moves(self, model: mujoco.MjModel, body: int) -> bool:
        """Whether an arm in use carries the body."""
        while body:
            first, n = model.body_jntadr[body], model.body_jntnum[body]
            if any(model.joint(j).name in self.joints for j in range(first, first + n)):
                return True
            body = model.body_parentid[body]
        return False

    def hands(self) -> list[tuple[np.ndarray, np.ndarray]]:
        """Position and rotation matrix of each steered link."""
        _, data = self.batch[0]
        sites = [data.site(f"robot/{arm.end_effector}") for arm in self.arms]
        return [(np.array(s.xpos), np.array(s.xmat).reshape(3, 3)) for s in sites]

    def touching(self) -> list[tuple[str, str]]:
        """Geoms of the arms in use and their tools that are inside of person or furniture, and which."""
        found = []
        for model, data in self.batch:
            names = [model.geom(i).name for i in range(model.ngeom)]
            solid = [i for i, n in enumerate(names) if n and model.geom_group[i] == 3]
            mine = [i for i in solid if self.moves(model, model.geom_bodyid[i])]
            other = [i for i in solid if names[i].startswith(("human/", "seat/"))]
            assert len(mine) >= 8 and len(other) > 19
            for i in mine:
                for j in other:
                    apart = np.linalg.norm(data.geom_xpos[i] - data.geom_xpos[j])
                    if apart > model.geom_rbound[i] + model.geom_rbound[j]:
                        continue
                    if mujoco.mj_geomDistance(model, data, i, j, 0.01, None) <= 0:
                        found.append((names[i], names[j]))
        return found


@cache
def stage(task: Task, robot: RobotSpec) -> Stage:
    return Stage(task, robot)


def turned_by(rot: np.ndarray, quat: Any) -> float:
    """Angle from a rotation matrix to a quaternion wxyz [rad]."""
    m = rotation_matrix(np.array(quat), np).T @ rot
    skew = np.array([m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1]]) / 2
    return float(np.arctan2(np.linalg.norm(skew), (np.trace(m) - 1) / 2))


@pytest.mark.parametrize(("task", "robot"), PAIRS)
def test_bank_rows_respect_joint_limits_and_base_areas(task: str, robot: str):
    spec, machine = TASKS[task], ROBOTS[robot]
    bank = load_bank(spec, machine)
    arms = machine.arms_for(spec)
    n = len(bank.arm_angles)
    assert n >= 400 and bank.arm_angles.shape == (n, 7 * len(arms))
    assert all(np.isfinite(x).all() for x in (bank.base_pos, bank.base_quat, bank.arm_angles))
    model, _ = stage(spec, machine).batch[0]
    joints = [f"robot/{j}" for arm in arms for j in arm.joints]
    low, high = np.array([model.joint(j).range for j in joints]).T
    assert (bank.arm_angles >= low - 1e-5).all() and (bank.arm_angles <= high + 1e-5).all()
    free = (
        high - low > 9.5
    )  # joints that turn freely begin in one turn, with a turn's room on both sides
    assert free.sum() == {"Jaco": 4, "PR2": 2 * len(arms)}.get(robot, 0)
    assert (bank.arm_angles[:, free] >= -np.pi).all() and (bank.arm_angles[:, free] < np.pi).all()
    np.testing.assert_allclose(np.linalg.norm(bank.base_quat, axis=1), 1.0, atol=1e-6)
    fixed = machine.fixed_base(spec)
    if fixed:
        np.testing.assert_allclose(bank.base_pos, [fixed.pos] * n, atol=1e-6)
        np.testing.assert_allclose(bank.base_quat, [fixed.quat] * n, atol=1e-6)
        return
    # robots.md section 7: up to rho beside the centre, on the side of the arm that is helped or of
    # the hand that feeds; yaw within 30 degrees of facing the same way
    area = machine.base_search(task)
    rots = rotation_matrix(np.asarray(bank.base_quat), np)
    away = bank.base_pos + rots @ np.array(area.pivot) - np.array(area.centre)
    rho = 0.1 if robot == "Jaco" else 0.5
    outwards = away[:, 0] * (1 if task == "Dressing" else -1)
    assert (outwards >= -1e-5).all() and (outwards <= rho + 1e-5).all()
    assert (np.abs(away[:, 1]) <= rho + 1e-5).all() and (np.abs(away[:, 2]) < 1e-5).all()
    assert np.abs(bank.base_quat[:, 1:3]).max() < 1e-6
    yaw = 2 * np.arctan2(bank.base_quat[:, 3], bank.base_quat[:, 0])
    yaw = (yaw - (np.pi if task == "Dressing" else 0.0) + np.pi) % (2 * np.pi) - np.pi
    assert np.abs(yaw).max() <= np.deg2rad(30) + 1e-5
    assert np.ptp(bank.base_pos[:, 1]) > 0.5 * rho and np.ptp(yaw) > 0.3  # not one place only


@pytest.mark.parametrize(("task", "robot"), PAIRS)
def test_bank_rows_start_at_assistive_gyms_pose_without_contact(task: str, robot: str):
    spec, machine = TASKS[task], ROBOTS[robot]
    bank, world = load_bank(spec, machine), stage(spec, machine)
    starts = START[task]
    if robot == "Jaco":
        starts = JACO_STARTS.get(task, starts)
    clearance = Clearance(spec, machine)
    touching = {}
    picks = np.random.default_rng(0).choice(len(bank.arm_angles), 20, replace=False)
    for i in picks:
        place = row_of(bank, i)
        world.put(place)
        for (pos, rot), start in zip(world.hands(), starts, strict=False):
            drawn = 0.1 if task == "Feeding" else 0.05
            assert np.abs(pos - start).max() < drawn + REACHED, i
            assert turned_by(rot, machine.start_rotations[task]) < TURNED, i
        assert clearance.outside(place) > 0, i
        assert machine.meets_itself or clearance.inside(place) > 0, i
        if pairs := world.touching():
            touching[int(i)] = pairs
    assert not touching


def test_a_bank_tells_for_which_mouth_each_base_was_chosen():
    bank, _, mouths = search(TASKS["Drinking"], ROBOTS["PR2"], size=6, attempts=60)
    assert mouths.shape == bank.base_pos.shape
    assert np.all(np.ptp(mouths, axis=0) > 0.001) and np.all(
        np.abs(mouths - [0.0, -0.05, 1.2]) < 0.3
    )


@pytest.mark.slow
def test_pr2_reaches_the_mouth_for_which_its_base_was_chosen_and_the_nearest_one_as_often():
    """The figures of deviation start-person, of all rows: 53 %, of another person's mouth 23 %, with ``for_mouth`` 54 %."""
    task, robot = TASKS["Drinking"], ROBOTS["PR2"]
    reach, bank = Reach(task, robot, np.random.default_rng(1)), load_bank(task, robot)
    own = load_mouths(task, robot)
    assert own is not None
    upright = goal_quat(reach.goals[0][1], reach.quats[0])
    keys = jax.random.split(jax.random.PRNGKey(3), len(own))
    env = agym_jax.make("DrinkingPR2-v0", impl="native")
    starts = [env.reset(key) for key in keys[:128]]
    drawn = np.stack([np.asarray(x.episode.placement.base_pos) for x in starts])
    turned = np.stack([np.asarray(x.episode.placement.base_quat) for x in starts])
    mouths = np.stack([np.asarray(x.task.mouth_pos_w) for x in starts])

    def reached(points: np.ndarray, pos: np.ndarray, quat: np.ndarray) -> float:
        begin = np.tile(reach.rest[0], (len(points), 1))
        tries = [reach.solve(0, begin, points, upright, pos, quat, ITERATIONS)[1] for _ in range(4)]
        return float(np.mean(tries))

    pos, quat = np.asarray(bank.base_pos, float), np.asarray(bank.base_quat, float)
    of_its_own = reached(own, pos, quat)
    of_anybody = reached(np.random.default_rng(2).permutation(own), pos, quat)
    of_the_nearest = reached(mouths, drawn.astype(float), turned.astype(float))
    assert of_its_own == pytest.approx(0.53, abs=0.06)
    assert of_anybody == pytest.approx(0.23, abs=0.06)
    assert of_the_nearest == pytest.approx(of_its_own, abs=0.1)


def test_goals_are_those_of_assistive_gyms_base_search():
    """The table in robots.md section 7; orientations in tasks.md section 6."""

    def found(task: str, robot: str) -> list[list[tuple]]:
        spec, machine = TASKS[task], ROBOTS[robot]
        start = machine.start_rotations[task]
        goals = goals_of(spec, machine, len(machine.arms_for(spec)))
        return [[(g.link, g.required, goal_quat(g, start)) for g in of_arm] for of_arm in goals]

    must, free = ("mouth", True, None), ("mouth", False, None)
    for robot, machine in ROBOTS.items():
        again = ("mouth", False, machine.start_rotations["Feeding"])
        assert found("Feeding", robot) == [[again] if robot == "Baxter" else [must, again]]
        assert found("Reaching", robot) == [[must, free]]
        first, *rest = found("Dressing", robot)[0]
        h, turned = np.sqrt(0.5), machine.start_rotations["Dressing"]
        across = (-h, 0, 0, h) if robot == "PR2" else (0.5, 0.5, -0.5, 0.5)
        np.testing.assert_allclose(first[2], across, atol=1e-12)
        assert first[0] == "left_upper_arm" and [x[2] for x in rest] == [turned, turned]
    both = [[(x, False, None) for x in arm] for arm in TASKS["ArmManipulation"].goals]
    assert found("ArmManipulation", "PR2") == both
    assert found("ArmManipulation", "Jaco") == [both[0] + both[1]]


def at(points: tuple[tuple[float, float, float], ...]) -> Any:
    """A ``Task.start`` that is always the same."""
    return lambda self, key, robot: jnp.array(points)


SCRATCH_AT, WIPE_AT = ((-0.48, 0.03, 0.82),), ((-0.62, 0.17, 1.03),)
LIFT_AT = ((-0.88, 0.68, 0.83), (-0.92, -0.28, 0.79))


@dataclass(frozen=True)
class ScratchHere(ScratchItch):
    """Starts at one point, so that rows can be held against it."""

    start = at(SCRATCH_AT)


@dataclass(frozen=True)
class WipeHere(BedBathing):
    """The same, with a base to find."""

    start = at(WIPE_AT)


@dataclass(frozen=True)
class LiftHere(ArmManipulation):
    """The same, for two arms from one base."""

    start = at(LIFT_AT)


@pytest.mark.parametrize(
    ("task", "robot", "points", "size"),
    [
        (ScratchHere(), ROBOTS["Jaco"], SCRATCH_AT, 8),
        (WipeHere(), ROBOTS["Sawyer"], WIPE_AT, 8),
        (LiftHere(), ROBOTS["Baxter"], LIFT_AT, 8),
    ],
    ids=["fixed-base", "free-base", "two-arms"],
)
def test_search_finds_contact_free_start_poses(
    task: Task, robot: RobotSpec, points: tuple, size: int
):
    bank, report, mouths = search(task, robot, seed=3, size=size, attempts=50)
    n = len(bank.arm_angles)
    assert mouths is None  # not by the mouth
    assert 1 <= n <= size and n == report.kept <= report.start_reached <= report.tried
    goals = {name for names in task.goals for name in names}  # a fixed base reaches what it reaches
    assert set(report.goals_reached) == (set() if robot.fixed_base(task) else goals)
    assert all(0 < hits <= report.start_reached for hits in report.goals_reached.values())
    assert f"{n} kept" in report.table()
    world = stage(task, robot)
    for i in range(n):
        world.put(row_of(bank, i))
        for (pos, rot), point in zip(world.hands(), points, strict=True):
            assert np.linalg.norm(pos - point) < REACHED + 1e-5
            assert turned_by(rot, robot.start_rotations[task.name]) < TURNED
        assert not world.touching()


def goals_counted(robot: RobotSpec, monkeypatch: pytest.MonkeyPatch) -> tuple[int, int]:
    """Goals of ArmManipulation that 400 bases reach, and those they would if an arm could be in the robot's own body."""
    task = TASKS["ArmManipulation"]
    counts = []
    for distance in (None, 1.0):
        if distance is not None:
            monkeypatch.setattr(Clearance, "inside", lambda *_, x=distance: x)
        reach = Reach(task, robot, np.random.default_rng(1))
        starts, points = draw_goals(task, robot, reach.goals, 4, 1, reach.rng)
        reach.from_best_base(starts, points, 100)
        counts.append(sum(reach.goals_reached.values()))
    return counts[0], counts[1]


@pytest.mark.slow
def test_goals_inside_the_robots_own_body_do_not_count(monkeypatch: pytest.MonkeyPatch):
    """AG loads Sawyer with self-collision, and PR2 without."""
    counted, all_of_them = goals_counted(ROBOTS["Sawyer"], monkeypatch)
    assert 0.5 * all_of_them < counted < all_of_them
    monkeypatch.undo()
    counted, all_of_them = goals_counted(ROBOTS["PR2"], monkeypatch)
    assert counted == all_of_them


@pytest.mark.slow
def test_search_is_reproducible():
    task, robot = ScratchHere(), ROBOTS["Jaco"]
    (a, *_), (b, *_), (c, *_) = (search(task, robot, seed=s, size=4) for s in (0, 0, 1))
    np.testing.assert_array_equal(a.arm_angles, b.arm_angles)
    assert np.abs(np.asarray(a.arm_angles)[0] - np.asarray(c.arm_angles)[0]).max() > 1e-3


def test_unreachable_start_is_refused():
    far = dataclasses.replace(
        ROBOTS["Sawyer"], searches={"BedBathing": BaseSearch((-4.0, 0.0, 0.905))}
    )
    with pytest.raises(
        SpecError, match=r"Sawyer finds no free start for BedBathing: .* 0 % reach the start"
    ):
        search(WipeHere(), far, size=2, attempts=4)


def test_unreachable_goal_is_named():
    # Jaco stands beside the person's head
    task = dataclasses.replace(WipeHere(), goals=(("right_upper_arm", "left_foot"),))
    with pytest.raises(SpecError, match=r"'left_foot'.*searches\['BedBathing'\]"):
        search(task, ROBOTS["Jaco"], size=4, attempts=20)


def test_missing_bank_names_the_command():
    toybot = dataclasses.replace(ROBOTS["Jaco"], name="Toybot")
    command = r"agym-jax placements build ReachingToybot-v0"
    with pytest.raises(MissingPlacementError, match=command):
        load_bank(TASKS["Reaching"], toybot)


def test_bank_round_trip_preserves_rows(tmp_path):
    bank = load_bank(TASKS["ScratchItch"], ROBOTS["Jaco"])
    placements.save_bank(bank, tmp_path / "deep" / "bank.npz", {"seed": 7})
    with np.load(tmp_path / "deep" / "bank.npz", allow_pickle=False) as z:
        for field in dataclasses.fields(Placement):
            np.testing.assert_array_equal(z[field.name], getattr(bank, field.name))
        assert json.loads(str(z["provenance"])) == {"seed": 7}


def test_command_line_reports_every_bank_and_refuses_unknown_ids(capsys: pytest.CaptureFixture):
    assert placements.main(["report"]) == 0
    lines = capsys.readouterr().out.splitlines()
    for task, robot in PAIRS:
        (line,) = (x for x in lines if x.startswith(f"| {task}{robot} |"))
        kept = len(load_bank(TASKS[task], ROBOTS[robot]).arm_angles)
        assert line.endswith(f"| {kept} |") and line.count("|") == 6
    assert placements.main(["build", "ScratchItchJako-v0"]) == 1
    assert "Did you mean 'ScratchItchJaco-v0'" in capsys.readouterr().err
