# ruff: noqa: D103
"""Which geoms may touch, with what friction, and which of them count as one contact. C MuJoCo."""

from __future__ import annotations

import copy
import dataclasses
import itertools

import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from agym_jax.human import body
from agym_jax.robots import ROBOTS
from agym_jax.sim import sensing
from agym_jax.sim.contacts import contact_pairs, pair_friction, pair_rolling, touch_rows
from agym_jax.sim.mjx import WARP_ROWS_PER_ENV, warp_rows
from agym_jax.sim.scene import build_scene
from agym_jax.tasks import TASKS

WIPE, SCRATCH, JACO = TASKS["BedBathing"], TASKS["ScratchItch"], ROBOTS["Jaco"]
LINK_OF = {f"human/{shape}": link for shape, link in body.SHAPES.items()}
WIPER_PAIRS = contact_pairs(WIPE, JACO, ())["tool/human"]


@pytest.mark.parametrize(
    ("task", "kind", "product"),
    [
        # reference ag_traces, facts: person, robot, tools, wheelchair 0.5; bed 5, then 0.3
        ("ScratchItch", "tool/human", 0.25), ("ScratchItch", "robot_human", 0.25),
        ("ScratchItch", "human_seat", 0.25), ("ScratchItch", "human_self", 0.25),
        ("BedBathing", "tool/seat", 2.5), ("BedBathing", "robot_seat", 2.5),
        ("ArmManipulation", "tool2/human", 0.25), ("ArmManipulation", "tool2/seat", 0.15),
        ("ArmManipulation", "human_seat", 0.15),
    ],
)  # fmt: skip
def test_friction_is_the_product_of_both_materials(task: str, kind: str, product: float):
    assert pair_friction(kind, TASKS[task], JACO) == pytest.approx(product)
    slippery = dataclasses.replace(JACO, friction=0.1)
    expected = product / 5 if kind.startswith("robot") else product
    assert pair_friction(kind, TASKS[task], slippery) == pytest.approx(expected)


def test_every_pair_of_a_model_has_the_friction_of_its_kind():
    for task, robot in itertools.product(TASKS.values(), ROBOTS.values()):
        model = build_scene(task, robot).model
        touches = contact_pairs(task, robot, task.human.moving(False))
        assert sum(map(len, touches.values())) == model.npair
        for kind, pairs in touches.items():
            rows = [model.pair(f"{a}|{b}").id for a, b in pairs]
            expected = pair_friction(kind, task, robot)
            np.testing.assert_allclose(model.pair_friction[rows, :2], expected, err_msg=kind)
            rolling = pair_rolling(kind, task, robot)
            resisted = model.pair_dim[rows, None] == 6
            lengths = np.where(resisted, model.pair_friction[rows, 2:], 0.0)
            np.testing.assert_allclose(lengths, rolling, err_msg=kind)


@pytest.mark.parametrize(
    ("task", "kind", "length"),
    [
        # AG bed_bathing.py and arm_manipulation.py, reset: rollingFriction = spinningFriction = 5, then 0.3, of the bed alone;
        # 2.5 m with the person in BedBathing and 0.15 m of all in ArmManipulation, too, but see bed-contact
        ("BedBathing", "tool/seat", 2.5), ("BedBathing", "robot_seat", 2.5), ("BedBathing", "human_seat", 0.15),
        ("ArmManipulation", "tool2/seat", 0.6), ("ArmManipulation", "robot_seat", 0.6),
        ("ArmManipulation", "human_seat", 0.28), ("ArmManipulation", "robot_mount", 0.0),
        ("BedBathing", "tool/human", 0.0), ("ScratchItch", "robot_seat", 0.0),
    ],
)  # fmt: skip
def test_the_bed_resists_rolling(task: str, kind: str, length: float):
    assert pair_rolling(kind, TASKS[task], JACO) == pytest.approx(length)
    rough = dataclasses.replace(JACO, friction=1.0)
    by_material = kind.startswith("robot") and TASKS[task].seat.tool_rolling is None
    expected = 2 * length if by_material else length
    assert pair_rolling(kind, TASKS[task], rough) == pytest.approx(expected)


