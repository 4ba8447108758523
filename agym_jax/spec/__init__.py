"""Frozen records that describe robots, tools, seats, people and tasks, and the Task protocol.

Robot files and task files contain only these records and pure functions; ``scene.py`` builds a MuJoCo model from them,
and ``env.py`` an environment. Lengths are in metres, angles in radians and quaternions wxyz, unless noted otherwise.
"""

from .optional import (
    BatchedOnCpu,
    Comfortable,
    Diagnosed,
    Ending,
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
    "Diagnosed",
    "Ending",
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
