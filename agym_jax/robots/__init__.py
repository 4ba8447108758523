"""The robots: one file of data each."""

from agym_jax.robots.jaco import JACO

ROBOTS = {robot.name: robot for robot in (JACO,)}
