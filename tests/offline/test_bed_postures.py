# ruff: noqa: D103
"""Banks of postures on the bed: valid, without penetration or gaps, and close to Assistive Gym's."""

from __future__ import annotations

import json
from pathlib import Path

import jax
import mujoco
import numpy as np
import pytest

from agym_jax.data.assets import asset_path
from agym_jax.errors import AgymError, MissingPostureError
from agym_jax.furniture import BED
from agym_jax.human import body, posture
from agym_jax.human import pose as human_pose
from agym_jax.human.population import Human, Population, sample_human
from agym_jax.human.pose import BodyPose
from agym_jax.human.posture import link_positions, load_postures, posture_path
from agym_jax.offline import bed_postures, posture_report
from agym_jax.robots import ROBOTS
from agym_jax.sim.scene import compose
from agym_jax.tasks import TASKS as ALL_TASKS

TRACES = Path(__file__).parents[2] / "benchmarks" / "parity" / "traces"


@pytest.mark.parametrize(
    ("words", "text"),
    [
        (["--each", "0"], "--each must be a whole number of at least 1, got 0"),
        (["--seed", "-1"], "--seed must be a whole number of at least 0, got -1"),
        (["BedBathing", "Bathing"], "'Bathing'"),
    ],
)
def test_what_cannot_be_built_is_refused_before_anything_is(words, text, monkeypatch, capsys):
    monkeypatch.setattr(bed_postures, "_build", lambda *_: pytest.fail("built"))
    assert bed_postures.main(["build", *words]) == 1
    assert text in capsys.readouterr().err


TASKS = tuple(bed_postures.SCENARIOS)
EACH = 128
ROWS = 6 * EACH
SAMPLE = 24
EDGE = 0.009  # of an arm that AG has lying on its mattress's edge, above ours [m]
MOST_INSIDE, MOST_ABOVE = 0.04, 0.007  # of AG's people, where they do not move, of our mattress [m]


def _drawn(name: str, humans: Population, count: int) -> tuple[Human, BodyPose]:
    """People of a task and their poses, as sampled in episodes; leaves in float64 (count, ...)."""
    spec = ALL_TASKS[name].human

    def one(key: jax.Array) -> tuple[Human, BodyPose]:
        who, how = jax.random.split(key)
        human = sample_human(who, humans, len(spec.joints), 0.0, spec.impairments)
        return human, human_pose.sample_pose(how, spec, human)

    keys = jax.random.split(jax.random.PRNGKey(0), count)
    return jax.tree.map(lambda x: np.asarray(x, float), jax.jit(jax.vmap(one))(keys))


def _gaps_in_the_scene(name: str, human: Human, pose: BodyPose) -> dict[str, float]:
    """Distance of every link of a person from the bed as an episode begins [m]."""
    task = ALL_TASKS[name]
    scale, moving = float(human.limit_scale), task.human.moving(False)
    size = (float(human.sex), float(human.stature), float(human.girth))
    model = compose(task, ROBOTS["Jaco"], False, *size, scale, pose=pose, solid=True)
    data = mujoco.MjData(model)
    angles = human_pose.start_angles(pose, moving, scale, np)
    for joint, angle in zip(moving, angles, strict=True):
        data.qpos[model.joint(f"human/{joint}").qposadr[0]] = angle
    mujoco.mj_kinematics(model, data)
    bed = [model.geom(f"seat/{x}").id for x in _collision_geoms_of_the_bed()]
    return {
        x: min(mujoco.mj_geomDistance(model, data, model.geom(f"human/{x}").id, g, 0.5, None) for g in bed)
        for x in body.LINK
    }  # fmt: skip


def _assert_rests(gap: dict[str, float], recorded: bool) -> None:
    """A person neither lies inside the bed nor floats; those of AG's sizes lie as on its own mattress."""
    arm = min(bed_postures.ARM_LINKS, key=gap.__getitem__)
    assert gap[arm] >= -bed_postures.MAX_PENETRATION, (arm, gap[arm])
    worst = min(gap, key=gap.__getitem__)
    assert gap[worst] >= -(MOST_INSIDE if recorded else bed_postures.MAX_PENETRATION), (worst, gap)
    floats = MOST_ABOVE if recorded else bed_postures.MAX_GAP
    assert min(gap["chest"], gap["waist"], gap["hips"]) <= floats, gap


def _collision_geoms_of_the_bed() -> list[str]:
    bed = mujoco.MjModel.from_xml_path(str(asset_path(BED.model)))
    names = [bed.geom(i).name for i in range(bed.ngeom)]
    return [x for x in names if x.endswith("_collision")]


