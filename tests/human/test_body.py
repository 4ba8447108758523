# ruff: noqa: D103
"""The body: Assistive Gym's kinematics, masses and limits, and the same person in every form."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from agym_jax.errors import UnknownNameError
from agym_jax.human import anthropometry, body
from agym_jax.human import pose as human_pose
from agym_jax.human.model import build
from agym_jax.human.population import Population, sample_human
from agym_jax.human.posture import load_postures
from agym_jax.robots import ROBOTS
from agym_jax.sim.scene import build_scene, compose
from agym_jax.tasks import TASKS

TASK, ROBOT = TASKS["ScratchItch"], ROBOTS["Jaco"]
ROW = {link.name: i for i, link in enumerate(body.LINKS)}

# Reference humans.md section 5, "FK test vector": q[0..41]; entry 24 is the fixed waist.
FK_ANGLES = [
    -0.148, 0.37, -0.075, 0.748, 0.956, 0.077, -0.499, -0.856, -0.463, 0.174, 0.063, 0.038, -0.145,
    -0.94, -0.424, 0.819, -0.787, -0.096, 0.862, -0.788, 0.14, 0.786, -0.32, 0.097, 0.0, 0.385,
    -0.384, 0.025, 0.143, 0.294, -0.091, 0.205, 0.014, -0.096, -0.101, -0.443, 0.458, 0.442, 0.314,
    0.119, -0.192, 0.006,
]  # fmt: skip
# link: position [m], quaternion xyzw (as PyBullet prints it)
FK_POSES = {
    "right_hand": ((-0.51456, 0.37505, 0.94574), (-0.18653, 0.65306, -0.39616, 0.61788)),
    "left_hand": ((0.51929, -0.40259, 0.99133), (-0.19524, -0.64108, 0.28737, 0.68433)),
    "head": ((0, -0.01912, 1.28716), (0.4335, -0.16375, -0.02825, 0.8857)),
    "right_foot": ((0.01928, 0.52825, -0.02698), (0.36152, -0.06663, -0.07729, 0.92676)),
    "left_foot": ((-0.00699, 0.12464, -0.1014), (0.21986, -0.01273, 0.11743, 0.96835)),
}
# Reference humans.md section 5, "World positions", rows Scratch male and female.
SCRATCH = {
    "male": {
        "chest": (0, 0.03, 0.89),
        "right_upper_arm": (-0.179, 0.03, 1.0315), "right_forearm": (-0.3185, 0.03, 0.7899),
        "right_hand": (-0.3185, -0.26, 0.7899), "left_upper_arm": (0.179, 0.03, 1.0315),
        "left_forearm": (0.2033, 0.03, 0.7536), "left_hand": (0.2033, -0.26, 0.7536),
        "head": (0, 0.03, 1.1785), "mouth": (0, -0.08, 1.2085), "hips": (0, 0.03, 0.6528),
        "right_shin": (-0.089, -0.394, 0.5715), "right_foot": (-0.089, -0.4683, 0.15),
    },
    "female": {
        "chest": (0, 0.03, 0.86),
        "right_upper_arm": (-0.159, 0.03, 0.992), "right_forearm": (-0.291, 0.03, 0.7634),
        "right_hand": (-0.291, -0.231, 0.7634), "left_upper_arm": (0.159, 0.03, 0.992),
        "left_forearm": (0.182, 0.03, 0.729), "left_hand": (0.182, -0.231, 0.729),
        "head": (0, 0.03, 1.112), "mouth": (0, -0.07, 1.142), "hips": (0, 0.03, 0.635),
        "right_shin": (-0.092, -0.361, 0.56), "right_foot": (-0.092, -0.4286, 0.1764),
    },
}  # fmt: skip
SEX = {"male": 0.0, "female": 1.0}


def _same_rotation(a: np.ndarray, b: np.ndarray, tolerance: float) -> bool:
    return min(np.abs(a - b).max(), np.abs(a + b).max()) < tolerance


def _fk_angles() -> dict[str, float]:
    return dict(zip(body.JOINTS, FK_ANGLES[:24] + FK_ANGLES[25:], strict=True))


def _check_fk(pos: dict[str, np.ndarray], quat: dict[str, np.ndarray]) -> None:
    for link, (p, xyzw) in FK_POSES.items():
        # the reference rounds angles to 1e-3 rad (1 mm at 1 m); measured difference 0.4 mm
        np.testing.assert_allclose(pos[link], p, atol=1.5e-3, err_msg=link)
        assert _same_rotation(quat[link], np.roll(xyzw, 1), 2e-3), (link, quat[link], xyzw)


def test_welded_person_has_the_reference_kinematics():
    rows = body.fields(anthropometry.dims(0.0), _fk_angles(), (), 1.0, np.array([0, 0, 1.0]), xp=np)
    _check_fk(
        {n: rows.body_pos[i] for n, i in ROW.items()},
        {n: rows.body_quat[i] for n, i in ROW.items()},
    )


def test_person_of_hinges_has_the_reference_kinematics():
    d, free = anthropometry.dims(0.0), tuple(body.JOINTS)
    rows = body.fields(d, {}, free, 1.0, np.array([0, 0, 1.0]), xp=np)
    model = build(rows, free, d, tuple(ROW), False).compile()
    assert model.nq == 41  # humans.md section 1: 41 revolute joints
    data = mujoco.MjData(model)
    for name, angle in _fk_angles().items():
        data.qpos[model.joint(name).qposadr] = angle
    mujoco.mj_kinematics(model, data)
    _check_fk({n: data.body(n).xpos for n in ROW}, {n: data.body(n).xquat for n in ROW})


@pytest.mark.parametrize("who", SCRATCH)
def test_scratch_pose_is_the_reference_table(who: str):
    d = anthropometry.dims(SEX[who])
    root = np.array([0, 0.03, anthropometry.sitting_height(d, SEX[who], 1.0, 1.0)])
    rows = body.fields(d, TASK.human.pose, (), 1.0, root, xp=np)
    pos = {n: rows.body_pos[i] for n, i in ROW.items()}
    pos["mouth"] = pos["head"] + [0, d.mouth_y, d.mouth_z]
    for link, expected in SCRATCH[who].items():
        # four decimals in the table
        np.testing.assert_allclose(pos[link], expected, atol=1e-4, err_msg=f"{who} {link}")


@pytest.mark.parametrize("who", SCRATCH)
def test_compiled_scene_seats_the_person_as_the_reference_does(who: str):
    model = compose(TASK, ROBOT, sex=SEX[who], visual=True)
    data = mujoco.MjData(model)
    for name, angle in TASK.human.pose.items():
        if name in TASK.human.joints:
            data.qpos[model.joint(f"human/{name}").qposadr] = angle
    mujoco.mj_kinematics(model, data)
    for link, expected in SCRATCH[who].items():
        if link != "mouth":
            found = data.body(f"human/{link}").xpos
            np.testing.assert_allclose(found, expected, atol=1e-4, err_msg=f"{who} {link}")


def _seated(
    sex: float, stature: float = 1.0, girth: float = 1.0, scale: float = 1.0
) -> body.BodyFields:
    """Rows of a person who sits as ScratchItch wants, welded but for the right arm."""
    d, pose = anthropometry.dims(sex, stature, girth), TASK.human
    sits = human_pose.typical(pose, sex, stature, girth)
    return human_pose.rows(pose, sits, d, pose.joints, scale, np)


@pytest.mark.parametrize(("who", "mass"), [("male", 78.4), ("female", 62.5)])
def test_masses(who: str, mass: float):
    # humans.md section 1: sum of all masses; section 2: the limbs' shares
    rows = _seated(SEX[who])
    np.testing.assert_allclose(rows.body_mass.sum(), mass, rtol=1e-9)
    for link, share in {"chest": 0.1, "right_upper_arm": 0.033, "left_hand": 0.0065}.items():
        np.testing.assert_allclose(rows.body_mass[ROW[link]], share * mass, rtol=1e-9)
    # AG scales mass with height and the square of radii
    big = anthropometry.dims(SEX[who], 1.1, 0.9)
    np.testing.assert_allclose(big.mass, mass * 1.1 * 0.81, rtol=1e-9)


@pytest.mark.parametrize(
    ("joint", "axis", "lower", "upper", "scaled"),
    [  # humans.md section 2
        ("r_clavicle_y", 1, -10, 30, True), ("l_clavicle_y", 1, -30, 10, True),
        ("r_shoulder_y", 1, 5, 198, True), ("r_shoulder_x", 0, -188, 61, True),
        ("l_shoulder_y", 1, -198, -5, True), ("r_elbow_x", 0, -128, 0, True),
        ("r_forearm_roll_z", 2, -90, 90, True), ("l_wrist_y", 1, -47, 27, True),
        ("neck_x", 0, -10, 20, True), ("head_z", 2, -70, 70, True),
        ("pelvis_x", 0, -75, 30, False), ("r_hip_y", 1, -40, 45, False),
        ("l_knee_x", 0, 0, 130, False), ("r_ankle_z", 2, -43, 35, False),
    ],
)  # fmt: skip
def test_joint_table(joint: str, axis: int, lower: float, upper: float, scaled: bool):
    assert np.argmax(body.JOINTS[joint].axis) == axis
    np.testing.assert_allclose(
        np.rad2deg(body.joint_limits((joint,), 1.0, np)[0]), (lower, upper), atol=1e-4
    )
    # humans.md section 6: both limits are multiplied, legs and pelvis keep theirs
    factor = 0.5 if scaled else 1.0
    np.testing.assert_allclose(
        np.rad2deg(body.joint_limits((joint,), 0.5, np)[0]),
        (factor * lower, factor * upper),
        atol=1e-4,
    )


def test_there_are_41_hinges_in_the_reference_order():
    assert len(body.JOINTS) == 41
    assert list(body.JOINTS)[:10] == list(body.RIGHT_ARM)
    assert list(body.JOINTS)[20:24] == list(body.HEAD)


def test_unknown_joint_is_named_with_the_nearest():
    with pytest.raises(UnknownNameError, match=r"human joint 'r_elbow'.*Did you mean 'r_elbow_x'"):
        body.joint_limits(("r_elbow",))


def test_limits_clamp_the_welded_pose():
    # humans.md section 5: elbow -90 degrees becomes -64 at scale 0.5; hips, unscaled, stay at -90;
    # section 2: the left shoulder, at -5 because it cannot be 0, goes to -2.5
    quat = body.fields(anthropometry.dims(0.0), TASK.human.pose, (), 0.5, xp=np).body_quat
    for parent, child, axis, degrees in (
        ("left_upper_arm", "left_forearm", 0, -64),
        ("hips", "right_thigh", 0, -90),
        ("left_girdle", "left_upper_arm", 1, -2.5),
    ):
        half = np.deg2rad(degrees) / 2
        expected = np.zeros(4)
        expected[0], expected[1 + axis] = np.cos(half), np.sin(half)
        found = _relative(quat, ROW[parent], ROW[child])
        np.testing.assert_allclose(found, expected, atol=1e-6, err_msg=child)


def _relative(quat: np.ndarray, parent: int, child: int) -> np.ndarray:
    inverse, out = np.zeros(4), np.zeros(4)
    mujoco.mju_negQuat(inverse, quat[parent])
    mujoco.mju_mulQuat(out, inverse, quat[child])
    return out


@pytest.mark.parametrize(("radius", "length"), [(0.043, 0.279), (0.127, 0.01), (0.05, 0.0)])
def test_capsule_inertia_is_the_integral_over_its_volume(radius: float, length: float):
    ends = radius + length / 2
    z, dz = np.linspace(-ends, ends, 200_001, retstep=True)
    beyond = np.maximum(np.abs(z) - length / 2, 0.0)
    area = np.pi * np.maximum(radius**2 - beyond**2, 0.0)  # of the slice at height z
    volume = area.sum() * dz
    along = (area**2 / (2 * np.pi)).sum() * dz / volume
    across = along / 2 + (area * z**2).sum() * dz / volume
    middle = (0.0, 0.0, 0.0)
    for axis, turned in (("z", (2, 0, 1)), ("x", (0, 1, 2)), ("y", (1, 2, 0))):
        moments = np.array(body.solid_inertia(body.Shape(axis, radius, length, middle), 3.0))
        np.testing.assert_allclose(
            moments[list(turned)], [3 * along, 3 * across, 3 * across], rtol=1e-6
        )


def _somebody(seed: int) -> tuple[float, float, float, float]:
    rng = np.random.default_rng(seed)
    return (
        rng.uniform(-0.2, 1.2), rng.uniform(0.92, 1.08), rng.uniform(0.9, 1.15), rng.uniform(0.5, 1)
    )  # fmt: skip


@pytest.mark.parametrize("task", TASKS.values(), ids=TASKS)
@pytest.mark.parametrize("seed", range(3))
def test_jax_numpy_and_compiled_model_are_the_same_person(seed: int, task):
    sex, stature, girth, scale = _somebody(seed)
    spec, moving = task.human, task.human.moving(False)
    d, pose = (
        anthropometry.dims(sex, stature, girth),
        human_pose.typical(spec, sex, stature, girth, scale),
    )
    rows = human_pose.rows(spec, pose, d, moving, scale, np)
    args = [jnp.float32(x) for x in (sex, stature, girth)]
    in_jax = human_pose.rows(
        spec, jax.tree.map(jnp.asarray, pose), anthropometry.dims(*args), moving,
        jnp.float32(scale), jnp,
    )  # fmt: skip
    for name, a, b in zip(rows._fields, rows, in_jax, strict=True):
        np.testing.assert_allclose(b, a, atol=2e-6, rtol=2e-6, err_msg=name)  # float32
    model = compose(task, ROBOT, False, sex, stature, girth, scale)
    index = build_scene(task, ROBOT).index
    where = {"body": index.human_body, "geom": index.human_geom, "jnt": index.human_joint}
    kept = {"body": index.human_row, "geom": index.shape_row, "jnt": slice(None)}
    for name, a in zip(rows._fields, rows, strict=True):
        found = getattr(model, name)[where[name.split("_")[0]]]
        mine = a[kept[name.split("_")[0]]]
        if name == "body_quat":
            mine = mine / np.linalg.norm(mine, axis=-1, keepdims=True)
        if name == "geom_size":  # MuJoCo leaves what a sphere does not use at 0
            assert (mine[:, 0] > 0).all()
        np.testing.assert_allclose(found, mine, atol=1e-7, err_msg=name)
    # the inertias are written without their frames, so those have to be the links' own
    np.testing.assert_allclose(
        model.body_iquat[index.human_body], [[1, 0, 0, 0]] * len(index.human_body)
    )


@pytest.mark.parametrize("seed", range(5))
def test_thighs_stay_on_the_seat_whatever_the_size(seed: int):
    sex, stature, girth, _ = _somebody(10 + seed)
    rows = _seated(sex, stature, girth)
    underside = rows.body_pos[ROW["right_thigh"]][2]
    underside -= anthropometry.dims(sex, stature, girth).thigh_r
    # male 0.89 - 0.156 - 2 * 0.08125 - 0.08 = 0.4915, female 0.86 - 0.15 - 2 * 0.075 - 0.0775
    np.testing.assert_allclose(underside, 0.4915 + sex * (0.4825 - 0.4915), atol=1e-6)


@pytest.mark.parametrize("who", SEX)
def test_people_in_bed_lie_on_its_mattress(who: str):
    # tasks.md sections 3, 7: heads towards +y, settled at about z 0.875 (furniture.md section 3)
    spec = TASKS["BedBathing"].human
    d, pose = anthropometry.dims(SEX[who]), human_pose.typical(spec, SEX[who])
    rows = human_pose.rows(spec, pose, d, (), 1.0, np)
    chest, head, foot = (rows.body_pos[ROW[n]] for n in ("chest", "head", "right_foot"))
    np.testing.assert_allclose(chest, (-0.15, 0.2, 0.875), atol=0.06)
    assert head[1] > chest[1] + 0.2 and foot[1] < chest[1] - 0.9
    for link, sign in (("right_upper_arm", -1), ("left_upper_arm", 1)):  # face up
        assert sign * (rows.body_pos[ROW[link]][0] - chest[0]) > 0.1


def test_start_angles_keep_to_the_persons_limits():
    spec = TASKS["ScratchItch"].human
    pose = human_pose.typical(spec, 0.0)
    free = human_pose.start_angles(pose, spec.joints, 1.0, np)
    stiff = human_pose.start_angles(pose, spec.joints, 0.5, np)
    # shoulder 30, elbow -90 degrees; narrowed by half the elbow stops at -64
    expected = np.zeros(10)
    expected[[3, 6]] = np.deg2rad((30, -90))
    np.testing.assert_allclose(free, expected, atol=1e-6)
    expected[6] = np.deg2rad(-64)
    np.testing.assert_allclose(stiff, expected, atol=1e-6)
    assert human_pose.start_angles(pose, (), 1.0, np).shape == (0,)


def test_drawn_heads_turn_within_their_range():
    # tasks.md section 8: head as Feeding, angles 21 to 23 uniform within 30 degrees
    spec = TASKS["Reaching"].human
    humans = jax.vmap(lambda k: sample_human(k, Population(), 4, 0.0, ("none",)))
    keys = jax.random.split(jax.random.PRNGKey(0), 1000)
    poses = jax.vmap(lambda k, p: human_pose.sample_pose(k, spec, p))(keys, humans(keys))
    angles = np.rad2deg(np.asarray(poses.angles))
    order = list(body.JOINTS)
    head = angles[:, [order.index(j) for j in ("head_x", "head_y", "head_z")]]
    assert np.abs(head).max() <= 30 + 1e-4 and (np.abs(head).max(0) > 29).all()
    assert np.abs(np.corrcoef(head.T)[np.triu_indices(3, 1)]).max() < 0.15
    for joint, angle in {"r_elbow_x": -90, "l_knee_x": 80, "neck_x": 0}.items():
        np.testing.assert_allclose(angles[:, order.index(joint)], angle, atol=1e-4)


def test_drawn_people_in_bed_lie_as_somebody_of_their_size_did():
    spec = TASKS["BedBathing"].human
    bank = load_postures(spec.postures)
    keys = jax.random.split(jax.random.PRNGKey(0), 64)
    humans = jax.vmap(lambda k: sample_human(k, Population(), 0, 0.0, ("none",)))(keys)
    poses = jax.vmap(lambda k, p: human_pose.sample_pose(k, spec, p))(keys, humans)
    rows = [np.abs(bank.angles - a).max(1).argmin() for a in np.asarray(poses.angles)]
    np.testing.assert_array_equal(bank.angles[rows], poses.angles)
    assert len(set(rows)) > 8  # of several who did
    assert np.abs(bank.sex[rows] - humans.sex).max() < 0.3
