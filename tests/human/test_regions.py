# ruff: noqa: D103
"""Regions of the body: every shape belongs to one, limits and how much of them is reached, a known force in C MuJoCo."""

from __future__ import annotations

import copy
import dataclasses
from pathlib import Path

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from agym_jax.errors import SpecError, UnknownNameError
from agym_jax.human import body
from agym_jax.human.regions import (
    NAMES,
    REGION_OF,
    REGIONS,
    RegionForces,
    comfort_limits,
    no_forces,
)
from agym_jax.robots import ROBOTS
from agym_jax.sim.contacts import contact_pairs
from agym_jax.sim.scene import build_scene
from agym_jax.sim.sensing import add_contacts, no_contacts, read_contacts, total_contacts
from agym_jax.tasks import TASKS


def forces(mean=None, peak=None):
    """On some regions [N], the others untouched; a peak is at least the mean."""
    row = lambda given: np.array([(given or {}).get(name, 0.0) for name in NAMES])  # noqa: E731
    return RegionForces.of(row(mean), np.maximum(row(mean), row(peak)), np)


def test_every_shape_of_the_body_belongs_to_one_region():
    assert list(REGION_OF) == list(body.SHAPES)
    kinds = [shape for region in REGIONS for shape in region.shapes]
    assert len(set(kinds)) == len(kinds)  # once
    assert {
        x.split("_", 1)[1] if x.startswith(("left_", "right_")) else x for x in REGION_OF
    } == set(kinds)
    of = lambda shape: NAMES[REGION_OF[shape]]  # noqa: E731
    assert (of("nose"), of("head"), of("left_forearm"), of("right_foot")) == (
        "face", "skull", "forearm", "lower leg",
    )  # fmt: skip


@pytest.mark.parametrize("active", [False, True])
def test_every_sensor_of_robot_and_tools_on_the_person_has_the_region_of_what_it_touches(active):
    for task in TASKS.values():
        for robot in ROBOTS.values():
            scene = build_scene(task, robot, active)
            model, index = scene.model, scene.index
            pairs = contact_pairs(task, robot, scene.moving)
            wanted = sum(len(x) for kind, x in pairs.items() if kind.endswith("human"))
            assert len(index.touch) == len(set(index.touch)) == len(index.touch_region) == wanted
            sensor_at = {adr: i for i, adr in enumerate(model.sensor_adr)}
            for address, region in zip(index.touch, index.touch_region, strict=True):
                geom = model.sensor_refid[sensor_at[address]]
                shape = model.geom(geom).name.removeprefix("human/")
                assert NAMES[region] == NAMES[REGION_OF[shape]]


def test_limits_are_those_of_the_task_and_wrong_ones_are_refused():
    usual, lifted = comfort_limits(TASKS["Feeding"]), comfort_limits(TASKS["ArmManipulation"])
    assert dict(zip(NAMES, usual, strict=True))["face"] == 10.0 and usual.max() == 20.0
    changed = {name for name, a, b in zip(NAMES, usual, lifted, strict=True) if a != b}
    assert changed == {"upper arm", "forearm", "hand"} and lifted.max() == 60.0
    assert all(x.comfort < x.quasi_static <= x.transient for x in REGIONS)
    lift = TASKS["ArmManipulation"]
    with pytest.raises(UnknownNameError, match=r"region of the body 'forarm'.*'forearm'"):
        comfort_limits(dataclasses.replace(lift, comfort=(("forarm", 5.0),)))
    with pytest.raises(SpecError, match="limit of the hand must be above 0, got 0"):
        comfort_limits(dataclasses.replace(lift, comfort=(("hand", 0.0),)))


def test_the_page_about_care_has_the_limits_of_the_code():
    page = (Path(__file__).parents[2] / "docs" / "care.md").read_text()
    rows = [f"| {x.name} | {x.comfort:g} | {x.quasi_static:g} | {x.transient:g} |" for x in REGIONS]
    assert "\n".join(rows) in page


