"""The robots: one file of data each."""

from agym_jax.robots.baxter import BAXTER
from agym_jax.robots.jaco import JACO
from agym_jax.robots.pr2 import PR2
from agym_jax.robots.sawyer import SAWYER
from agym_jax.spec import RobotSpec

ROBOTS: dict[str, RobotSpec] = {robot.name: robot for robot in (PR2, JACO, BAXTER, SAWYER)}
