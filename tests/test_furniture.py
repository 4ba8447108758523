# ruff: noqa: D103
"""Furniture, tools and the stage agree with reference furniture.md (lengths in metres)."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import mujoco
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from agym_jax.furniture import BED, WHEELCHAIR
from agym_jax.robots import ROBOTS
from agym_jax.sim.scene import compose
from agym_jax.spec import Pose
from agym_jax.tasks import TASKS

ASSETS = Path(__file__).resolve().parents[1] / "assets"
FURNITURE = ("wheelchair", "jaco_mount", "bed", "nightstand")
TOOLS = {"scratcher": 0.11, "wiper": 3.0, "scooper": 1.0}  # masses, sections 8 to 10
FILES = (
    *(f"furniture/{x}.xml" for x in FURNITURE), *(f"tools/{x}.xml" for x in TOOLS), "scene.xml"
)  # fmt: skip
SPECS = {task.tool.name: task.tool for task in TASKS.values() if task.tool}
VISUALS, SOLIDS = 2, 3
ARMS_ALONE = 4  # group of what people's arms alone meet
FRONTS = {x for robot in ROBOTS.values() for names in robot.mount_fronts.values() for x in names}
OUTLINES = set(TASKS["BedBathing"].seat.outline)
# section 3: heights z(x, y) of the bed
BED_Y = (-0.9, -0.7, -0.5, -0.3, -0.1, 0.1, 0.3, 0.5, 0.6, 0.7)
BED_Z = {
    -0.6: (0.571, 0.594, 0.605, 0.601, 0.598, 0.593, 0.589),
    -0.4: (0.709, 0.736, 0.747, 0.747, 0.745, 0.739, 0.732, 0.825, 0.849, 0.798),
    -0.3: (0.725, 0.752, 0.755, 0.758, 0.749, 0.741, 0.733, 0.822, 0.848, 0.821),
    -0.2: (0.721, 0.752, 0.760, 0.759, 0.753, 0.745, 0.732, 0.814, 0.833, 0.792),
    0.0: (0.721, 0.754, 0.763, 0.764, 0.757, 0.748, 0.741),  # then the gap between pillows
    0.1: (0.718, 0.754, 0.762, 0.765, 0.758, 0.749, 0.747, 0.838, 0.822, 0.816),
    0.2: (0.705, 0.741, 0.755, 0.757, 0.754, 0.751, 0.745, 0.822, 0.809, 0.812),
}
# section 10: the scooper's convex pieces 1 to 6: x and y from, to; all of them z from -0.04 to 0.04
PIECES = (
    ((-0.019, 0.050), (0, 0.012)), ((-0.057, -0.019), (0.002, 0.018)),
    ((-0.069, -0.036), (0.018, 0.027)), ((-0.081, -0.053), (0.027, 0.041)),
    ((-0.086, -0.068), (0.041, 0.057)), ((-0.086, -0.079), (0.057, 0.075)),
)  # fmt: skip


@cache
def load(path: str) -> mujoco.MjModel:
    return mujoco.MjModel.from_xml_path(str(ASSETS / path))


def furniture(name: str) -> mujoco.MjModel:
    return load(f"furniture/{name}.xml")


def tool(name: str) -> mujoco.MjModel:
    return load(f"tools/{name}.xml")


def at_rest(model: mujoco.MjModel) -> mujoco.MjData:
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    return data


def geom_names(model: mujoco.MjModel) -> list[str]:
    return [model.geom(i).name for i in range(model.ngeom)]


def boxes(model: mujoco.MjModel, group: int) -> np.ndarray:
    """Least and greatest corner of every geom of a group in the world (n, 2, 3)."""
    data, out = at_rest(model), []
    for i in np.flatnonzero(model.geom_group == group):
        turn = data.geom_xmat[i].reshape(3, 3)
        middle = data.geom_xpos[i] + turn @ model.geom_aabb[i, :3]
        half = np.abs(turn) @ model.geom_aabb[i, 3:]
        if model.geom_type[i] == mujoco.mjtGeom.mjGEOM_CAPSULE:
            half = np.abs(turn[:, 2]) * model.geom_size[i, 1] + model.geom_size[i, 0]
        out.append((middle - half, middle + half))
    return np.array(out)


def ray(model: mujoco.MjModel, start, direction, group: int) -> tuple[float, str]:
    """Distance to the first surface of a group, -1 if there is none, and its name."""
    groups, hit = np.zeros(6, np.uint8), np.zeros(1, np.int32)
    groups[group] = 1
    along = mujoco.mj_ray(
        model,
        at_rest(model),
        np.array(start, float),
        np.array(direction, float),
        groups,
        1,
        -1,
        hit,
    )
    return along, model.geom(hit[0]).name if along >= 0 else ""


def drop(model: mujoco.MjModel, x: float, y: float, group: int) -> tuple[float, str]:
    """Height of the first surface of a geom group under (x, y)."""
    along, name = ray(model, (x, y, 2.0), (0, 0, -1), group)
    assert along > 0, (x, y)
    return 2.0 - along, name


@pytest.mark.parametrize("path", FILES)
def test_nothing_collides_by_default(path: str, capfd: pytest.CaptureFixture):
    """Contacts are opt-in: a scene names its pairs."""
    model = mujoco.MjModel.from_xml_path(str(ASSETS / path))
    assert "warning" not in "".join(capfd.readouterr()).lower()
    assert model.npair == model.nmesh == model.nu == model.nkey == model.njnt == 0
    assert not model.geom_contype.any() and not model.geom_conaffinity.any()
    for i, name in enumerate(geom_names(model)):
        group = SOLIDS if name.endswith("_collision") else VISUALS
        assert model.geom_group[i] == (ARMS_ALONE if name in FRONTS | OUTLINES else group), name


@pytest.mark.parametrize("path", FILES)
def test_only_tools_have_mass(path: str):
    """Looks weigh nothing."""
    mass = TOOLS.get(path.removeprefix("tools/").removesuffix(".xml"), 0.0)
    assert load(path).body_mass.sum() == pytest.approx(mass, abs=1e-9)


@pytest.mark.parametrize("path", FILES[:-1])
def test_root_bodies_stand_still(path: str):
    """One unrotated static root per asset, of the file's name."""
    model = load(path)
    body = model.body(Path(path).stem)
    assert body.parentid[0] == 0 and np.sum(model.body_parentid[1:] == 0) == 1
    np.testing.assert_array_equal([*body.pos, *body.quat], (0, 0, 0, 1, 0, 0, 0))