@pytest.mark.parametrize(
    ("found", "of_comfort", "of_limit"),
    [
        (no_forces(), 0.0, 0.0),
        (forces(peak={"forearm": 10.0}), 0.5, 10 / 320),
        (forces(peak={"forearm": 10.0, "face": 9.0}), 0.9, 9 / 65),  # the worst region counts
        (forces(peak={"forearm": 20.1}), 1.005, 20.1 / 320),
        (forces(mean={"chest": 141.0}), 7.05, 141 / 140),  # too long, though not too hard at once
        (forces(mean={"hand": 30.0}, peak={"hand": 280.0}), 14.0, 1.0),
        (forces(peak={"skull": 130.0}), 13.0, 1.0),  # transient counts once at the head
    ],
)
def test_what_is_reached_of_limits(found, of_comfort, of_limit):
    comfort = comfort_limits(TASKS["ScratchItch"])
    assert float(found.of_comfort(comfort)) == pytest.approx(of_comfort)
    assert float(found.of_limit()) == pytest.approx(of_limit)


@pytest.fixture(scope="module")
def scratcher():
    """A scratcher and a person whom nothing moves."""
    human = dataclasses.replace(TASKS["ScratchItch"].human, passive_mode="welded")
    return build_scene(dataclasses.replace(TASKS["ScratchItch"], human=human), ROBOTS["Jaco"])


@pytest.mark.parametrize(
    ("shape", "region"),
    [("right_forearm", "forearm"), ("chest", "chest"), ("nose", "face"), ("right_thigh", "thigh")],
)
def test_contacts_of_c_mujoco_press_on_the_region_that_they_touch(scratcher, shape, region):
    """The tip is put 2 mm into a limb; MuJoCo's list of contacts says with what force it is pushed out."""
    model, index = copy.copy(scratcher.model), scratcher.index
    data = mujoco.MjData(model)
    low, high = model.jnt_range[index.robot_joint].T
    data.qpos[index.robot_qpos] = np.where(high > low, (low + high) / 2 + 0.3, 0.7)  # bent: free
    mujoco.mj_forward(model, data)
    geom, tip = model.geom(f"human/{shape}").id, data.site_xpos[index.tools[0].tip].copy()
    centre, axis = data.geom_xpos[geom], data.geom_xmat[geom].reshape(3, 3)[:, 2]
    out = tip - centre - axis * ((tip - centre) @ axis)
    surface = centre + out / np.linalg.norm(out) * (model.geom_size[geom, 0] - 0.002)
    model.body_pos[index.robot_base] += surface - tip
    mujoco.mj_forward(model, data)
    expected, force = np.zeros(len(NAMES)), np.zeros(6)
    for i, contact in enumerate(data.contact):
        names = [model.geom(g).name for g in contact.geom]
        touched = [x.removeprefix("human/") for x in names if x.startswith("human/")]
        mujoco.mj_contactForce(model, data, i, force)
        for limb in touched:  # not of what touches the wheelchair
            expected[REGION_OF[limb]] += force[0]
    found = read_contacts(index, data.sensordata, np)
    np.testing.assert_allclose(found.regions.mean, expected, rtol=1e-9)
    assert expected[NAMES.index(region)] > 0.1


def test_means_and_peaks_of_a_control_step(scratcher):
    index = scratcher.index
    rows = np.zeros((5, scratcher.model.nsensordata), np.float32)
    forearm = index.touch[index.touch_region == NAMES.index("forearm")]
    chest = index.touch[index.touch_region == NAMES.index("chest")]
    rows[:, forearm[0]], rows[:, forearm[1]] = [0, -3, 5, 2, 0], [0, 0, 2, 0, 0]
    rows[3, chest[-1]] = 1.5
    sums, total = total_contacts(read_contacts(index, rows, np), np), no_contacts(index)
    for row in rows:
        total = add_contacts(index, total, jnp.asarray(row))
    jax.tree.map(lambda a, b: np.testing.assert_allclose(a, b, rtol=1e-6), sums, total)
    peaks, means = (
        dict(zip(NAMES, x, strict=True)) for x in (sums.regions.peak, sums.regions.mean / 5)
    )
    assert {k: v for k, v in peaks.items() if v} == {"forearm": 7.0, "chest": 1.5}
    assert {k: float(v) for k, v in means.items() if v} == pytest.approx(
        {"forearm": 2.4, "chest": 0.3}
    )
