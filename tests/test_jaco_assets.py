"""The Jaco, wheelchair, mount, scratcher and stage models agree with the tables they come from."""

import json
from pathlib import Path

import mujoco
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

ROOT = Path(__file__).resolve().parents[1]
ASSETS = ROOT / "assets"
TABLE = json.loads((ROOT / "tests" / "data" / "jaco_table.json").read_text())
ARM = [f"j2s7s300_joint_{i}" for i in range(1, 8)]
FINGERS = [f"j2s7s300_joint_finger_{i}" for i in range(1, 4)]
BODIES = [name for name in TABLE["links"] if name != "j2s7s300_end_effector"]
FILES = (
    "robots/jaco.xml",
    "furniture/wheelchair.xml",
    "furniture/jaco_mount.xml",
    "tools/scratcher.xml",
    "scene.xml",
)
# Joint angles, end-effector position, quaternion xyzw (base at the origin, fingers at 0).
FK = {
    "zeros": ((0,) * 7, (0, -0.0098, -0.0872), (1, 0, 0, 0)),
    "ramp": (
        (0.1, 0.2, 0.3, -0.4, 0.5, -0.6, 0.7),
        (-0.08794, 0.02149, -0.12519),
        (0.9655, 0.23587, 0.02933, -0.10633),
    ),
}


def load(path):
    """Compile one asset."""
    return mujoco.MjModel.from_xml_path(str(ASSETS / path))


def geom_names(model):
    """Names of all geoms, in order."""
    return [model.geom(i).name for i in range(model.ngeom)]


@pytest.fixture(scope="module")
def jaco():
    """The arm alone."""
    return load("robots/jaco.xml")


@pytest.fixture(scope="module")
def wheelchair():
    """The wheelchair alone."""
    return load("furniture/wheelchair.xml")


def posed(model, q=None):
    """Data at the given arm angles, all else zero."""
    data = mujoco.MjData(model)
    if q is not None:
        data.qpos[[model.joint(name).qposadr[0] for name in ARM]] = q
    mujoco.mj_forward(model, data)
    return data


def rotation(xmat):
    """A MuJoCo 3x3 matrix as a rotation."""
    return Rotation.from_matrix(np.reshape(xmat, (3, 3)))


def degrees_between(a, b):
    """Angle between two rotations."""
    return np.degrees((a.inv() * b).magnitude())


@pytest.mark.parametrize("pose", FK)
@pytest.mark.parametrize("site", ["j2s7s300_end_effector", "tool_frame"])
def test_forward_kinematics(jaco, pose, site):
    """The hand is where the URDF's forward kinematics puts it."""
    q, position, quat = FK[pose]
    frame = posed(jaco, q).site(site)
    assert np.linalg.norm(frame.xpos - position) < 1e-3
    assert degrees_between(rotation(frame.xmat), Rotation.from_quat(quat)) < 0.1


def test_every_frame_follows_the_joint_table(jaco):
    """All links, fingers included, at random angles: an independent walk over the table."""
    rng = np.random.default_rng(0)
    data = mujoco.MjData(jaco)
    angles = {name: rng.uniform(-1, 1) for name in ARM} | {
        name: rng.uniform(0, 2) for name in FINGERS
    }
    for name, angle in angles.items():
        data.qpos[jaco.joint(name).qposadr[0]] = angle
    mujoco.mj_forward(jaco, data)
    frames = {"j2s7s300_link_base": (np.zeros(3), Rotation.identity())}
    for name, joint in TABLE["joints"].items():  # the table lists parents first
        at, turn = frames[joint["parent"]]
        child = turn * Rotation.from_euler("xyz", joint["rpy"])
        child = child * Rotation.from_rotvec([0, 0, angles.get(name, 0.0)])
        frames[joint["child"]] = (at + turn.apply(joint["xyz"]), child)
    for link, (at, turn) in frames.items():
        frame = data.site(link) if link == "j2s7s300_end_effector" else data.body(link)
        assert np.linalg.norm(frame.xpos - at) < 1e-6, link
        assert degrees_between(rotation(frame.xmat), turn) < 1e-4, link