def test_pad_and_plate_touch_the_arm_and_the_outline_the_rest():
    by_geom: dict[str, set[str]] = {}
    for geom, limb in WIPER_PAIRS:
        by_geom.setdefault(geom, set()).add(LINK_OF[limb])
    arm = {"right_upper_arm", "right_forearm", "right_hand"}
    outline = f"tool/{WIPE.tool.outline}"
    assert {g for g in by_geom if g != outline} == {f"tool/{g}" for g in WIPE.tool.geoms}
    assert all(limbs == arm for geom, limbs in by_geom.items() if geom != outline)
    assert by_geom[outline] == set(WIPE.human.limbs) - arm


def test_rims_of_one_part_on_one_limb_are_one_contact():
    rows, working = touch_rows(WIPE, WIPER_PAIRS)
    together: dict[int, set[tuple[str, str]]] = {}
    for row, (geom, limb) in zip(rows, WIPER_PAIRS, strict=True):
        together.setdefault(row, set()).add((geom.split("_")[1], LINK_OF[limb]))
    assert sorted(together) == list(range(len(working)))
    assert all(len(kinds) == 1 for kinds in together.values())  # one part, one limb
    pads = [row for row, kinds in together.items() if {p for p, _ in kinds} == {"pad"}]
    assert len(pads) == 3 and [i for i, w in enumerate(working) if w] == pads
    # tools of one geom a part have a contact for each pair
    pairs = contact_pairs(SCRATCH, JACO, ())["tool/human"]
    contacts = [(geom, LINK_OF[limb]) for geom, limb in pairs]
    assert touch_rows(SCRATCH, pairs)[0] == [
        list(dict.fromkeys(contacts)).index(x) for x in contacts
    ]


def test_contact_of_a_part_has_the_sum_of_forces_at_their_centre():
    scene = build_scene(WIPE, JACO)
    (tool,) = scene.index.tools
    forearm = [i for i, (g, x) in enumerate(WIPER_PAIRS) if "_pad_" in g and x.endswith("forearm")]
    force, places = np.zeros(len(WIPER_PAIRS)), np.zeros((len(WIPER_PAIRS), 3))
    force[forearm[:2]] = 1.0, 3.0
    places[forearm[:2]] = (0.1, 0.0, 0.8), (0.2, 0.0, 0.8)
    merged = sensing._per_contact(tool, jnp.asarray(force))
    moment = sensing._per_contact(tool, jnp.asarray(force[:, None] * places))
    (row,) = np.flatnonzero(merged)
    assert tool.working[row] == 1.0 and row == tool.contact[forearm[0]]
    np.testing.assert_allclose(merged[row], 4.0)
    np.testing.assert_allclose(moment[row] / merged[row], (0.175, 0.0, 0.8), atol=1e-6)


def test_every_link_of_an_arm_meets_every_limb_and_its_trunk_the_helped_arm():
    """A wrist that met arms only went 10 cm into the head in DressingJaco."""
    for task, robot in itertools.product(TASKS.values(), ROBOTS.values()):
        limbs = {f"human/{x}" for x in body.shapes_of(task.human.limbs)}
        arm = {x for x in limbs if x.endswith(("upper_arm", "forearm", "hand"))}
        met: dict[str, set[str]] = {}
        for link, limb in contact_pairs(task, robot, ())["robot_human"]:
            met.setdefault(link, set()).add(limb)
        links = {f"robot/{x}" for each in robot.arms_for(task) for x in each.links}
        assert links <= set(met) and all(met[x] == limbs for x in links)
        moved = (
            robot.trunk if robot is JACO else ()
        )  # a pedestal and an arm that lies still make no pair
        assert {x: met[x] for x in set(met) - links} == {f"robot/{x}": arm for x in moved}


def test_tools_and_robots_but_no_limbs_meet_the_pillow():
    pillow = {f"seat/{x}" for x in WIPE.seat.outline}
    for robot in ROBOTS.values():
        met = contact_pairs(WIPE, robot, WIPE.human.moving(True))
        links = {f"robot/{x}" for x in robot.arms["left"].links}
        assert links == {a for a, b in met["robot_seat"] if b in pillow}
        assert pillow == {b for _, b in met["tool/seat"]} & pillow
        assert not pillow & {b for _, b in met["human_seat"]}


def test_a_pedestal_meets_arms_that_move():
    task, robot = TASKS["ArmManipulation"], ROBOTS["Sawyer"]
    met = set(contact_pairs(task, robot, task.human.moving(False))["robot_human"])
    limbs = ("upper_arm", "forearm", "hand")
    assert met >= {(f"robot/{g}", f"human/right_{x}") for g in robot.trunk for x in limbs}