# -- tools -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", TOOLS)
def test_tools_have_what_their_specs_name(name: str):
    spec, model = SPECS[name], tool(name)
    assert spec.model == f"tools/{name}.xml" and 1 <= spec.n_working <= len(spec.geoms)
    outline = [spec.outline] if spec.outline else []
    for geom in (*spec.geoms, *outline):
        kind = mujoco.mjtGeom(model.geom(geom).type[0])
        assert kind in (mujoco.mjtGeom.mjGEOM_CAPSULE, mujoco.mjtGeom.mjGEOM_SPHERE), geom
    assert {n for n in geom_names(model) if n} == {*spec.geoms, *outline}
    # "tool position": the tip's link 1, the cloth's link 1, the tool link's centre of mass
    tip = {"scratcher": (0.075, 0, 0), "wiper": (0, 0, -0.0425), "scooper": (-0.04, 0.05, 0)}[name]
    np.testing.assert_allclose(model.site(spec.tip).pos, tip, atol=1e-9)
    np.testing.assert_allclose(model.site("grasp").pos, 0, atol=1e-9)
    # the tip's axes are the tool's: it is their orientation that is observed
    np.testing.assert_allclose(model.site(spec.tip).quat, (1, 0, 0, 0), atol=1e-9)


def rod_inertia(mass: float, radius: float, length: float) -> np.ndarray:
    across = (3 * radius**2 + length**2) / 12
    return mass * np.array([radius**2 / 2, across, across])


def box_inertia(mass: float, x: float, y: float, z: float) -> np.ndarray:
    return mass / 12 * np.array([y * y + z * z, x * x + z * z, x * x + y * y])


# mass, place of its centre, moments about it: of every part that AG's Bullet simulates
PARTS = {
    "scratcher": [
        (0.05, (0, 0, 0), box_inertia(0.05, 0.05, 0.05, 0.05)),
        (0.05, (0.05, 0, 0), rod_inertia(0.05, 0.01, 0.05)),
        (0.01, (0.075, 0, 0), np.full(3, 0.4 * 0.01 * 0.01**2)),
    ],
    "wiper": [
        (1.0, (0, 0, 0), box_inertia(1.0, 0.04, 0.04, 0.06)),
        (1.0, (0, 0, -0.035), box_inertia(1.0, 0.1, 0.05, 0.01)),
        (1.0, (0, 0, -0.0425), box_inertia(1.0, 0.05, 0.025, 0.005)),
    ],
    # Bullet: the moments of the bounding box
    "scooper": [(1.0, (-0.04, 0.05, 0), box_inertia(1.0, 0.19, 0.1, 0.08))],
}


