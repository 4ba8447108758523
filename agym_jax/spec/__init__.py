"""Frozen records that describe robots, tools, seats, people and tasks, and the Task protocol.

A robot file and a task file hold nothing but these records and pure functions; ``scene.py`` turns them into a MuJoCo
model, ``env.py`` into an environment. Lengths in metres, angles in radians, quaternions wxyz, if not named otherwise.
"""

from .optional import (
    BatchedOnCpu,
    Comfortable,
    Furnished,
    Loaded,
    Measure,
    Measured,
    Prepared,
    Privileged,
    Surface,
    Surfaced,
)
from .pose import IDENTITY, Pose, Quat, Rgba, Vec3
from .robot import Arm, BaseSearch, MeshModel, MeshPart, RobotSpec
from .task import Control, Goal, HumanSpec, PassiveMode, Preferences, Prop, SeatSpec, Task, ToolSpec

__all__ = [
    "IDENTITY",
    "Arm",
    "BaseSearch",
    "BatchedOnCpu",
    "Comfortable",
    "Control",
    "Furnished",
    "Goal",
    "HumanSpec",
    "Loaded",
    "Measure",
    "Measured",
    "MeshModel",
    "MeshPart",
    "PassiveMode",
    "Pose",
    "Preferences",
    "Prepared",
    "Privileged",
    "Prop",
    "Quat",
    "Rgba",
    "RobotSpec",
    "SeatSpec",
    "Surface",
    "Surfaced",
    "Task",
    "ToolSpec",
    "Vec3",
]
