# ruff: noqa: D103
"""Garments: the gown that comes with the package, somebody's own OBJ, and what is refused."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import jax
import numpy as np
import pytest
from cloth_scene import sheet

from agym_jax.errors import MissingAssetError
from agym_jax.matter.cloth.garment import (
    AG_AREA_DENSITY,
    Garment,
    GarmentError,
    boundary_loop,
    load,
    longest_edge,
    save,
)  # fmt: skip
from agym_jax.matter.cloth.hang import settle
from agym_jax.matter.cloth.topology import REFERENCE_EDGE, REFERENCE_SUBSTEPS, Fabric, build_cloth
from agym_jax.offline.gown import GIRTHS, GownMeasures, build_gown
from agym_jax.robots import ROBOTS
from agym_jax.sim.scene import compose
from agym_jax.sim.validate import check_task
from agym_jax.tasks.dressing import Dressing

SQUARE = Garment(  # 4 x 4 vertices, 2 cm apart
    name="square",
    vertices=np.array([[0.02 * c, 0.0, -0.02 * r] for r in range(4) for c in range(4)]),
    triangles=np.array([
        t for r in range(3) for c in range(3) for i in [4 * r + c] for t in ([i, i + 1, i + 5], [i, i + 5, i + 4])
    ]),
    cuff=np.array([0, 1, 2, 3, 7, 11, 15, 14, 13, 12, 8, 4]),
    anchors=np.array([0, 1, 2, 3]),
)  # fmt: skip


def write_obj(folder: Path, garment: Garment, factor: float = 100.0, **said) -> Path:
    """An OBJ in centimetres, with quads where two triangles make one, and its description."""
    lines = ["# mine", *(f"v {x} {y} {z}" for x, y, z in factor * garment.vertices)]
    lines += [f"f {a + 1}/1 {b + 1}/1 {c + 1}/1" for a, b, c in garment.triangles.tolist()]
    (folder / "mine.obj").write_text("\n".join(lines))
    said = {"mesh": "'mine.obj'", "scale": 1 / factor, "cuff": [0], "anchors": [0, 1, 2, 3]} | said
    path = folder / "mine.toml"
    path.write_text("\n".join(f"{k} = {v}" for k, v in said.items() if v is not None))
    return path


def edges(garment: Garment) -> set[tuple[int, int]]:
    """Pairs of vertices that an edge of a triangle joins, the lower one first."""
    sides = garment.triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)
    return set(map(tuple, np.sort(sides, axis=1).tolist()))


def test_gown_has_its_measures():
    gown = load()
    assert 400 <= len(gown.vertices) <= 1200
    assert np.isclose(gown.cuff_perimeter, 0.386, atol=0.005)
    wide = boundary_loop("gown", gown.triangles, int(np.argmax(gown.vertices[:, 1])))
    loop = gown.vertices[wide]
    around = np.linalg.norm(loop - np.roll(loop, -1, 0), axis=1).sum()
    assert np.isclose(around, GIRTHS[-1][1], atol=0.005)  # AG's, where it is held
    assert np.isclose(gown.area_density, 0.23 / 1.099) and 0.04 < gown.mass < 0.07
    assert np.allclose(gown.vertices[gown.anchors].mean(0), 0.0, atol=1e-9)
    assert 0.06 < np.ptp(gown.vertices[gown.anchors][:, 0]) < 0.09  # AG: 75 mm
    np.testing.assert_allclose(build_cloth(gown).mass.sum(), gown.mass, rtol=1e-6)


def test_cuff_hangs_as_far_below_the_gripper_as_assistive_gyms():
    gown = load()
    assert gown.hanging is not None
    cuff = gown.hanging[gown.cuff].mean(0) - gown.hanging[gown.anchors].mean(0)
    assert -0.337 < cuff[2] < -0.30 and abs(cuff[0]) < 0.04  # AG: 0.313 +- 0.007 m


def test_packaged_gown_equals_the_built_one():
    made, kept = build_gown(), load()
    np.testing.assert_allclose(made.vertices, kept.vertices, atol=1e-9)
    assert len(made.triangles) == len(kept.triangles)
    # the packaged one was built when rounding chose between diagonals of equal length
    ours, theirs = (edges(x) - edges(y) for x, y in ((made, kept), (kept, made)))
    assert len(ours) == len(theirs) <= 10
    lengths = [
        sorted(np.linalg.norm(kept.vertices[a] - kept.vertices[b]) for a, b in which)
        for which in (ours, theirs)
    ]
    np.testing.assert_allclose(*lengths, atol=1e-9)
    np.testing.assert_array_equal(made.cuff, kept.cuff)


@pytest.mark.parametrize("edge", [0.0241, 0.02, 0.017])
def test_gown_builds_at_other_resolutions(edge: float):
    gown, rough = build_gown(GownMeasures(edge=edge)), build_gown()
    assert np.isclose(gown.areas.sum(), rough.areas.sum(), rtol=0.08)
    assert np.isclose(gown.cuff_perimeter, 0.386, atol=0.005)
    spec = build_cloth(gown)
    degrees = np.bincount(gown.edges().ravel())
    assert len(spec.edges.partner) <= degrees.max() + 1  # few colours
    for table in (spec.edges, spec.hinges):  # partners of each other
        rows, ids = np.nonzero(table.active)
        back = table.partner[rows, table.partner[rows, ids]]
        if table is spec.edges:
            np.testing.assert_array_equal(back, ids)


def test_bending_moment_is_independent_of_resolution():
    def energy(edge: float, radius: float) -> float:
        spec = build_cloth(sheet(0.6, 0.6, edge))
        x, _, z = spec.garment.vertices.T
        bent = np.stack([radius * np.sin(x / radius), radius * np.cos(x / radius), z], -1)
        h = spec.hinges
        now = np.linalg.norm(bent[h.partner] - bent, axis=-1)
        spring = np.where(h.active > 0, (now - h.rest) ** 2 / np.maximum(h.compliance, 1e-9), 0.0)
        return 0.25 * spring.sum()  # half of a spring's at each of its ends

    for radius in (0.08, 0.2):
        coarse, fine = energy(0.025, radius), energy(0.0125, radius)
        np.testing.assert_allclose(fine, coarse, rtol=0.15)


def test_finer_cloth_gets_more_substeps_by_default():
    assert build_cloth(load()).substeps == REFERENCE_SUBSTEPS
    fine = sheet(REFERENCE_EDGE * 10, REFERENCE_EDGE * 10, REFERENCE_EDGE / 2)
    assert build_cloth(fine).substeps == 4 * REFERENCE_SUBSTEPS
    assert build_cloth(fine, Fabric(substeps=3)).substeps == 3


def test_custom_garment_loads_from_obj_and_toml(tmp_path: Path):
    garment = load(str(write_obj(tmp_path, SQUARE, area_density=0.5)))
    np.testing.assert_allclose(
        garment.vertices, SQUARE.vertices - SQUARE.vertices[:4].mean(0), atol=1e-9
    )
    assert set(garment.cuff.tolist()) == set(SQUARE.cuff.tolist()) and garment.area_density == 0.5
    assert load(str(write_obj(tmp_path, SQUARE))).area_density == AG_AREA_DENSITY
    task = Dressing(garment=str(write_obj(tmp_path, SQUARE)))
    assert task.spec.count == 16 and task.gown.hanging is not None
    assert abs(task.gown.hanging[:, 2].min() + 0.06) < 0.005  # it hangs by its upper edge


def test_garment_is_loaded_when_the_scene_is_built(tmp_path: Path):
    """An invalid one is refused before anything is compiled, and importing the task loads nothing."""
    path = write_obj(tmp_path, SQUARE)
    good = Dressing(garment=str(path))
    assert not {"gown", "spec", "watched"} & set(vars(good))
    check_task(good)
    assert {"gown", "spec", "watched"} <= set(vars(good))
    with pytest.raises(GarmentError, match="does not specify cuff"):
        compose(Dressing(garment=str(write_obj(tmp_path, SQUARE, cuff=None))), ROBOTS["Jaco"])
    with pytest.raises(MissingAssetError):
        compose(Dressing(garment=str(tmp_path / "yours.toml")), ROBOTS["Jaco"])


def test_garment_loaded_inside_a_jitted_function_is_concrete(tmp_path: Path):
    task = Dressing(garment=str(write_obj(tmp_path, SQUARE)))
    mass = jax.jit(lambda x: x + task.spec.garment.mass)(0.0)  # loads it, and lets it settle
    assert isinstance(task.gown.hanging, np.ndarray)
    assert np.isclose(mass, task.gown.mass)


def test_invalid_npz_names_what_is_missing(tmp_path: Path):
    np.savez(tmp_path / "a.npz", vertices=SQUARE.vertices, triangles=SQUARE.triangles)
    with pytest.raises(GarmentError, match=r"a\.npz is damaged: it has no cuff"):
        load(str(tmp_path / "a.npz"))
    (tmp_path / "b.npz").write_bytes(b"not a garment")
    with pytest.raises(GarmentError, match=r"b\.npz is damaged: it is not an \.npz file"):
        load(str(tmp_path / "b.npz"))


def test_npz_round_trip_preserves_all_fields(tmp_path: Path):
    hanging = settle(SQUARE)
    save(hanging, tmp_path / "square.npz")
    again = load(str(tmp_path / "square.npz"))
    shift = SQUARE.vertices[:4].mean(0)
    np.testing.assert_allclose(again.vertices, SQUARE.vertices - shift)
    np.testing.assert_allclose(again.hanging, hanging.hanging - hanging.hanging[:4].mean(0))
    save(SQUARE, tmp_path / "square.npz")
    assert load(str(tmp_path / "square.npz")).hanging is None


def test_limb_sinks_by_the_thickness_at_the_longest_edge():
    edge, r, t = longest_edge(0.027, 0.008), 0.027, 0.008
    corner = edge / np.sqrt(3)  # of an equilateral triangle, from its middle
    assert np.isclose(np.sqrt((r + t) ** 2 - corner**2), r)  # the sphere's middle, above the plane
    with pytest.raises(
        GarmentError, match=r"edge between vertices \d+ and \d+ is 3\d\.\d mm.*27.0 mm"
    ):
        build_cloth(replace(SQUARE, vertices=1.39 * SQUARE.vertices))


def vertex(i: int, value) -> dict:
    return {"vertices": np.vstack([SQUARE.vertices[:i], [value], SQUARE.vertices[i + 1 :]])}


BAD = {
    "three triangles at an edge": (
        {"vertices": np.vstack([SQUARE.vertices, [0.01, 0.02, 0.0]]), "triangles": np.vstack([SQUARE.triangles, [0, 5, 16]])},
        "edge between vertices 0 and 5 belongs to 3 triangles"),
    "two pieces": (
        {"vertices": np.vstack([SQUARE.vertices, np.eye(3)]), "triangles": np.vstack([SQUARE.triangles, [16, 17, 18]])},
        "not one piece: vertex 16"),
    "cuff is open": ({"cuff": np.array([0, 1, 2, 3, 7, 11])}, "vertices 11 and 0 follow each other"),
    "cuff is short": ({"cuff": np.array([0, 1, 5])}, "6 different vertices"),
    "cuff does not exist": ({"cuff": np.array([0, 1, 99])}, "cuff name vertex 99; there are 16"),
    "anchors do not exist": ({"anchors": np.array([-1])}, "anchors name vertex -1"),
    "anchors twice": ({"anchors": np.array([1, 1])}, "different vertices"),
    "no anchors": ({"anchors": np.array([], int)}, "anchors must be numbers"),
    "nan": (vertex(3, [np.nan, 0, 0]), "must be finite"),
    "flat triangle": (vertex(1, SQUARE.vertices[0]), "triangle 0 of vertices"),
    "no weight": ({"area_density": 0.0}, "area_density must be > 0"),
    "hangs wrongly": ({"hanging": np.zeros((3, 3))}, r"hanging must be .*\(16, 3\)"),
}  # fmt: skip


@pytest.mark.parametrize("what", BAD)
def test_invalid_garments_are_refused_with_the_location(what: str):
    changes, message = BAD[what]
    with pytest.raises(GarmentError, match=message):
        build_cloth(replace(SQUARE, **changes))


def test_invalid_descriptions_are_refused(tmp_path: Path):
    for changes, message in (
        ({"cuff": None}, "does not specify cuff"),
        ({"cufff": [0]}, "'cufff'.*cuff"),
        ({"cuff": [5]}, "vertex 5 lies on 0 edges"),
        ({"scale": "'cm'"}, "scale must be a number, got 'cm'"),
        ({"mesh": 3}, "mesh must be the name of a file, got 3"),
    ):
        with pytest.raises(GarmentError, match=message):
            load(str(write_obj(tmp_path, SQUARE, **changes)))
    path = write_obj(tmp_path, SQUARE)
    (tmp_path / "mine.obj").write_text("v 0 0 zero\n")
    with pytest.raises(GarmentError, match="line 1"):
        load(str(path))
    path.write_text("cuff = [")
    with pytest.raises(GarmentError, match="not TOML"):
        load(str(path))
    path.write_bytes(b"# \xff")
    with pytest.raises(GarmentError, match="not UTF-8"):
        load(str(path))
    with pytest.raises(GarmentError, match="needs a description"):
        load(str(tmp_path / "mine.obj"))
    with pytest.raises(MissingAssetError):
        load(str(tmp_path / "yours.toml"))


@pytest.mark.parametrize(
    ("changes", "message"), [({"thickness": 0.0}, "thickness > 0"), ({"stretch": -1.0}, "stretch >= 0"),
                             ({"substeps": 0}, "substeps > 0"), ({"friction": np.nan}, "friction")],
)  # fmt: skip
def test_invalid_fabrics_are_refused(changes: dict, message: str):
    with pytest.raises(GarmentError, match=message):
        build_cloth(SQUARE, Fabric(**changes))