@pytest.mark.parametrize("name", TOOLS)
def test_tools_weigh_as_their_parts_together(name: str):
    parts = PARTS[name]
    mass = sum(m for m, _, _ in parts)
    com = sum(m * np.array(c) for m, c, _ in parts) / mass
    away = [np.array(c) - com for _, c, _ in parts]
    moments = sum(i + m * (r @ r - r**2) for (m, _, i), r in zip(parts, away, strict=True))
    body = tool(name).body(name)
    assert body.mass[0] == pytest.approx(mass)
    np.testing.assert_allclose(body.ipos, com, atol=1e-6)
    turn = Rotation.from_quat(body.iquat[[1, 2, 3, 0]]).as_matrix()
    tensor = turn @ np.diag(body.inertia) @ turn.T
    np.testing.assert_allclose(tensor, np.diag(moments), rtol=1e-4, atol=1e-9)


def test_scratcher_touches_with_its_rod():
    model = tool("scratcher")
    assert SPECS["scratcher"].geoms[0] == "scratcher_rod_collision"
    rod, handle = (boxes(model, SOLIDS)[geom_names(model).index(f"scratcher_{x}_collision")] for x in ("rod", "handle"))  # fmt: skip
    np.testing.assert_allclose(rod, [(0.025, -0.01, -0.01), (0.085, 0.01, 0.01)], atol=1e-9)
    np.testing.assert_allclose(handle, [[-0.03] * 3, [0.03] * 3], atol=1e-9)
    for low, high in boxes(model, VISUALS):  # no look reaches past what touches
        assert low[0] >= -0.0301 and high[0] <= 0.0851
        assert max(high[1:]) <= (0.03 if low[0] + high[0] < 0.06 else 0.0101)


def test_wiper_faces_down_with_its_pad():
    """Rims of the cloth's and the plate's lower faces: what wipes is touched first."""
    model, spec = tool("wiper"), SPECS["wiper"]
    assert spec.parts == (4, 4) and spec.n_working == 4 and "pad" in spec.geoms[0]
    # section 9: cloth box 0.05 x 0.025 x 0.005 at z -0.0425, plate 0.1 x 0.05 x 0.01 at -0.035
    sizes = {"pad": (0.025, 0.0125, -0.045), "plate": (0.05, 0.025, -0.04)}
    for part, (x, y, z) in sizes.items():
        rims = boxes(model, SOLIDS)[
            [i for i, n in enumerate(geom_names(model)) if f"_{part}_" in n]
        ]
        assert len(rims) == 4
        np.testing.assert_allclose(rims[:, 0].min(0), (-x, -y, z), atol=1e-9)
        np.testing.assert_allclose(rims[:, 1].max(0), (x, y, z + 0.002), atol=1e-9)
        # each lies along one side, over its whole length
        sides = sorted(tuple(np.round((high - low)[:2], 4)) for low, high in rims)
        assert sides == [(0.002, 2 * y), (0.002, 2 * y), (2 * x, 0.002), (2 * x, 0.002)]
    (outline,) = boxes(model, SOLIDS)[[geom_names(model).index(spec.outline)]]
    np.testing.assert_allclose(outline[0], (-0.05, -0.0125, -0.045), atol=1e-9)
    visuals = boxes(model, VISUALS)
    # handle box up to z 0.02; sides of the plate
    np.testing.assert_allclose(visuals[:, 0].min(0), (-0.05, -0.025, -0.045), atol=6e-3)
    assert (visuals[:, 1].max(0) < (0.052, 0.027, 0.06)).all()


