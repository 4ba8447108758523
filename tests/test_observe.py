# ruff: noqa: D103
"""Observation records: sizes and order of the reference, and what a layout hash notices."""

from __future__ import annotations

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import Array

from agym_jax import observe
from agym_jax.errors import SpecError
from agym_jax.observe import column, observation, part
from agym_jax.robots import ROBOTS
from agym_jax.tasks import TASKS

TASK = TASKS["ScratchItch"]
# Reference tasks.md section 2: dims and elements, in order.
ROBOT = {
    "tool_pos_torso": 3, "tool_quat_w": 4, "tool_pos_target": 3, "target_pos_torso": 3, "arm_angles": 7,
    "shoulder_pos_torso": 3, "elbow_pos_torso": 3, "wrist_pos_torso": 3, "tool_force": 1,
}  # fmt: skip
PERSON = {
    "tool_pos_human": 3, "tool_quat_w": 4, "tool_pos_target": 3, "target_pos_human": 3,
    "human_angles": 10, "shoulder_pos_human": 3, "elbow_pos_human": 3, "wrist_pos_human": 3,
    "force_on_human": 1, "force_at_target": 1,
}  # fmt: skip


@observation
class Toy:
    """Two fields."""

    place: Array = column(3, "m", "world", "here")
    force: Array = column(1, "N", "sum", "there")


@pytest.mark.parametrize(
    ("record", "expected", "total"), [(TASK.robot_obs, ROBOT, 30), (TASK.human_obs, PERSON, 34)]
)
def test_layout_is_the_references(record: type, expected: dict, total: int):
    assert {n: c.size for n, c in observe.columns(record).items()} == expected
    assert list(observe.columns(record)) == list(expected)  # dicts compare without order
    assert observe.size(record) == total
    slices = observe.layout(record)
    assert slices[list(expected)[-1]].stop == total
    assert [s.start for s in slices.values()] == list(np.cumsum([0, *expected.values()][:-1]))


@pytest.mark.parametrize("robot", ROBOTS)
@pytest.mark.parametrize(
    ("task", "robot_action", "human_action", "robot_obs", "human_obs"),
    [  # tasks.md section 1.2
        ("ScratchItch", 7, 10, 30, 34), ("BedBathing", 7, 10, 24, 28),
        ("ArmManipulation", 14, 10, 45, 42), ("Reaching", 7, 4, 21, 19),
    ],
)  # fmt: skip
def test_every_pair_has_the_references_sizes(
    task: str, robot: str, robot_action: int, human_action: int, robot_obs: int, human_obs: int
):
    spec = TASKS[task]
    assert (observe.size(spec.robot_obs), observe.size(spec.human_obs)) == (robot_obs, human_obs)
    assert len(spec.human.moving(active=True)) == human_action
    joints = [j for arm in ROBOTS[robot].arms_for(spec) for j in arm.joints]
    one_armed = robot in ("Jaco", "Sawyer")  # deviation one-arm: AG ignores 7 of the 14
    assert len(joints) == (7 if one_armed else robot_action)


def test_environments_have_the_references_sizes(static_env, active_env):
    # tasks.md section 1.2
    assert (static_env.observation_size, static_env.action_size) == (30, 7)
    assert (active_env.observation_size, active_env.action_size) == (64, 17)
    assert active_env.observation_sizes == {"robot": 30, "human": 34}
    assert active_env.action_sizes == {"robot": 7, "human": 10}


def test_flatten_keeps_the_order():
    flat = observe.flatten(Toy(jnp.array([1.0, 2.0, 3.0]), jnp.float32(4.0)))
    np.testing.assert_array_equal(flat, [1, 2, 3, 4])
    assert flat.dtype == jnp.float32


def test_flatten_refuses_a_field_of_another_size():
    with pytest.raises(SpecError, match=r"Toy\.place is declared with 3 entries but has 2"):
        observe.flatten(Toy(jnp.zeros(2), jnp.float32(0.0)))


def record(source: str = "", **fields: Any) -> type:
    """A record whose fields are keyword arguments, in their order."""
    body = {**fields, "__annotations__": dict.fromkeys(fields, Array)}
    return observation(source=source)(type("Record", (), body))


def place(frame: str = "world", source: str = "here") -> Any:
    return column(3, "m", frame, source)


def force() -> Any:
    return column(1, "N", "sum", "there")


def test_layout_version_notices_every_change_of_meaning():
    records = [
        Toy,
        record(position=place(), force=force()),
        record(force=force(), place=place()),
        record(place=place("chest"), force=force()),
    ]
    versions = [observe.layout_version(r) for r in records]
    versions.append(observe.layout_version(Toy, Toy))
    assert len(set(versions)) == 5
    # where it comes from is not what it is
    elsewhere = record(place=place(source="another source"), force=force())
    assert observe.layout_version(elsewhere) == versions[0]


def test_columns_of_a_part_stand_in_its_place():
    whole = record("mine", place=column(3, "m", "world"), toy=part(record(at=place())), end=force())
    flat = record(place=place(), at=place(), end=force())
    assert observe.layout_version(whole) == observe.layout_version(flat)
    sources = {name: c.source for name, c in observe.columns(whole).items()}
    assert sources == {"place": "mine", "at": "here", "end": "there"}
    inner = record(at=column(3, "m", "world"))
    outer = record("mine", toy=part(inner))
    assert observe.columns(inner)["at"].source == "" and "| mine |" in observe.table(outer)
    seen = outer(inner(jnp.arange(3.0)))
    np.testing.assert_array_equal(observe.flatten(seen), [0, 1, 2])
    np.testing.assert_array_equal(observe.flatten(jax.tree.map(lambda x: x + 1, seen)), [1, 2, 3])
    with pytest.raises(SpecError, match=r"Record\.toy is declared as Record but has a Toy"):
        observe.flatten(outer(Toy(jnp.zeros(3), jnp.float32(0.0))))


def test_a_record_that_does_not_fit_together_is_refused():
    with pytest.raises(SpecError, match=r"two columns named place\."):
        record(place=place(), toy=part(Toy))
    for odd in (dataclasses.field(), part(int)):
        with pytest.raises(SpecError, match=r"Record\.odd is neither column\("):
            record(odd=odd)


def test_static_and_active_layouts_differ(static_env, active_env):
    assert static_env.layout_version != active_env.layout_version
