# ruff: noqa: D101, D102, D103
"""Which placements meet which settled people: a table of distances, and the command that adds it to a bank."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import jax
import mujoco
import numpy as np
import pytest

from agym_jax.data import banks
from agym_jax.data.assets import asset_root
from agym_jax.data.banks import Placement, load_bank, load_meets
from agym_jax.human import pose as human_pose
from agym_jax.human.posture import Postures, load_postures
from agym_jax.offline import met_people, placements
from agym_jax.offline.met_people import meets_of
from agym_jax.robots import ROBOTS
from agym_jax.sim.index import ancestors
from agym_jax.sim.scene import compose
from agym_jax.spec import RobotSpec, Task
from agym_jax.tasks import TASKS

LYING = [name for name, task in TASKS.items() if task.human.postures]


def rows_of(bank: Any, rows: list[int]) -> Any:
    return jax.tree.map(lambda x: np.asarray(x)[rows], bank)


def slowly(task: Task, robot: RobotSpec, bank: Placement, human: Postures) -> np.ndarray:
    """Whether the placements meet a person whose scene is compiled anew: every pair of shapes is measured (K,)."""
    pose = human_pose.lying(human, (), human.dims, np)
    size = {k: float(getattr(human, k)) for k in ("sex", "stature", "girth", "limit_scale")}
    model = compose(task, robot, pose=pose, solid=True, **size)
    data = mujoco.MjData(model)
    joints = [f"robot/{j}" for arm in robot.arms_for(task) for j in arm.joints]
    moving = task.human.moving(active=False)
    angles = human_pose.start_angles(pose, moving, size["limit_scale"], np)
    for name, angle in zip(moving, angles, strict=True):
        data.qpos[model.joint(f"human/{name}").qposadr[0]] = angle
    first = {int(model.joint(j).bodyid[0]) for j in joints}
    names = [model.geom(i).name for i in range(model.ngeom)]
    moved = [
        i for i, n in enumerate(names) if n.startswith(("robot/", "tool")) and "collision" in n
    ]
    moved = [i for i in moved if first & ancestors(model, int(model.geom_bodyid[i]))]
    people = [i for i, n in enumerate(names) if n.startswith("human/")]
    assert len(moved) >= 8 and len(people) == 21
    root = model.body_rootid[min(first)]
    found = []
    for k in range(len(bank.arm_angles)):
        model.body_pos[root], model.body_quat[root] = bank.base_pos[k], bank.base_quat[k]
        for name, angle in zip(joints, bank.arm_angles[k], strict=True):
            data.qpos[model.joint(name).qposadr[0]] = angle
        mujoco.mj_kinematics(model, data)
        gaps = (mujoco.mj_geomDistance(model, data, i, j, 0.1, None) for i in moved for j in people)
        found.append(min(gaps) < 0.0)
    return np.array(found)


@pytest.mark.parametrize("robot", ["Jaco", "PR2"])  # one arm; two, and shapes of other kinds
@pytest.mark.parametrize("task", LYING)
def test_the_table_is_what_compiled_scenes_say(task: str, robot: str):
    """With the robot 10 to 50 cm nearer to the person, so that many of its arms are inside them."""
    spec, machine = TASKS[task], ROBOTS[robot]
    bank = rows_of(load_bank(spec, machine), list(range(0, 512, 43)))
    nearer = np.linspace(0.1, 0.5, len(bank.arm_angles))[:, None] * np.array([1.0, 0.0, 0.0])
    bank = dataclasses.replace(bank, base_pos=bank.base_pos + nearer)
    people = rows_of(load_postures(spec.human.postures), [3, 372, 600, 740])
    table = meets_of(spec, machine, bank, people)
    assert table.shape == (4, 12)
    for i, found in enumerate(table):
        np.testing.assert_array_equal(found, slowly(spec, machine, bank, people.row(i)), str(i))
    assert 3 < table.sum() < 45


@pytest.mark.parametrize("robot", ROBOTS)
@pytest.mark.parametrize("task", LYING)
def test_the_shipped_table_is_of_the_shipped_banks(task: str, robot: str):
    spec, machine = TASKS[task], ROBOTS[robot]
    bank, people = load_bank(spec, machine), load_postures(spec.human.postures)
    table = load_meets(spec, machine, len(people.sex))
    assert table is not None and not table.all(axis=1).any()  # everybody can be begun with
    worst = int(table.mean(axis=1).argmax())
    rows = [*np.flatnonzero(table[worst])[:10].tolist(), *range(0, 512, 50)]
    found = meets_of(spec, machine, rows_of(bank, rows), rows_of(people, [worst, 700]))
    np.testing.assert_array_equal(found, table[np.ix_([worst, 700], rows)])


# -- the file --------------------------------------------------------------------------------------


@pytest.fixture
def own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder of the user's own banks."""
    monkeypatch.setenv(banks.VARIABLE, str(tmp_path))
    return tmp_path


def test_the_command_adds_a_table_and_changes_nothing_else(own: Path, monkeypatch, capsys):
    table = np.random.default_rng(0).random((768, 512)) < 0.01
    monkeypatch.setattr(placements, "meets_of", lambda *_: table)
    assert placements.main(["meet", "BedBathingJaco-v0"]) == 0
    assert f"{100 * table.mean():.3f} % of 768 postures x 512" in capsys.readouterr().out
    with (
        np.load(own / "BedBathingJaco.npz", allow_pickle=False) as new,
        np.load(asset_root() / "placements" / "BedBathingJaco.npz", allow_pickle=False) as old,
    ):
        assert set(new.files) == set(old.files) | {"meets"}
        for name in set(old.files) - {"meets"}:
            assert new[name].dtype == old[name].dtype
            np.testing.assert_array_equal(new[name], old[name])
        np.testing.assert_array_equal(new["meets"], table)
    np.testing.assert_array_equal(load_meets(TASKS["BedBathing"], ROBOTS["Jaco"], 768), table)


def test_building_a_bank_writes_its_table_where_people_lie(own: Path, monkeypatch):
    task, robot = TASKS["BedBathing"], ROBOTS["Jaco"]
    monkeypatch.setattr(
        met_people, "load_postures", lambda _: rows_of(load_postures("BedBathing"), [372, 0])
    )
    for name in ("BedBathingJaco-v0", "ReachingJaco-v0"):
        recipe = placements.parse(name)
        bank = rows_of(load_bank(recipe.task, recipe.robot), [0, 1, 2, 3])
        monkeypatch.setattr(placements, "search", lambda *_, bank=bank: (bank, REPORT, None))
        assert placements.main(["build", name, "--size", "4"]) == 0
    table = load_meets(task, robot, 2)
    assert table is not None and table.shape == (2, 4) and not table[1].any()
    assert load_meets(TASKS["Reaching"], robot, 2) is None


def test_seated_people_need_no_table(capsys):
    assert placements.main(["meet", "ReachingJaco-v0"]) == 1
    assert "Nobody lies in settled postures in Reaching" in capsys.readouterr().err


@dataclasses.dataclass(frozen=True)
class Report:
    kept: int = 4

    def table(self) -> str:
        return ""


REPORT = Report()