def test_scooper_is_lined_with_capsules_across_its_blade():
    model = tool("scooper")
    assert SPECS["scooper"].n_working == len(SPECS["scooper"].geoms) == 6
    inside = lambda x, y: any(  # noqa: E731
        a - 3e-3 <= x <= b + 3e-3 and c - 3e-3 <= y <= d + 3e-3 for (a, b), (c, d) in PIECES
    )
    middles = []
    for geom in SPECS["scooper"].geoms:
        low, high = boxes(model, SOLIDS)[[geom_names(model).index(geom)]][0]
        np.testing.assert_allclose((low[2], high[2]), (-0.04, 0.04), atol=2e-3)
        middles.append((low + high)[:2] / 2)
        assert inside(*middles[-1]), geom
    middles = np.array(middles)
    # from the lip at x 0.05 up to the wall's top at y 0.075, with no room for an arm in between
    assert middles[0, 0] > 0.035 and middles[-1, 1] > 0.05
    assert np.linalg.norm(np.diff(middles, axis=0), axis=1).max() < 0.04
    corners = boxes(model, VISUALS)
    np.testing.assert_allclose(corners[:, 0].min(0), (-0.14, 0, -0.04), atol=6e-3)
    np.testing.assert_allclose(corners[:, 1].max(0), (0.05, 0.1, 0.04), atol=6e-3)


# -- wheelchair --------------------------------------------------------------------------------------


@pytest.mark.parametrize("side, sign", [("right", -1), ("left", 1)])
@pytest.mark.parametrize("y", [-0.165, -0.073, 0.02])
def test_armrest_height(side: str, sign: int, y: float):
    """A ray from above meets contact geoms and pad at the armrest top."""
    chair = furniture("wheelchair")
    for part, x in (("inner", 0.245), ("outer", 0.298)):
        height, name = drop(chair, sign * x, y, SOLIDS)
        assert height == pytest.approx(0.719, abs=2e-3)
        assert name == f"armrest_{side}_{part}_collision"
    height, _ = drop(chair, sign * 0.2715, y, VISUALS)  # the pad one sees
    assert height == pytest.approx(0.719, abs=2e-3)


def test_armrest_extent():
    """The two capsules span the measured pad."""
    chair = furniture("wheelchair")
    solids = dict(zip([n for n in geom_names(chair) if n], boxes(chair, SOLIDS), strict=True))
    assert set(WHEELCHAIR.geoms) <= set(solids)
    for side, sign in (("right", -1), ("left", 1)):
        pair = [solids[f"armrest_{side}_{part}_collision"] for part in ("inner", "outer")]
        x = sorted(np.abs([box[:, 0] for box in pair]).ravel())
        assert x[0] == pytest.approx(0.211, abs=1e-6) and x[-1] == pytest.approx(0.332, abs=1e-6)
        for box in pair:
            assert np.all(np.sign(box[:, 0]) == sign)
            np.testing.assert_allclose(box[:, 1], (-0.205, 0.059), atol=1e-6)


def test_wheelchair_leaves_room_for_the_person():
    """Cushion under the thighs (underside 0.4915), backrest behind the hips (y 0.1635)."""
    chair = furniture("wheelchair")
    for x in (-0.089, 0.089):
        for y in (-0.24, -0.15, 0.0):
            assert 0.40 < drop(chair, x, y, VISUALS)[0] < 0.4915
            assert drop(chair, x, y, SOLIDS)[0] < 0.4915
    assert {"seat_collision", "backrest_collision"} <= set(geom_names(chair))
    for height in np.linspace(0.53, 1.0, 8):
        for group in (VISUALS, SOLIDS):
            back, _ = ray(chair, (0.0, -0.2, height), (0, 1, 0), group)
            if back > 0:
                assert -0.2 + back > 0.1635 - 0.015, (height, group)


def test_mount_carries_the_jaco():
    """Section 2: booms of 0.4 m, radius 0.0425, along y and x, to below the arm's base."""
    model = furniture("jaco_mount")
    for centre, axis in (((-0.35, -0.15, 0.36), 1), ((-0.175, 0.0075, 0.36), 0)):
        for along in (-0.1, 0.0, 0.1):  # from below, each boom is met at its radius
            start = np.array(centre) + along * np.eye(3)[axis] - (0, 0, 0.36)
            height, _ = ray(model, start, (0, 0, 1), VISUALS)
            assert height == pytest.approx(0.36 - 0.0425, abs=5e-3), (centre, along)
    height, _ = drop(model, -0.35, -0.3, VISUALS)
    # a flange over boom 1 holds the lower part of the arm's base, whose link 1 turns at 0.36 + 0.157
    assert 0.36 + 0.0425 <= height < 0.36 + 0.1


