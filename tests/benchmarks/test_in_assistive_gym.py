# ruff: noqa: D103
"""A policy acts in Assistive Gym as it does here. Assistive Gym itself is not needed."""

from __future__ import annotations

import json
import sys
from types import SimpleNamespace

import jax
import mujoco
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from agym_jax import observe
from agym_jax.data.assets import asset_path
from agym_jax.policy.policy import read_policy
from agym_jax.robots import ROBOTS
from agym_jax.sim.scene import build_scene
from agym_jax.tasks import TASKS
from benchmarks import in_assistive_gym as ag
from benchmarks import policy_tables, smooth_bed

TURN = 2 * np.pi


@pytest.mark.parametrize("name", ["ScratchItchJaco-v0", "BedBathingSawyer-v0"])
def test_a_policy_acts_as_in_jax(name: str):
    path = asset_path(f"policies/{name}.npz")
    act, about = ag.load_actor(path)
    policy = read_policy(path)
    noise = np.random.default_rng(0).normal(size=(20, about["arch"]["observation_size"]))
    obs = (np.asarray(policy.mean) + 3.0 * noise * np.asarray(policy.std)).astype(np.float32)
    expected = jax.jit(lambda obs: policy(obs))(obs)
    np.testing.assert_allclose([act(x.astype(float)) for x in obs], expected, atol=1e-4)


def test_columns_are_where_the_tasks_have_them():
    for name, first in ag.ANGLES.items():
        layout = observe.layout(TASKS[name].robot_obs)
        assert layout["arm_angles"].start == first
        quats = [part.start for field, part in layout.items() if field.endswith("quat_w")]
        assert tuple(quats[: len(ag.QUATS.get(name, (3,)))]) == ag.QUATS.get(name, (3,))


def test_free_joints_are_those_of_the_models():
    for name, robot in ROBOTS.items():
        scene = build_scene(TASKS["ScratchItch"], robot)
        low, high = scene.model.jnt_range[scene.index.robot_joint].T
        free = tuple(np.flatnonzero(high - low > TURN + 3.5).tolist())
        assert ag.FREE[name.lower()] == free


def test_an_observation_is_without_windings_and_jumps():
    first = np.zeros(30)
    first[3:7], first[13:20] = (0.0, 0.0, 0.0, 1.0), (4.0, 1.0, -5.0, 1.0, 3.0, 1.0, 7.0)
    translate = ag.Translator("ScratchItch", "jaco", first)
    seen = translate(first)
    np.testing.assert_allclose(seen[3:7], (1.0, 0.0, 0.0, 0.0))
    np.testing.assert_allclose(seen[13:20], (4 - TURN, 1, TURN - 5, 1, 3, 1, 7 - TURN))
    later = first.copy()
    later[3:7], later[17] = (0.0, 0.0, -0.1, -0.995), 3.3
    seen = translate(later)
    np.testing.assert_allclose(seen[3:7], (0.995, 0.0, 0.0, 0.1))
    assert seen[17] == 3.3  # turned on, not back by a turn


def test_an_id_that_assistive_gym_has_not_is_refused():
    assert ag.parse("ArmManipulationPR2-v0") == ("ArmManipulation", "pr2")
    with pytest.raises(
        SystemExit, match=r"'ReachingJaco-v0' is not an id of Assistive Gym.*Dressing"
    ):
        ag.parse("ReachingJaco-v0")


def test_an_episode_follows_from_its_seed_alone():
    class Env:
        """Assistive Gym's attributes that ``reset`` sets, and limits that a former episode has left."""

        def __init__(self):
            self.human_joint_lower_limits = self.human_joint_upper_limits = [0.0]
            self.util, self.np_random = SimpleNamespace(), None
            self.world_creation = SimpleNamespace(human_creation=SimpleNamespace())

        def reset(self) -> np.ndarray:
            assert self.human_joint_lower_limits is None and self.human_joint_upper_limits is None
            parts = (self, self.util, self.world_creation, self.world_creation.human_creation)
            assert all(x.np_random is self.np_random for x in parts)
            return self.np_random.uniform(size=3)

    env = Env()
    first = ag.reset(env, 3)
    env.human_joint_lower_limits = env.human_joint_upper_limits = [1.0]
    np.testing.assert_array_equal(ag.reset(env, 3), first)
    assert not np.array_equal(ag.reset(env, 4), first)


def test_a_bed_is_changed_only_where_there_is_one():
    with pytest.raises(SystemExit, match="no bed in Feeding, only in BedBathing and ArmManip"):
        ag.main(["FeedingJaco-v0", "none.npz", "--bed-rolling", "0"])


def test_the_table_says_where_another_policy_ships_by_now(tmp_path):
    about = {"device": {"kind": "CPU"}, "time": "2030-01-01T00:00:00"}

    def write(file, *lines):
        text = "".join(json.dumps(about | line) + "\n" for line in lines)
        (tmp_path / f"{file}.jsonl").write_text(text)

    ids = ("FeedingPR2-v0", "FeedingJaco-v0")
    there = {"commit": "abcdef1", "episodes": 20, "successes": 12}
    write("in_assistive_gym", *(there | {"env": env} for env in ids))
    here = {"commit": "0123456", "success": 0.75, "policy": "mode"}
    commits = zip(ids, ("abcdef12", "9876543a"), strict=True)
    write("evaluation", *(here | {"env": env, "policy_commit": c} for env, c in commits))
    rows = policy_tables.in_assistive_gym(tmp_path).splitlines()[2:4]
    assert set(rows) == {
        "| FeedingPR2-v0 | 12 of 20 | 75% | 80% |",
        "| FeedingJaco-v0 | 12 of 20 (a former policy) | 75% |  |",
    }