def test_bodies_and_joints_keep_their_names(jaco):
    """The tree has the links and joints of the URDF, and no others."""
    assert {jaco.body(i).name for i in range(1, jaco.nbody)} == set(BODIES)
    assert [jaco.joint(i).name for i in range(jaco.njnt)] == ARM + FINGERS
    for name, joint in TABLE["joints"].items():
        if joint["child"] in BODIES:
            child = jaco.body(joint["child"])
            assert jaco.body(child.parentid[0]).name == joint["parent"], name


@pytest.mark.parametrize("name", ARM + FINGERS)
def test_joint_range(jaco, name):
    """Ranges are the table's; torque limits are left to the scene."""
    joint, row = jaco.joint(name), TABLE["joints"][name]
    assert bool(jaco.jnt_limited[joint.id])
    assert not jaco.jnt_actfrclimited[joint.id]
    np.testing.assert_allclose(joint.range, (row["lower"], row["upper"]), atol=1e-9)
    np.testing.assert_array_equal(joint.axis, (0, 0, 1))


@pytest.mark.parametrize("name", BODIES)
def test_inertial(jaco, name):
    """Mass, COM and inertia tensor of each link."""
    body, row = jaco.body(name), TABLE["links"][name]
    assert body.mass[0] == pytest.approx(row["mass"], rel=1e-9)
    np.testing.assert_allclose(body.ipos, row["com"], atol=1e-9)
    axes = Rotation.from_quat(body.iquat[[1, 2, 3, 0]]).as_matrix()
    tensor = axes @ np.diag(body.inertia) @ axes.T
    np.testing.assert_allclose(tensor, np.diag(row["inertia"]), rtol=1e-6, atol=1e-13)


def boxes_of(geom_name):
    """The table's boxes that a collision geom must stay in, in the frame of its body."""
    if geom_name.startswith("finger_"):
        number = geom_name.split("_")[1]
        proximal = np.array(TABLE["links"][f"j2s7s300_link_finger_{number}"]["aabb"])
        tip = np.array(TABLE["links"][f"j2s7s300_link_finger_tip_{number}"]["aabb"])
        tip = tip + TABLE["joints"][f"j2s7s300_joint_finger_tip_{number}"]["xyz"]
        return np.array([np.minimum(proximal[0], tip[0]), np.maximum(proximal[1], tip[1])])
    return np.array(TABLE["links"]["j2s7s300_" + geom_name.removesuffix("_collision")]["aabb"])


def capsule_box(model, geom):
    """Bounding box of a capsule in the frame of its body."""
    axis = Rotation.from_quat(geom.quat[[1, 2, 3, 0]]).apply((0, 0, geom.size[1]))
    reach = np.abs(axis) + geom.size[0]
    return np.array([geom.pos - reach, geom.pos + reach])


def test_one_capsule_per_moving_link(jaco):
    """Each capsule fits its link's box, neither outside it nor much shorter."""
    expected = [f"link_{i}_collision" for i in range(1, 8)] + [
        f"finger_{i}_collision" for i in range(1, 4)
    ]
    assert [name for name in geom_names(jaco) if name.endswith("_collision")] == expected
    for name in expected:
        geom = jaco.geom(name)
        assert geom.type[0] == mujoco.mjtGeom.mjGEOM_CAPSULE
        assert (
            jaco.body(geom.bodyid[0]).name
            == "j2s7s300_" + {"l": "", "f": "link_"}[name[0]] + name[:-10]
        )
        box, fitted = boxes_of(name), capsule_box(jaco, geom)
        assert np.all(fitted[0] > box[0] - 0.015) and np.all(fitted[1] < box[1] + 0.015), name
        # ... nor much shorter than the box along its longest side
        longest = np.argmax(box[1] - box[0])
        assert np.ptp(fitted[:, longest]) > np.ptp(box[:, longest]) - 0.02, name


@pytest.mark.parametrize("path", FILES)
def test_nothing_collides_by_default(path):
    """Contacts are opt-in: a scene names its pairs."""
    model = load(path)
    assert model.npair == 0 and model.nmesh == 0 and model.nu == 0 and model.nkey == 0
    assert not model.geom_contype.any() and not model.geom_conaffinity.any()
    for i, name in enumerate(geom_names(model)):
        assert model.geom_group[i] == (3 if name.endswith("_collision") else 2), name