@pytest.mark.parametrize("name", TASKS)
def test_bank_has_valid_fields_and_order(name: str):
    bank = load_postures(name)
    assert all(leaf.dtype == np.float32 for leaf in jax.tree.leaves(bank))
    assert [leaf.shape for leaf in jax.tree.leaves(bank)] == [
        (ROWS,), (ROWS,), (ROWS,), (ROWS,), (ROWS, 3), (ROWS, 4), (ROWS, 41),
    ]  # fmt: skip
    for sex, rows in ((0.0, slice(0, 2 * EACH)), (1.0, slice(2 * EACH, 4 * EACH))):
        assert (bank.sex[rows] == sex).all()
        assert (bank.stature[rows] == 1).all()
        assert (bank.girth[rows] == 1).all()
    # population.Population(sizes="continuous")
    for sizes, low, high in (
        (bank.sex, -0.2, 1.2), (bank.stature, 0.92, 1.08), (bank.girth, 0.9, 1.15),
    ):  # fmt: skip
        drawn = sizes[4 * EACH :]
        assert (drawn >= np.float32(low)).all()
        assert (drawn <= np.float32(high)).all()
        assert np.ptp(drawn) > 0.8 * (high - low)
    np.testing.assert_allclose(np.linalg.norm(bank.root_quat, axis=1), 1.0, atol=1e-6)
    for part, scales in enumerate(bank.limit_scale.reshape(6, EACH)):
        if part % 2:
            # as evenly as the people whom AG settled allow
            atol = 0.005 if part > 3 else 0.04
            np.testing.assert_allclose(scales, np.linspace(0.5, 1.0, EACH), atol=atol)
        else:
            assert (scales == 1).all()
    for scale, angles in zip(bank.limit_scale, bank.angles, strict=True):
        low, high = body.joint_limits(tuple(body.JOINTS), scale, np).T.astype(np.float32)
        assert (angles >= low).all()
        assert (angles <= high).all()
    with np.load(posture_path(name), allow_pickle=False) as z:
        provenance = json.loads(str(z["provenance"]))
    assert provenance["counts"]["kept"] == ROWS
    assert f"build {name}" in provenance["command"]


@pytest.mark.parametrize("name", TASKS)
def test_settled_people_neither_penetrate_nor_float(name: str):
    bank = load_postures(name)
    for i in np.linspace(0, ROWS - 1, SAMPLE).astype(int):
        gap = bed_postures.clearances(bank.row(i))
        _assert_rests(gap, recorded=i < 4 * EACH)
        assert gap["head"] < 0.04, (i, gap["head"])  # on the pillow


@pytest.mark.parametrize("name", TASKS)
def test_settled_angles_are_within_limits(name: str):
    bank, spec, checked = load_postures(name), ALL_TASKS[name].human, 0
    for i in np.flatnonzero(bank.limit_scale < 1)[::11]:
        row = bank.row(i)
        pose = BodyPose(row.root_pos, row.root_quat, row.angles)
        clipped = human_pose.start_angles(pose, tuple(body.JOINTS), row.limit_scale, np)
        np.testing.assert_allclose(clipped, row.angles, atol=1e-6)
        rows = human_pose.rows(spec, pose, row.dims, (), row.limit_scale, np)
        expected = list(link_positions(row).values())
        np.testing.assert_allclose(rows.body_pos, expected, atol=1e-6)
        checked += 1
    assert checked > 30


@pytest.mark.parametrize("name", TASKS)
def test_sampled_posture_has_similar_size_and_limits(name: str):
    bank = load_postures(name)
    human, pose = _drawn(name, Population(impairments=("none", "limits")), 256)
    rows = [int(np.abs(bank.angles - a).max(1).argmin()) for a in pose.angles]
    np.testing.assert_array_equal(bank.angles[rows], pose.angles)
    for field in ("sex", "stature", "girth"):
        np.testing.assert_array_equal(getattr(bank, field)[rows], getattr(human, field))
    np.testing.assert_allclose(bank.limit_scale[rows], human.limit_scale, atol=0.04)
    whole = human.limit_scale == 1
    assert (bank.limit_scale[rows][whole] == 1).all()
    assert 100 < whole.sum() < 156
    assert len(set(np.array(rows)[whole])) > 60  # of 256, at random
    joints = tuple(body.JOINTS)
    for angles, scale in zip(pose.angles, human.limit_scale, strict=True):
        low, high = np.rad2deg(body.joint_limits(joints, scale, np)).T
        over = np.maximum(low - np.rad2deg(angles), np.rad2deg(angles) - high).max()
        assert over < 0.5, (scale, over)