def test_the_smooth_bed_has_the_shapes_of_ours():
    model = mujoco.MjModel.from_xml_path(str(asset_path("furniture/bed.xml")))
    names = [model.geom(i).name.removesuffix("_collision") for i in range(model.ngeom)]
    solid = [model.geom(i).name.endswith("_collision") for i in range(model.ngeom)]
    ours = [i for i, x in enumerate(names) if solid[i] and x not in smooth_bed.LEFT_OUT]
    found = smooth_bed.shapes()
    assert [x["kind"] for x in found].count("capsule") == 2
    assert len(found) == len(ours) == sum(solid) - len(smooth_bed.LEFT_OUT) <= smooth_bed.MOST
    for shape, i in zip(found, ours, strict=True):
        geom, rot = model.geom(i), np.zeros(9)
        mujoco.mju_quat2Mat(rot, geom.quat)
        np.testing.assert_allclose(shape["pos"], geom.pos, atol=1e-9)
        x, y, z, w = smooth_bed.quaternion(shape["rot"])
        again = np.zeros(9)
        mujoco.mju_quat2Mat(again, np.array([w, x, y, z]))
        np.testing.assert_allclose(again.reshape(3, 3), shape["rot"], atol=1e-9)
        if shape["kind"] == "box":
            np.testing.assert_allclose(shape["size"], geom.size, atol=1e-9)
            np.testing.assert_allclose(shape["rot"], rot.reshape(3, 3), atol=1e-6)
        else:  # it may be turned about its axis
            assert shape["radius"] == pytest.approx(geom.size[0])
            assert shape["length"] == pytest.approx(2 * geom.size[1])
            assert abs(shape["rot"][:, 2] @ rot.reshape(3, 3)[:, 2]) == pytest.approx(1.0)


def test_only_tasks_with_a_bed_have_a_smooth_one(tmp_path):
    with pytest.raises(SystemExit, match="no bed in Feeding, only in BedBathing and ArmManip"):
        ag.main(["FeedingJaco-v0", str(tmp_path / "policy.npz"), "--smooth-bed"])


def test_the_smooth_bed_takes_the_place_of_the_mesh_alone(monkeypatch):
    """In the frame of the mesh, whose y axis points up in the world."""
    made: list[dict] = []

    def multiply(pos, quat, other_pos, other_quat):
        turn, other = Rotation.from_quat(quat), Rotation.from_quat(other_quat)
        return np.asarray(pos) + turn.apply(other_pos), (turn * other).as_quat()

    def invert(pos, quat):
        back = Rotation.from_quat(quat).inv()
        return -back.apply(pos), back.as_quat()

    fake = SimpleNamespace(
        GEOM_BOX=3, GEOM_CAPSULE=7, createCollisionShape=lambda *_, **options: options,
        createCollisionShapeArray=lambda **options: made.append(options) or 5,
        invertTransform=invert, multiplyTransforms=multiply,
        getQuaternionFromEuler=lambda rpy: Rotation.from_euler("xyz", rpy).as_quat(),
    )  # fmt: skip
    monkeypatch.setitem(sys.modules, "pybullet", fake)
    smooth_bed.install()
    assert fake.createCollisionShape(fileName="table.obj") == {"fileName": "table.obj"}
    assert fake.createCollisionShape(fileName=f"bed/{smooth_bed.MESH}", physicsClientId=0) == 5
    shapes, (given,) = smooth_bed.shapes(), made
    assert given["shapeTypes"].count(7) == 2 and len(given["radii"]) == len(shapes)
    x, y, z = shapes[0]["pos"]
    np.testing.assert_allclose(given["collisionFramePositions"][0], [x + 0.1, z, -y], atol=1e-9)


@pytest.mark.parametrize(
    ("flags", "changes"),
    [([], None), (["--bed-rolling", "0"], {"bed_rolling": 0.0}), (["--smooth-bed"], {"smooth_bed": True})],
)  # fmt: skip
def test_a_result_tells_what_was_changed(flags, changes, tmp_path, monkeypatch):
    episode = SimpleNamespace(success=True, total=1.0, forces=(1.0, 2.0))
    monkeypatch.setattr(ag, "load_actor", lambda _: (None, {"commit": "1234567"}))
    monkeypatch.setattr(ag, "make_env", lambda *_: None)
    monkeypatch.setattr(ag, "run_episode", lambda *_: episode)
    monkeypatch.setitem(sys.modules, "smooth_bed", SimpleNamespace(install=lambda: None))
    file = tmp_path / "result.jsonl"
    ag.main(["BedBathingPR2-v0", "policy.npz", "--num-episodes", "1", "--json", str(file), *flags])
    assert json.loads(file.read_text()).get("changes") == changes