@pytest.mark.parametrize("path", FILES)
def test_only_the_robot_and_the_tool_have_mass(path):
    """Looks weigh nothing."""
    expected = {
        "robots/jaco.xml": sum(TABLE["links"][name]["mass"] for name in BODIES),
        "tools/scratcher.xml": 0.11,
    }
    assert load(path).body_mass.sum() == pytest.approx(expected.get(path, 0.0), abs=1e-9)


def test_torso_reference(jaco):
    """The observations' reference point on the base."""
    site = jaco.site("torso_reference")
    assert jaco.body(site.bodyid[0]).name == "j2s7s300_link_base"
    np.testing.assert_allclose(posed(jaco).site("torso_reference").xpos, (0, 0, 0.1255), atol=1e-9)


def test_fingers_close_around_the_tool_axis(jaco):
    """A positive finger angle brings every finger tip nearer to the approach axis."""

    def spread(angle):
        data = mujoco.MjData(jaco)
        for name in FINGERS:
            data.qpos[jaco.joint(name).qposadr[0]] = angle
        mujoco.mj_forward(jaco, data)
        frame = data.site("tool_frame")
        turn = rotation(frame.xmat)
        tips = []
        for i in range(1, 4):
            tip = data.body(f"j2s7s300_link_finger_tip_{i}")
            end = tip.xpos + rotation(tip.xmat).apply((0.04, 0, 0))
            tips.append(turn.inv().apply(end - frame.xpos))
        return np.linalg.norm(np.array(tips)[:, :2], axis=1)

    assert np.all(spread(1.0) < spread(0.0) - 0.02)


def test_scratcher():
    """Inertial of the handle, rod and tip together; sites and contact geoms."""
    model = load("tools/scratcher.xml")
    parts = [(0.05, 0.0), (0.05, 0.05), (0.01, 0.075)]  # mass, x of the handle, rod, tip
    own = [
        np.full(3, 0.05 * 0.05**2 / 6),
        0.05 * np.array([0.01**2 / 2, *[(3 * 0.01**2 + 0.05**2) / 12] * 2]),
        np.full(3, 0.4 * 0.01 * 0.01**2),
    ]
    mass = sum(m for m, _ in parts)
    com = sum(m * x for m, x in parts) / mass
    tensor = sum(
        i + m * (x - com) ** 2 * np.array([0, 1, 1]) for i, (m, x) in zip(own, parts, strict=True)
    )
    body = model.body("scratcher")
    assert body.mass[0] == pytest.approx(mass)
    np.testing.assert_allclose(body.ipos, (com, 0, 0), atol=1e-6)
    np.testing.assert_allclose(body.iquat, (1, 0, 0, 0), atol=1e-9)
    np.testing.assert_allclose(body.inertia, tensor, rtol=1e-4)
    np.testing.assert_allclose(model.site("tool_tip").pos, (0.075, 0, 0))
    np.testing.assert_allclose(model.site("grasp").pos, (0, 0, 0))
    rod = capsule_box(model, model.geom("scratcher_rod_collision"))
    np.testing.assert_allclose(rod, [(0.025, -0.01, -0.01), (0.085, 0.01, 0.01)], atol=1e-9)
    assert model.geom("scratcher_handle_collision").size[0] == pytest.approx(0.03)


def test_scratcher_looks_stay_in_the_tool():
    """No visual geom reaches past the sphere and capsule that touch things."""
    model = load("tools/scratcher.xml")
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    for i in np.flatnonzero(model.geom_group == 2):
        half = np.abs(rotation(data.geom_xmat[i]).as_matrix()) @ model.geom_aabb[i, 3:]
        assert data.geom_xpos[i, 0] + half[0] <= 0.0851
        assert data.geom_xpos[i, 0] - half[0] >= -0.0301
        assert max(half[1:]) <= (0.03 if data.geom_xpos[i, 0] < 0.03 else 0.0101)


def drop(model, x, y, group):
    """Height of the first surface of a geom group under (x, y)."""
    data = posed(model)
    groups = np.zeros(6, np.uint8)
    groups[group] = 1
    hit = np.zeros(1, np.int32)
    distance = mujoco.mj_ray(
        model, data, np.array([x, y, 2.0]), np.array([0.0, 0, -1]), groups, 1, -1, hit
    )
    assert distance > 0
    return 2.0 - distance, model.geom(hit[0]).name


