# ruff: noqa: D103
"""BedBathing by hand: reference tasks.md section 3 and humans.md section 9, without physics."""

from __future__ import annotations

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from agym_jax.human import anthropometry
from agym_jax.human.population import Population
from agym_jax.math3d import rotation_matrix
from agym_jax.sense import Sensed, ToolSensed
from agym_jax.tasks.bed_bathing import BED_BATHING as TASK
from agym_jax.tasks.bed_bathing import PER_RING, RINGS, BathState

# length and radius of upper arm and forearm [m], humans.md section 3; rings and points on each,
# total and 30 % of it, rounded up: tasks.md section 3
MAN = {"limbs": ((0.279, 0.043, 9, 9), (0.257, 0.033, 8, 6)), "total": 129, "enough": 39}
WOMAN = {"limbs": ((0.264, 0.0355, 8, 7), (0.234, 0.027, 7, 5)), "total": 91, "enough": 28}
PEOPLE = [(0.0, MAN), (1.0, WOMAN)]
TURN = rotation_matrix(np.array([0.5, 0.5, -0.5, 0.5]), np)
LINKS = {
    "chest": np.array([-0.15, 0.2, 0.875]), "right_upper_arm": np.array([-0.32, 0.35, 0.85]),
    "right_forearm": np.array([-0.4, 0.1, 0.83]), "right_hand": np.array([-0.42, -0.15, 0.8]),
}  # fmt: skip
ROTS = {k: np.eye(3) for k in LINKS} | {"right_forearm": TURN}
AIR = {
    "pos_w": np.array([-0.6, 0.2, 1.0]), "quat_w": np.array([0.6, 0.8, 0, 0]), "vel_w": np.zeros(3),
    "gap": 0.1, "touch_force": np.zeros(3), "touch_pos_w": np.zeros((3, 3)),
    "touch_working": np.array([1.0, 1.0, 0.0]), "on_human": 0.0, "force": 0.0,
}  # fmt: skip
REST = {
    "arm_angles": np.arange(7.0), "torso_pos_w": np.array([-1.0, -0.5, 1.0]),
    "human_angles": np.arange(10.0), "robot_on_human": 0.0,
}  # fmt: skip


def changed(nothing: dict[str, Any], changes: dict[str, Any]) -> dict[str, Any]:
    assert set(changes) <= set(nothing), set(changes) - set(nothing)
    return jax.tree.map(lambda v: jnp.asarray(v, jnp.float32), nothing | changes)


def sensed(
    sex: float = 0.0, links: dict[str, Any] | None = None, turns: dict[str, Any] | None = None,
    tool: dict[str, Any] | None = None, **changes: Any,
) -> Sensed:  # fmt: skip
    """Somebody in bed with the wiper in the air, but for what is given."""
    return Sensed(
        tools=(ToolSensed(**changed(AIR, tool or {})),),
        link_pos_w=changed(LINKS, links or {}),
        link_rot_w=changed(ROTS, turns or {}),
        link_quat_w={k: jnp.array([1.0, 0, 0, 0]) for k in LINKS},
        motion=None,
        dims=jax.tree.map(jnp.float32, anthropometry.dims(sex)),
        **changed(REST, changes),
    )


def begin(sex: float = 0.0) -> BathState:
    return TASK.init(jax.random.PRNGKey(0), sensed(sex))


def pressing(
    place: np.ndarray, force: float = 1.0, working: Any = (1, 1, 1), **more: Any
) -> Sensed:
    """One contact of that force at a place; the middle of the pad is elsewhere."""
    places = np.stack([place, np.zeros(3), np.zeros(3)])
    tool = {
        "pos_w": place + 0.02, "touch_force": np.array([force, 0.0, 0.0]), "touch_pos_w": places,
        "touch_working": np.array(working, float),
    }  # fmt: skip
    return sensed(tool=tool | more.pop("tool", {}), **more)


def apart(points: np.ndarray, place: np.ndarray) -> np.ndarray:
    """Distance of points from a contact (n,)."""
    return np.linalg.norm(points - place, axis=1)


def here(state: BathState) -> np.ndarray:
    """Points that exist, in the world (n, 3)."""
    return np.asarray(state.points_w)[np.asarray(state.exists) > 0]


