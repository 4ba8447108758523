"""The robot's motors against Assistive Gym's."""

# ruff: noqa: D103
import numpy as np
import pytest

from agym_jax.robots import ROBOTS
from benchmarks.parity import motors
from benchmarks.parity.row import traces


@pytest.mark.parametrize("task", ["ScratchItch", "Feeding", "Dressing", "ArmManipulation"])
def test_random_actions_end_where_assistive_gyms_do(task: str):
    for robot in ROBOTS:
        assert motors.ends(task, robot) < motors.ENDS, robot


@pytest.mark.parametrize("robot", ROBOTS)
def test_heavy_joints_accelerate_as_assistive_gyms(robot: str):
    arm = motors.Arm("ScratchItch", robot)
    for joint, path in enumerate(traces("motors")[f"steps_{robot}"]):
        ours = arm.play(path[0], np.tile(np.eye(7)[joint], (len(path) - 1, 1)))
        np.testing.assert_allclose(ours[:5], path[:5], atol=0.006, err_msg=f"joint {joint + 1}")
