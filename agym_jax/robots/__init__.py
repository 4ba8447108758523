"""The robots: one file of data each, imported when it is first asked for."""

from __future__ import annotations

from typing import TYPE_CHECKING

from agym_jax.catalogue import Catalogue

if TYPE_CHECKING:
    from agym_jax.spec import RobotSpec

ROBOTS: Catalogue[RobotSpec] = Catalogue(
    {
        "PR2": "agym_jax.robots.pr2:PR2",
        "Jaco": "agym_jax.robots.jaco:JACO",
        "Baxter": "agym_jax.robots.baxter:BAXTER",
        "Sawyer": "agym_jax.robots.sawyer:SAWYER",
    }
)
"""Name -> robot; the name is the robot's own."""