@pytest.mark.parametrize(("sex", "who"), PEOPLE)
def test_points_are_the_references_rings(sex: float, who: dict):
    state = begin(sex)
    assert np.asarray(state.exists).sum() == np.asarray(state.dirty).sum() == who["total"]
    for limb, (length, radius, rings, around) in enumerate(who["limbs"]):
        local = np.asarray(state.points_limb[limb])[np.asarray(state.exists[limb]) > 0]
        expected = [
            (-radius * np.sin(j * 0.03 / radius), -radius * np.cos(j * 0.03 / radius), -s)
            for s in (length * (i + 1) / (rings + 1) for i in range(rings))
            for j in range(around)
        ]
        np.testing.assert_allclose(local, expected, atol=1e-6)
        # neighbours on a ring are 3 cm of skin apart, and the ring does not close evenly
        gap = 2 * np.pi - (around - 1) * 0.03 / radius
        assert np.deg2rad(40) < gap < np.deg2rad(106) and gap > 0.03 / radius


@pytest.mark.parametrize("girth", [Population().girth[0], Population().girth[1]])
@pytest.mark.parametrize("stature", [Population().stature[0], Population().stature[1]])
@pytest.mark.parametrize("sex", [Population().blend[0], Population().blend[1]])
def test_nobody_has_room_for_more_points_than_are_kept(sex: float, stature: float, girth: float):
    d = anthropometry.dims(sex, stature, girth)
    seen = dataclasses.replace(sensed(), dims=jax.tree.map(jnp.float32, d))
    found = np.asarray(TASK.init(jax.random.PRNGKey(0), seen).exists).sum()
    counts = [
        (int(length / 0.03), int(2 * np.pi * r / 0.03))
        for length, r in ((d.upper_arm_l, d.upper_arm_r), (d.forearm_l, d.forearm_r))
    ]
    assert max(n for n, _ in counts) <= RINGS and max(n for _, n in counts) <= PER_RING
    assert found == sum(a * b for a, b in counts)


def test_points_move_with_their_limb():
    state, shift = begin(), np.array([0.1, -0.2, 0.3])
    spun = rotation_matrix(np.array([0.6, 0.0, 0.8, 0.0]), np)
    for limb, name in enumerate(("right_upper_arm", "right_forearm")):
        moved = sensed(links={name: LINKS[name] + shift}, turns={name: spun})
        after, _ = TASK.advance(state, moved)
        expected = LINKS[name] + shift + np.asarray(state.points_limb[limb]) @ spun.T
        np.testing.assert_allclose(after.points_w[limb], expected, atol=1e-6)
        np.testing.assert_array_equal(after.points_w[1 - limb], state.points_w[1 - limb])
    np.testing.assert_allclose(
        here(state)[:81], LINKS["right_upper_arm"] + state.points_limb[0][state.exists[0] > 0]
    )


@pytest.mark.parametrize("limb", [40, 100])
def test_contact_wipes_every_point_within_reach_and_no_other(limb: int):
    state = begin()
    points = here(state)
    place = points[limb] + np.array([0.004, 0.003, 0.01])
    near = apart(points, place) < 0.025
    after, events = TASK.advance(state, pressing(place))
    dirty = np.asarray(after.dirty)[np.asarray(state.exists) > 0]
    np.testing.assert_array_equal(dirty, ~near)
    assert float(events["wiped"]) == near.sum() >= 1
    np.testing.assert_array_equal(after.exists, state.exists)


def test_nothing_is_wiped_twice():
    state = begin()
    places = here(state)[[0, 30, 100]]
    near = np.min([apart(here(state), p) for p in places], axis=0) < 0.025
    total = 0.0
    for _ in range(3):
        for place in places:
            state, events = TASK.advance(state, pressing(place))
            total += float(events["wiped"])
    assert total == near.sum()  # overlaps count once