@pytest.mark.parametrize("side, sign", [("right", -1), ("left", 1)])
@pytest.mark.parametrize("y", [-0.165, -0.073, 0.02])
def test_armrest_height(wheelchair, side, sign, y):
    """A ray from above meets contact geoms and pad at the armrest top."""
    for part, x in (("inner", 0.245), ("outer", 0.298)):
        height, name = drop(wheelchair, sign * x, y, group=3)
        assert height == pytest.approx(0.719, abs=2e-3)
        assert name == f"armrest_{side}_{part}_collision"
    height, _ = drop(wheelchair, sign * 0.2715, y, group=2)  # the pad one sees
    assert height == pytest.approx(0.719, abs=2e-3)


def test_armrest_extent(wheelchair):
    """The two capsules span the measured pad."""
    for side, sign in (("right", -1), ("left", 1)):
        pair = [
            capsule_box(wheelchair, wheelchair.geom(f"armrest_{side}_{part}_collision"))
            for part in ("inner", "outer")
        ]
        x = sorted(np.abs([box[:, 0] for box in pair]).ravel())
        assert x[0] == pytest.approx(0.211, abs=1e-6) and x[-1] == pytest.approx(0.332, abs=1e-6)
        for box in pair:
            assert np.all(np.sign(box[:, 0]) == sign)
            np.testing.assert_allclose(box[:, 1], (-0.205, 0.059), atol=1e-6)


def test_wheelchair_leaves_room_for_the_person(wheelchair):
    """Cushion under the thighs (underside 0.4915), backrest behind the hips (y 0.1635)."""
    data = posed(wheelchair)
    for x in (-0.089, 0.089):
        for y in (-0.24, -0.15, 0.0):
            assert 0.40 < drop(wheelchair, x, y, group=2)[0] < 0.4915
            assert drop(wheelchair, x, y, group=3)[0] < 0.4915
    assert {"seat_collision", "backrest_collision"} <= set(geom_names(wheelchair))
    for height in np.linspace(0.53, 1.0, 8):
        for group in (2, 3):
            groups = np.zeros(6, np.uint8)
            groups[group] = 1
            start, forward = np.array([0.0, -0.2, height]), np.array([0.0, 1, 0])
            back = mujoco.mj_ray(
                wheelchair, data, start, forward, groups, 1, -1, np.zeros(1, np.int32)
            )
            if back > 0:
                assert -0.2 + back > 0.1635 - 0.015, (height, group)


def test_root_bodies_stand_still():
    """One unrotated static root per asset."""
    for path, name in (
        ("robots/jaco.xml", "j2s7s300_link_base"),
        ("furniture/wheelchair.xml", "wheelchair"),
        ("furniture/jaco_mount.xml", "jaco_mount"),
        ("tools/scratcher.xml", "scratcher"),
    ):
        model = load(path)
        body = model.body(name)
        assert body.parentid[0] == 0 and body.jntnum[0] == 0
        assert np.sum(model.body_parentid[1:] == 0) == 1
        np.testing.assert_array_equal(body.pos, 0)
        np.testing.assert_array_equal(body.quat, (1, 0, 0, 0))


def test_stage_has_its_cameras_and_floor():
    """Cameras look at what they are for."""
    model = load("scene.xml")
    assert [model.camera(i).name for i in range(model.ncam)] == ["front", "side", "close"]
    assert "floor" in geom_names(model) and model.nlight == 2
    assert (model.vis.global_.offwidth, model.vis.global_.offheight) == (1280, 960)
    data = posed(model)
    targets = {"front": (0, 0, 0.7), "side": (-0.1, -0.1, 0.7), "close": (-0.35, -0.1, 0.8)}
    for name, target in targets.items():
        camera = data.camera(name)
        seen = rotation(camera.xmat).inv().apply(np.array(target) - camera.xpos)
        assert seen[2] < 0  # cameras look along -z
        assert np.degrees(np.arctan2(np.hypot(*seen[:2]), -seen[2])) < 10