# -- bed ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("group", [VISUALS, SOLIDS])
@pytest.mark.parametrize("x", BED_Z)
def test_bed_has_the_measured_heights(x: float, group: int):
    """Slab, rounded edge and slopes for a bumpy mesh: mattress to 1.2 cm, legs and pillows to 5 cm.

    The visual pillows have other outlines, and the blanket lies on the edge.
    """
    for y, z in zip(BED_Y, BED_Z[x], strict=False):
        fine = 0.012 if y > -0.6 and x > -0.6 else 0.03
        fine = 0.05 if y > 0.4 or y < -0.8 else fine
        tolerance = max(fine, 0.02) if group == VISUALS else fine
        assert drop(furniture("bed"), x, y, group)[0] == pytest.approx(z, abs=tolerance), (x, y)


def test_bed_can_be_lain_on_and_hung_over():
    bed = furniture("bed")
    assert set(BED.geoms) <= set(geom_names(bed))
    top = drop(bed, -0.15, 0.2, SOLIDS)
    # section 3: the settled chest's centre is at 0.875 = 0.74 + radius 0.127 + 8 mm
    assert top[1] == "mattress_collision" and top[0] == pytest.approx(0.875 - 0.127, abs=0.01)
    # an arm hangs over the rounded edge; issue 17: 0.72 at x -0.48, 0.70 at -0.52, 0.666 at -0.56, 0.59 at -0.60
    for x, z in ((-0.48, 0.72), (-0.52, 0.70), (-0.56, 0.666), (-0.60, 0.59)):
        height, name = drop(bed, x, 0.15, SOLIDS)
        assert name == "edge_collision"
        assert height == pytest.approx(z, abs=0.008 if x > -0.6 else 0.015), x
    # the girdle lies against the pillow
    assert drop(bed, -0.3, 0.4, SOLIDS)[1] in BED.pillow
    # world box of AG's bed: (-0.645, -1.193, 0) to (0.418, 1.168, 1.162)
    for group in (VISUALS, SOLIDS):
        low, high = boxes(bed, group)[:, 0].min(0), boxes(bed, group)[:, 1].max(0)
        np.testing.assert_allclose(low, (-0.645, -1.193, 0), atol=0.05)
        np.testing.assert_allclose(high, (0.418, 1.168, 1.162), atol=0.05)


def test_nightstand_carries_the_jaco():
    """Section 11: 0.55 m wide, its top 0.673 m above the floor, where the arm stands at 0.6 m."""
    model = furniture("nightstand")
    for group in (VISUALS, SOLIDS):
        low, high = boxes(model, group)[:, 0].min(0), boxes(model, group)[:, 1].max(0)
        np.testing.assert_allclose((low[0], high[0]), (-0.275, 0.275), atol=2e-3)
        np.testing.assert_allclose((low[2], high[2]), (-0.6, 0.073), atol=3e-3)
    base = Pose((-0.92, 0.58, 0.6), (np.cos(0.2), 0, 0, np.sin(0.2)))
    scene = compose(TASKS["BedBathing"], ROBOTS["Jaco"], base=base, solid=True)
    np.testing.assert_allclose(at_rest(scene).body("mount/nightstand").xpos, base.pos, atol=1e-9)
    # it does not reach into the bed that it stands beside (x -0.645)
    assert drop(scene, -0.66, 0.58, SOLIDS)[1] == "mount/nightstand_collision"


def test_stage_has_its_cameras_and_floor():
    """Cameras look at what they are for."""
    model = load("scene.xml")
    assert [model.camera(i).name for i in range(model.ncam)] == ["front", "side", "close"]
    assert "floor" in geom_names(model) and model.nlight == 2
    assert (model.vis.global_.offwidth, model.vis.global_.offheight) == (1280, 960)
    data = at_rest(model)
    targets = {"front": (0, 0, 0.7), "side": (-0.1, -0.1, 0.7), "close": (-0.35, -0.1, 0.8)}
    for name, target in targets.items():
        camera = data.camera(name)
        seen = Rotation.from_matrix(camera.xmat.reshape(3, 3)).inv()
        seen = seen.apply(np.array(target) - camera.xpos)
        assert seen[2] < 0  # cameras look along -z
        assert np.degrees(np.arctan2(np.hypot(*seen[:2]), -seen[2])) < 10