@pytest.mark.parametrize(
    ("force", "offset", "working", "counts"),
    [
        (0.1, 0.0, True, True),  # any force
        (50.0, 0.0, True, True),
        (0.0, 0.0, True, False),
        (1.0, 0.0249, True, True),  # 25 mm, bed_bathing.py get_total_force
        (1.0, 0.0251, True, False),
        (1.0, 0.0, False, False),  # the plate and the handle do not wipe
    ],
)
def test_what_wipes(force: float, offset: float, working: bool, counts: bool):
    state = begin()
    point = here(state)[0]  # the first ring's first: outwards is -y
    place = point - np.array([0, offset, 0])
    after, events = TASK.advance(state, pressing(place, force=force, working=(working, 1, 1)))
    wiped = np.asarray(state.dirty - after.dirty)[np.asarray(state.exists) > 0]
    assert wiped[0] == counts
    assert (float(events["wiped"]) > 0) == (force > 0 and working and offset < 0.025)
    np.testing.assert_allclose(after.pad_force, force * working, rtol=1e-6)


def test_points_that_do_not_exist_cannot_be_wiped():
    state = begin()
    origin = LINKS["right_upper_arm"]  # where the padding lies
    after, events = TASK.advance(state, pressing(origin))
    assert float(events["wiped"]) == 0 and (np.asarray(after.dirty) >= 0).all()


@pytest.mark.parametrize(("sex", "who"), PEOPLE)
def test_success_is_30_percent_of_this_persons_points(sex: float, who: dict):
    state = begin(sex)
    rows = np.flatnonzero(np.asarray(state.exists))
    for wiped in (0, who["enough"] - 1, who["enough"], who["total"]):
        dirty = np.asarray(state.exists).copy().ravel()
        dirty[rows[:wiped]] = 0
        left = dataclasses.replace(state, dirty=jnp.asarray(dirty.reshape(state.exists.shape)))
        assert bool(TASK.success(left)) == (wiped >= who["enough"]), wiped


def test_reward_is_assistive_gyms():
    """R = -d_min - 0.01 |a|^2 + 5 N_new + r_pref."""
    state = begin()
    tool = {"gap": -0.004, "vel_w": np.array([0.3, 0.0, 0.4]), "on_human": 20.0}
    tool |= {"touch_force": np.array([6.0, 6.0, 0.0])}
    seen = pressing(here(state)[0], working=(1, 1, 0), robot_on_human=5.0)
    seen = dataclasses.replace(
        seen, tools=(dataclasses.replace(seen.tool, **jax.tree.map(jnp.float32, tool)),)
    )
    state, events = TASK.advance(state, seen)
    n = float(events["wiped"])
    assert n >= 1
    action = jnp.array([0.5, -0.5, 0.5, -0.5, 0.0, 0.0, 1.0])
    terms = TASK.rewards(state, events, seen, action)
    expected = {
        "distance": 0.004,  # negative inside
        "action": -0.02,
        "wiping": 5.0 * n,
        "preference_velocity": -0.25 * 0.5,
        # the pad's 12 N are wanted, the rest of the tool's and the robot's are not
        "preference_force_nontarget": -0.01 * (20.0 + 5.0 - 12.0),
        "preference_high_forces": -0.05 * 12.0,
    }
    assert set(terms) == set(expected)
    for name, value in expected.items():
        np.testing.assert_allclose(terms[name], value, rtol=1e-5, atol=1e-6, err_msg=name)


def test_observations_are_differences_along_world_axes():
    tip, torso, chest = np.array([-0.5, 0.1, 1.1]), np.array([-1, 0.2, 1.0]), LINKS["chest"]
    seen = sensed(
        tool={"pos_w": tip, "force": 3.0, "on_human": 2.0}, torso_pos_w=torso, robot_on_human=0.5
    )
    robot, human = TASK.observe(begin(), seen)
    arm = [LINKS[f"right_{x}"] for x in ("upper_arm", "forearm", "hand")]
    expected = [
        (robot.tool_pos_torso, tip - torso), (robot.tool_quat_w, AIR["quat_w"]),
        (robot.arm_angles, np.arange(7)), (robot.tool_force, 3.0),
        (human.tool_pos_human, tip - chest), (human.tool_quat_w, AIR["quat_w"]),
        (human.human_angles, np.arange(10)),
        (human.force_on_human, 2.5), (human.tool_on_human, 2.0),
    ]  # fmt: skip
    for joint, link in zip(("shoulder", "elbow", "wrist"), arm, strict=True):
        expected.append((getattr(robot.assisted_arm, f"{joint}_pos_torso"), link - torso))
        expected.append((getattr(human.assisted_arm, f"{joint}_pos_human"), link - chest))
    for found, value in expected:
        np.testing.assert_allclose(found, value, atol=1e-6)
    # nobody is told which points are left
    wiped = dataclasses.replace(begin(), dirty=jnp.zeros_like(begin().dirty))
    jax.tree.map(np.testing.assert_array_equal, (robot, human), TASK.observe(wiped, seen))