@pytest.mark.parametrize("name", TASKS)
def test_people_rest_on_the_bed_at_episode_start(name: str):
    humans = Population(impairments=("none", "limits", "weakness", "tremor"))
    humans, poses = _drawn(name, humans, 64)
    assert (humans.limit_scale < 1).sum() > 8
    arms = []
    for i in range(64):
        human, pose = jax.tree.map(lambda x: x[i], (humans, poses))  # noqa: B023
        gap = _gaps_in_the_scene(name, human, pose)
        _assert_rests(gap, recorded=True)
        arms.append(min(gap[x] for x in body.RIGHT_ARM_LINKS))
    # after AG's 2 s most arms lie on the bed; some still move
    assert np.mean(np.array(arms) <= EDGE) > 0.6, arms
    assert max(arms) < 0.05


def test_scene_is_built_with_full_joint_limits():
    for name in TASKS:
        bank = load_postures(name)
        for sex in (0.0, 1.0):
            pose = human_pose.typical(ALL_TASKS[name].human, sex)
            (row,) = np.flatnonzero((bank.angles == pose.angles).all(1))
            assert (bank.sex[row], bank.limit_scale[row]) == (sex, 1)


def test_arms_lie_on_the_bed_or_hang_by_task():
    lying, hanging = (load_postures(name) for name in TASKS)
    rows = range(0, ROWS, 37)
    gaps = [bed_postures.clearances(lying.row(i)) for i in rows]
    on_bed = [min(g["right_upper_arm"], g["right_forearm"], g["right_hand"]) for g in gaps]
    assert np.mean(np.array(on_bed) < 0.002) > 0.6
    links = [link_positions(hanging.row(i)) for i in rows]
    assert all(x["right_forearm"][0] < -0.5 for x in links)  # beyond the edge,
    assert np.mean([x["right_hand"][2] < 0.65 for x in links]) > 0.9  # below the mattress's top,
    gaps = [bed_postures.clearances(hanging.row(i))["right_upper_arm"] for i in rows]
    assert np.mean(np.array(gaps) < EDGE) > 0.6  # on whose edge the upper arm rests


@pytest.mark.parametrize("name", TASKS)
@pytest.mark.parametrize("sex", [0, 1])
def test_settled_people_match_assistive_gym(name: str, sex: int):
    found = posture_report.statistics(load_postures(name), sex)
    for key, values in posture_report.AG[name].items():
        mean = found[key][0]
        if key in body.LINK:
            # humans.md has 25 resets, both sexes together; benchmarks/parity/bed.py compares with more
            atol = {"right_hand": 0.05, "right_forearm": 0.03, "right_shin": 0.03}.get(key, 0.02)
            np.testing.assert_allclose(mean, values[sex], atol=atol, err_msg=f"{key} {sex}")
        elif key in ("r_shoulder_y", "r_shoulder_x", "r_elbow_x"):
            assert abs(mean - values[sex]) < 15, (key, mean, values[sex])


@pytest.mark.slow
@pytest.mark.parametrize("name", TASKS)
def test_people_of_ag_sizes_lie_as_recorded(name: str):
    recorded = bed_postures.read_recorded(TRACES / f"settled_{name}.npz")
    rows, unfit = bed_postures.recorded_rows(recorded, EACH)
    assert unfit < 0.1 * len(recorded.sex)
    bank = load_postures(name)
    np.testing.assert_array_equal(bank.angles[: 4 * EACH], bed_postures.bank_of(rows).angles)
    np.testing.assert_array_equal(bank.root_pos[: 4 * EACH], bed_postures.bank_of(rows).root_pos)
    with pytest.raises(AgymError, match="for part 1 of a bank, not 1000"):
        bed_postures.recorded_rows(recorded, 1000)


def test_missing_recording_is_named(tmp_path):
    with pytest.raises(MissingPostureError, match=r"recording of settled people.*none\.npz"):
        bed_postures.read_recorded(tmp_path / "none.npz")


def test_arm_hangs_where_it_was_dropped_for_two_seconds():
    how = bed_postures.SCENARIOS["ArmManipulation"]
    row = load_postures("ArmManipulation").row(4 * EACH)
    again = bed_postures.drop_arm(row, how)
    arm = [list(body.JOINTS).index(j) for j in body.RIGHT_ARM]
    others = np.setdiff1d(np.arange(len(body.JOINTS)), arm)
    np.testing.assert_array_equal(again.angles[others], row.angles[others])
    np.testing.assert_array_equal(again.root_pos, row.root_pos)
    moved, before = (link_positions(x)["right_forearm"] for x in (again, row))
    np.testing.assert_allclose(moved, before, atol=0.06)  # from another start of forearm and hand