def test_hand_wrist_and_forearm_meet_the_bed_and_the_hand_the_armrest():
    for task, robot in itertools.product(TASKS.values(), ROBOTS.values()):
        met = contact_pairs(task, robot, ())["robot_seat"]
        for each in robot.arms_for(task):
            count = len(each.links) if task.seat.name == "bed" else each.hand
            expected = {
                (f"robot/{x}", f"seat/{y}") for x in each.links[:count] for y in task.seat.geoms
            }
            others = {f"robot/{x}" for x in each.links[count:]}
            assert expected <= set(met) and not others & {link for link, _ in met}


@pytest.mark.parametrize(
    ("robot", "place", "yaw", "angles"),
    [
        # recorded in Assistive Gym, where Sawyer's cuff and PR2's forearm or wrist rest on the edge of the bed with 1 to 9 N: base (of Sawyer its centre of mass) and arm
        ("Sawyer", (-1.0678, -0.2758), (0.9812, 0.1932), (0.6538, 0.9060, 1.2701, -0.7526, -0.3588, -1.2657, 1.4583)),
        ("PR2", (-1.0108, -0.4840), (0.9946, -0.1036), (1.2426, 0.5019, 1.9959, -0.9817, -0.7128, -1.2711, 0.0312)),
        ("PR2", (-0.9640, -0.4681), (0.9986, -0.0534), (1.2996, 0.5898, 2.2355, -1.0423, -1.0098, -1.7544, 0.1318)),
        ("PR2", (-1.0083, -0.4058), (0.9924, 0.1234), (0.3911, 0.2976, 2.8196, -0.7645, -1.7236, -1.6577, -0.1400)),
    ],
)  # fmt: skip
def test_arms_rest_on_the_bed_where_they_do_in_assistive_gym(robot, place, yaw, angles):
    gaps = gaps_to_bed(ROBOTS[robot], place, yaw, angles, WIPE.seat.geoms)
    assert -0.005 < min(gaps.values()) < 0.01


def test_the_last_link_rests_on_the_pillow_where_it_does_in_assistive_gym():
    # recorded as above, with 7 N
    pose = (-1.0678, -0.2758), (0.9812, 0.1932), (0.4887, 0.4020, 2.2411, -0.7969, -1.1958, -1.4518, 1.6004)  # fmt: skip
    gaps = gaps_to_bed(ROBOTS["Sawyer"], *pose, WIPE.seat.outline)
    assert -0.005 < gaps["robot/right_l6_collision", "seat/pillow_side_outline"] < 0.01


def gaps_to_bed(robot, place, yaw, angles, geoms):
    """Distances of the links of a robot's arm to parts of the bed that they may touch [m]."""
    scene = build_scene(WIPE, robot)
    model, index = copy.copy(scene.model), scene.index
    data, (cos, sin) = mujoco.MjData(model), yaw
    pivot = np.array(robot.searches["BedBathing"].pivot)
    turn = np.zeros(9)
    mujoco.mju_quat2Mat(turn, np.array([cos, 0.0, 0.0, sin]))
    model.body_pos[index.robot_base] = (*place, robot.base_height + pivot[2]) - turn.reshape(
        3, 3
    ) @ pivot
    model.body_quat[index.robot_base] = (cos, 0.0, 0.0, sin)
    data.qpos[index.robot_qpos] = angles
    mujoco.mj_kinematics(model, data)
    paired = {
        frozenset((model.geom(a).name, model.geom(b).name))
        for a, b in zip(model.pair_geom1, model.pair_geom2, strict=True)
    }
    gaps = {
        (part, seat): mujoco.mj_geomDistance(
            model, data, model.geom(part).id, model.geom(seat).id, 1.0, None
        )
        for part, seat in (
            (f"robot/{x}", f"seat/{y}") for x in robot.arms["left"].links for y in geoms
        )
        if frozenset((part, seat)) in paired
    }
    assert gaps
    return gaps


# -- robots that meet themselves and what they stand on ----------------------------------------


def test_jaco_and_sawyer_meet_themselves_and_jaco_its_nightstand():
    """Assistive Gym loads PR2 and Baxter without self-collision."""
    for task, robot in itertools.product(TASKS.values(), ROBOTS.values()):
        pairs = contact_pairs(task, robot, ())
        assert bool(pairs["robot_robot"]) == (robot.name in ("Jaco", "Sawyer"))
        assert bool(pairs["robot_mount"]) == (robot is JACO and task.seat.name == "bed")