@pytest.mark.parametrize("robot", ["PR2", "Jaco", "Baxter", "Sawyer"])
def test_start_positions_fill_the_references_box(robot: str):
    keys = jax.random.split(jax.random.PRNGKey(0), 2000)
    p = np.asarray(jax.vmap(lambda k: TASK.start(k, robot))(keys))
    share = (p - np.array([[-0.6, 0.2, 1.0]])) / 0.05
    assert p.shape == (2000, 1, 3) and (np.abs(share) <= 1 + 1e-5).all()
    assert (share.max(0) > 0.99).all() and (share.min(0) < -0.99).all()


def test_markers_are_the_points_that_are_left():
    state = begin()
    state, events = TASK.advance(state, pressing(here(state)[0]))
    ((places, radius, colour),) = TASK.markers(state)
    places = np.asarray(places)
    shown = places[np.isfinite(places).all(1)]
    np.testing.assert_array_equal(shown, np.asarray(state.points_w)[np.asarray(state.dirty) > 0])
    assert len(shown) == 129 - int(events["wiped"]) and 0 < radius <= 0.01 and len(colour) == 4


def test_each_contact_of_the_pad_wipes_and_those_of_the_plate_do_not():
    state = begin()
    points = here(state)
    places = points[[10, 60, 110]]
    tool = {"touch_force": np.ones(3), "touch_pos_w": places}
    after, _ = TASK.advance(state, pressing(places[0], working=(1, 0, 1), tool=tool))
    near = (apart(points, places[0]) < 0.025) | (apart(points, places[2]) < 0.025)
    np.testing.assert_array_equal(np.asarray(after.dirty)[np.asarray(state.exists) > 0], ~near)
    assert near.sum() >= 2 and not near[60]


def test_bed_is_sticky_and_the_person_still():
    # tasks.md section 3, furniture.md section 3
    assert TASK.seat.friction == 5.0 and TASK.gravity == -1.0
    assert TASK.human.moving(active=False) == () and len(TASK.human.moving(active=True)) == 10


def test_value_functions_see_which_patches_remain():
    """A wipe reaches 2.5 cm, which is at most two patches either way, and of one limb only."""
    state = begin()
    before = np.asarray(TASK.privileged_obs(state))
    assert before.shape == (TASK.privileged_obs_size,)
    assert set(before) <= {0.0, 1.0}  # 1 where this person has points
    points = here(state)
    for limb, place in enumerate((points[0], points[-1])):
        wiped, _ = TASK.advance(state, pressing(place))
        after = np.asarray(TASK.privileged_obs(wiped))
        touched = np.flatnonzero(after != before)
        assert 1 <= touched.size <= 4 and np.all(after <= before)
        assert set(touched // (before.size // 2)) == {limb}
    clean = dataclasses.replace(state, dirty=jnp.zeros_like(state.dirty))
    np.testing.assert_array_equal(TASK.privileged_obs(clean), 0.0)


def test_each_point_belongs_to_one_patch_and_patches_are_about_as_large():
    state = begin()
    nothing = jnp.zeros_like(state.dirty)
    for limb in range(2):
        patches = []
        for point in np.flatnonzero(np.asarray(state.exists[limb])):
            one = dataclasses.replace(state, dirty=nothing.at[limb, point].set(1.0))
            (patch,) = np.flatnonzero(np.asarray(TASK.privileged_obs(one)))
            patches.append(patch)
        _, sizes = np.unique(patches, return_counts=True)
        assert len(sizes) == 24 and sizes.min() >= 1 and sizes.max() <= 6, sizes
