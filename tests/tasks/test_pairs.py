# ruff: noqa: D103 (a test's name says what it shows)
"""Every task-robot pair as an episode begins: sizes, contacts, support. C MuJoCo only."""

from __future__ import annotations

import dataclasses

import mujoco
import numpy as np
import pytest

import agym_jax
from agym_jax.data.banks import load_bank
from agym_jax.human import anthropometry
from agym_jax.human import pose as human_pose
from agym_jax.human.posture import load_postures
from agym_jax.offline.bed_postures import MAX_PENETRATION
from agym_jax.registry import parse
from agym_jax.robots import ROBOTS
from agym_jax.sim.scene import compose
from agym_jax.spec import Pose
from agym_jax.tasks import TASKS

# tasks.md section 1.2: action of robot and person, observation of robot and person
SIZES = {
    "ScratchItch": (7, 10, 30, 34), "BedBathing": (7, 10, 24, 28),
    "Feeding": (7, 4, 25, 23), "Drinking": (7, 4, 25, 23), "Dressing": (7, 10, 24, 28),
    "ArmManipulation": (14, 10, 45, 42), "Reaching": (7, 4, 21, 19),
}  # fmt: skip
ONE_ARMED = ("Jaco", "Sawyer")
DEEPEST = 0.002  # [m]
# A fall ends after AG's 2 s; some arms still come to rest then, and the body rocks on the mattress [m]
NEAREST = {"right_upper_arm": 0.03, "hips": 0.006}


def test_ids_are_the_product_of_tasks_robots_and_people():
    ids = {
        f"{task}{robot}{human}-v0" for task in TASKS for robot in ROBOTS for human in ("", "Human")
    }
    assert set(agym_jax.list_envs()) == ids and len(agym_jax.list_envs()) == len(ids)
    assert set(TASKS) <= set(SIZES)


@pytest.mark.parametrize("name", agym_jax.list_envs())
def test_sizes_are_those_of_the_reference(name: str):
    recipe = parse(name)
    act_robot, act_human, obs_robot, obs_human = SIZES[recipe.task.name]
    if recipe.task.name == "ArmManipulation" and recipe.robot.name in ONE_ARMED:
        act_robot = 7  # deviation one-arm
    env = agym_jax.make(name, impl="jax")
    assert env.action_size == act_robot + (act_human if recipe.active else 0)
    assert env.observation_size == obs_robot + (obs_human if recipe.active else 0)
    assert env.episode_length == 200


def _humans(task):
    """Men and women with full and with narrow limits, as they begin: sex, limit scale, pose."""
    for sex in (0.0, 1.0):
        d = anthropometry.dims(sex)
        if not task.human.postures:
            for scale in (1.0, 0.6):
                pose = human_pose.typical(task.human, sex, limit_scale=scale)
                yield sex, scale, pose
            continue
        bank = load_postures(task.human.postures)
        own = (bank.sex == sex) & (bank.stature == 1.0) & (bank.girth == 1.0)
        full = np.flatnonzero(own & (bank.limit_scale == 1.0))
        narrow = np.flatnonzero(own & (bank.limit_scale < 0.8))
        for row in (full[3], full[90], narrow[7]):
            yield sex, float(bank.limit_scale[row]), human_pose.lying(bank, row, d, np)


@pytest.mark.parametrize("robot", ROBOTS)
@pytest.mark.parametrize("task", TASKS)
def test_nobody_begins_inside_of_anything(task: str, robot: str):
    recipe = parse(f"{task}{robot}Human-v0")  # the active person's arm is free in every task
    bank = load_bank(recipe.task, recipe.robot)
    joints = [f"robot/{x}" for arm in recipe.robot.arms_for(recipe.task) for x in arm.joints]
    moving = recipe.task.human.moving(active=True)
    for i, (sex, scale, pose) in enumerate(_humans(recipe.task)):
        row = 37 * i
        base = Pose(tuple(bank.base_pos[row].tolist()), tuple(bank.base_quat[row].tolist()))
        model = compose(
            recipe.task, recipe.robot, True, sex, limit_scale=scale, pose=pose, base=base
        )
        data = mujoco.MjData(model)
        angles = human_pose.start_angles(pose, moving, scale, np)
        names = [*joints, *(f"human/{x}" for x in moving)]
        for name, angle in zip(names, [*bank.arm_angles[row], *angles], strict=True):
            data.qpos[model.joint(name).qposadr[0]] = angle
        mujoco.mj_forward(model, data)
        for c in data.contact:
            pair = {model.geom(int(x)).name.partition("/")[0] for x in c.geom}
            lies = recipe.task.human.postures and pair == {"human", "seat"}
            assert c.dist > -(MAX_PENETRATION if lies else DEEPEST), (sex, scale, pair, c.dist)
        if recipe.task.human.postures:  # trunk and arm are borne by the mattress
            for link, near in NEAREST.items():
                assert _gap(model, data, link, recipe.task.seat.geoms) < near, (sex, scale, link)


def _gap(model: mujoco.MjModel, data: mujoco.MjData, link: str, seat: tuple[str, ...]) -> float:
    """Distance of a link of the person to what it lies on [m]."""
    mine = model.geom(f"human/{link}").id
    return min(
        mujoco.mj_geomDistance(model, data, mine, model.geom(f"seat/{x}").id, 0.2, None)
        for x in seat
    )


def test_an_arm_that_a_robot_lacks_is_named():
    one = dataclasses.replace(ROBOTS["PR2"], arms={"left": ROBOTS["PR2"].arms["left"]})
    with pytest.raises(agym_jax.AgymError, match=r"PR2 has no 'right' arm, only: left"):
        one.arms_for(TASKS["ArmManipulation"])