def test_people_settle_with_the_masses_and_friction_of_assistive_gym():
    row = load_postures("BedBathing").row(0)
    model = bed_postures.lying_model(row, tuple(body.JOINTS), 2.5, falling=True)
    arm = model.body("human/right_upper_arm")
    np.testing.assert_allclose(arm.ipos, 0.0)
    # ag_traces: upper arm 2.587 kg, (0.030, 0.030, 0.003) kg m2
    assert arm.mass[0] == pytest.approx(2.587, rel=1e-3)
    np.testing.assert_allclose(arm.inertia, (0.0303, 0.0303, 0.0032), atol=1e-4)
    assert (model.dof_damping == 0).all() and (model.dof_armature == 0).all()
    assert model.body_mass.sum() == pytest.approx(78.4, rel=1e-3)
    bed = [i for i in range(model.npair) if "bed/" in model.geom(model.pair_geom2[i]).name]
    np.testing.assert_allclose(model.pair_friction[bed], 2.5)
    assert (model.pair_dim[bed] == 6).all()


def test_self_collision_mask_matches_assistive_gym():
    # humans.md section 3, "Self-collision mask"
    assert bed_postures.may_collide("right_hand", "chest")
    assert bed_postures.may_collide("right_forearm", "left_hand")
    assert bed_postures.may_collide("head", "left_upper_arm")
    assert bed_postures.may_collide("right_hand", "right_thigh")
    assert bed_postures.may_collide("left_thigh", "right_thigh")
    assert bed_postures.may_collide("left_girdle", "right_upper_arm")
    assert not bed_postures.may_collide("right_girdle", "right_upper_arm")
    assert not bed_postures.may_collide("right_hand", "right_forearm")
    assert not bed_postures.may_collide("right_thigh", "hips")
    assert not bed_postures.may_collide("left_shin", "waist")
    assert not bed_postures.may_collide("head", "chest")


def test_settling_is_reproducible():
    banks = [bed_postures.build_bank("ArmManipulation", seed=5, each=1)[0] for _ in range(2)]
    for a, b in zip(*map(jax.tree.leaves, banks), strict=True):
        np.testing.assert_array_equal(a, b)


def test_bank_without_accepted_falls_is_refused(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(bed_postures, "settle", lambda *_: "fell off the bed")
    with pytest.raises(AgymError, match="fell off the bed"):
        bed_postures.build_bank("BedBathing", each=1)


def test_missing_and_damaged_banks_name_file_and_remedy(monkeypatch, tmp_path):
    with pytest.raises(
        MissingPostureError, match=r"Sleeping\.npz.*agym-jax postures build Sleeping"
    ):
        load_postures("Sleeping")
    monkeypatch.setattr(posture, "posture_path", lambda name: tmp_path / f"{name}.npz")
    for name in ("Torn", "Short", "Nan"):
        bank = load_postures.__wrapped__
        path = tmp_path / f"{name}.npz"
        arrays = {k: np.zeros((2, *shape[1:]), np.float32) for k, shape in posture.SHAPES.items()}
        if name == "Short":
            arrays["angles"] = arrays["angles"][:1]
        if name == "Nan":
            arrays["root_pos"][0] = np.nan
        np.savez_compressed(path, **arrays)
        if name == "Torn":
            path.write_bytes(path.read_bytes()[:200])
        with pytest.raises(
            MissingPostureError, match=rf"{name}\.npz.*agym-jax postures build {name}"
        ):
            bank(name)


def test_bed_assets_have_the_names_that_tasks_use():
    bed = mujoco.MjModel.from_xml_path(str(asset_path(BED.model)))
    assert {*BED.geoms} <= {bed.geom(i).name for i in range(bed.ngeom)}
    assert (bed.geom_contype == 0).all()
    stand = mujoco.MjModel.from_xml_path(str(asset_path("furniture/nightstand.xml")))
    box = stand.geom("nightstand_collision")
    np.testing.assert_allclose(box.pos[2] + box.size[2], 0.073)  # the robot's foot is sunk into it
    np.testing.assert_allclose(box.pos[2] - box.size[2], -0.6)  # and it stands on the floor
    for tool, mass, tip in (("wiper", 3.0, (0, 0, -0.0425)), ("scooper", 1.0, (-0.04, 0.05, 0))):
        model = mujoco.MjModel.from_xml_path(str(asset_path(f"tools/{tool}.xml")))
        assert model.body(tool).mass[0] == mass  # furniture.md sections 9 and 10
        np.testing.assert_allclose(model.site("tool_tip").pos, tip)
        np.testing.assert_allclose(model.site("grasp").pos, 0.0)
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    for i in range(1, 7):
        geom = model.geom(f"scooper_{i}_collision")
        np.testing.assert_allclose(geom.size[0] + geom.size[1], 0.040)  # the blade's half width
        np.testing.assert_allclose(np.abs(data.geom(geom.id).xmat[8]), 1.0)  # along z