@pytest.mark.parametrize(
    ("link", "angles"),
    [
        # recorded in Assistive Gym, where these links press on the pedestal with 1 to 39 N, and the last with 109 N
        ("right_l4", (0.6504, 0.9456, 1.4381, -1.1642, 0.7629, 0.3933, -0.093)),
        ("right_l3", (0.9626, 0.9461, 1.2859, -0.6151, -0.3919, -0.9976, 0.6809)),
        ("right_l3", (0.8160, 1.1734, 0.0133, -2.2512, -1.4483, 1.3635, -1.7474)),
        ("right_l3", (0.5102, 0.9649, 0.6885, -0.9312, -1.9515, 2.1329, 1.1584)),
        ("right_l3", (0.2468, 1.2304, -0.0939, -1.1129, -1.5132, 2.3929, 0.7927)),
        ("right_l2", (-0.2268, 1.3637, -0.4139, -1.586, -1.6122, 2.186, 0.4377)),
    ],
)  # fmt: skip
def test_sawyers_arm_meets_its_pedestal_where_it_does_in_assistive_gym(link, angles):
    scene = build_scene(TASKS["ArmManipulation"], ROBOTS["Sawyer"])
    model, data = scene.model, mujoco.MjData(scene.model)
    data.qpos[scene.index.robot_qpos] = angles
    mujoco.mj_kinematics(model, data)
    pair = (f"robot/{link}_collision", "robot/pedestal_collision")
    assert frozenset(pair) in {
        frozenset((model.geom(a).name, model.geom(b).name))
        for a, b in zip(model.pair_geom1, model.pair_geom2, strict=True)
    }
    gap = mujoco.mj_geomDistance(model, data, *(model.geom(x).id for x in pair), 1.0, None)
    assert abs(gap) < 0.012


@pytest.mark.parametrize(
    ("angles", "other"),
    [
        # recorded in Assistive Gym: its hand is held off its upper arm with 30 N, its arm lies on the nightstand with 20 N
        ((1.57, 1.03, -1.27, 0.70, -2.57, 1.19, -2.74), "robot/link_2_collision"),
        ((2.85, 1.10, 1.48, 1.05, 0.62, 4.28, 0.30), "mount/nightstand_collision"),
    ],
)  # fmt: skip
def test_jaco_meets_its_arm_and_its_nightstand_where_it_does_in_assistive_gym(angles, other):
    scene = build_scene(TASKS["ArmManipulation"], JACO)
    model, index = copy.copy(scene.model), scene.index
    data = mujoco.MjData(model)
    model.body_pos[[index.robot_base, *index.mount]] = base = (-0.92, 0.66, 0.6)
    model.body_quat[index.robot_base] = (0.975, 0.0, 0.0, 0.224)
    data.qpos[index.robot_qpos] = angles
    mujoco.mj_kinematics(model, data)
    assert data.xpos[index.mount[0]] == pytest.approx(base)
    mine = [g for g in range(model.ngeom) if model.geom(g).name.startswith(("robot/", "tool/"))]
    other = model.geom(other).id
    paired = {frozenset(p) for p in zip(model.pair_geom1, model.pair_geom2, strict=True)}
    near = [
        mujoco.mj_geomDistance(model, data, g, other, 1.0, None)
        for g in mine
        if {g, other} in paired
    ]
    assert min(near) < 0.01


@pytest.mark.parametrize("task", ["ArmManipulation", "BedBathing"])
def test_warp_has_room_for_a_tool_and_an_arm_that_lie_on_the_bed(task: str):
    model = build_scene(TASKS[task], ROBOTS["PR2"]).model
    kinds = [
        {model.geom(g).name.split("/")[0] for g in pair}
        for pair in zip(model.pair_geom1, model.pair_geom2, strict=True)
    ]
    on_bed = [
        2 * (int(dim) - 1)
        for kind, dim in zip(kinds, model.pair_dim, strict=True)
        if kind in ({"seat", "tool"}, {"seat", "human"})
    ]
    assert max(on_bed) == 10  # rows of a contact with rolling friction
    rows = sum(on_bed) + int(model.jnt_limited.sum())
    assert rows <= warp_rows(model)
    assert task == "BedBathing" or rows > WARP_ROWS_PER_ENV
    assert warp_rows(build_scene(TASKS["Feeding"], ROBOTS["Sawyer"]).model) == WARP_ROWS_PER_ENV
