# ruff: noqa: D103
"""Ids: what exists, what users add, and what is said about what does not exist."""

from __future__ import annotations

import dataclasses

import gymnasium
import pytest

import agym_jax
from agym_jax.errors import AgymError, MissingPlacementError, SpecError, UnknownNameError
from agym_jax.registry import list_envs, parse, register_robot, register_task
from agym_jax.robots import ROBOTS
from agym_jax.tasks import TASKS


def test_every_listed_id_parses_into_itself():
    ids = list_envs()
    assert len(ids) == len(set(ids)) == 2 * len(TASKS) * len(ROBOTS)
    assert agym_jax.list_envs() == ids
    assert {"ReachingPR2-v0", "BedBathingSawyer-v0", "ArmManipulationBaxterHuman-v0"} <= set(ids)
    for name in ids:
        recipe = parse(name)
        assert recipe.name == name
        assert recipe.active == ("Human" in name)
        assert name.startswith(recipe.task.name + recipe.robot.name)


@pytest.mark.parametrize("prefix", ["agym_jax:", "agym_jax/"])
def test_prefix_of_the_package_is_dropped(prefix: str):
    assert parse(f"{prefix}ScratchItchJaco-v0") == parse("ScratchItchJaco-v0")


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("ScratchItchJako-v0", r"Did you mean 'ScratchItchJaco-v0'.*robot 'Jako' does not.*'Jaco'"),
        ("ScratchItchjaco-v0", r"Did you mean 'ScratchItchJaco-v0'"),
        ("ScratchItchPR3-v0", r"The task ScratchItch exists, the robot 'PR3' does not"),
        ("ScrachItchJacoHuman-v0", r"Did you mean 'ScratchItchJacoHuman-v0'.*task \+ robot"),
        ("ScratchItchJaco-v7", r"Unknown environment 'ScratchItchJaco-v7'.*-v0"),
        ("nonsense", r"There are: "),
    ],
)
def test_unknown_id_says_what_is_wrong_and_what_is_near(name: str, message: str):
    with pytest.raises(UnknownNameError, match=message) as caught:
        agym_jax.make(name)
    assert isinstance(caught.value, AgymError) and isinstance(caught.value, KeyError)


def test_task_from_outside_gets_ids_and_says_what_it_lacks():
    toy = dataclasses.replace(TASKS["ScratchItch"], name="ToyItch")
    register_task(toy)
    try:
        assert "ToyItchJaco-v0" in list_envs() and "ToyItchJacoHuman-v0" in list_envs()
        assert parse("ToyItchJaco-v0").task is toy
        with pytest.raises(
            MissingPlacementError, match=r"agym_jax\.placement build ToyItchJaco-v0"
        ):
            agym_jax.make("ToyItchJaco-v0")
        with pytest.raises(SpecError, match="'ToyItch' already"):
            register_task(toy)
        agym_jax.register_envs()
        assert "ToyItchJaco-v0" in gymnasium.registry
    finally:
        del TASKS["ToyItch"]
        for name in [n for n in gymnasium.registry if n.startswith("ToyItch")]:
            del gymnasium.registry[name]
    assert "ToyItchJaco-v0" not in list_envs()


def test_robot_from_outside_gets_ids():
    robot = dataclasses.replace(ROBOTS["Jaco"], name="Toybot")
    register_robot(robot)
    try:
        assert parse("ScratchItchToybotHuman-v0").robot is robot
        with pytest.raises(SpecError, match="'Toybot' already"):
            register_robot(robot)
    finally:
        del ROBOTS["Toybot"]
