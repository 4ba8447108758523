"""Integer indices into a compiled model, resolved once from names; the kinds are kept apart."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np


@dataclass(frozen=True)
class ToolIndex:
    """Where one tool (or, for tasks without one, the bare hand) is."""

    body: int  # body id that the tool is part of
    quat: np.ndarray  # of the tool in that body, wxyz, float                   (4,)
    tip: int  # site id of the tool's position
    geoms: np.ndarray  # collision geom ids: capsules and spheres               (n_geoms,)
    joints: np.ndarray  # joint ids of the arm that moves it                    (n,)
    dofs: np.ndarray  # their dof addresses                                     (n,)
    # sensordata addresses of contact sensors, Index.TOUCH numbers each
    on_human: np.ndarray  # against the person                                 (n_pairs,)
    contact: np.ndarray  # which contact of a part and a limb they belong to    (n_pairs,)
    working: np.ndarray  # whether the working part makes that, float           (n_contacts,)
    on_seat: np.ndarray  # against furniture, the robot and its mount           (n,)


@dataclass(frozen=True)
class Index:
    """Where things are in ``mjx.Model`` and ``mjx.Data``. All arrays are int32 NumPy arrays.

    Rows of the person's arrays are the links and shapes that the physics model has; those of the joints
    follow the action, as those of the robot's arms do.
    """

    robot_joint: np.ndarray  # joint ids of the arms in use                   (n_arm,)
    robot_qpos: np.ndarray  # qpos addresses                                  (n_arm,)
    robot_dof: np.ndarray  # dof addresses                                    (n_arm,)
    robot_base: int  # body id that a placement moves
    mount: np.ndarray  # body ids of what carries the base, if it is solid     (0 or 1,)
    torso_site: int  # the robot's reference point
    tools: tuple[ToolIndex, ...]  # one for each arm
    robot_human: np.ndarray  # sensors: robot links against the person       (n,)
    touch_region: np.ndarray  # of ``touch``, rows of human.regions.REGIONS  (n_touch,)
    human_joint: np.ndarray  # joint ids of the moving joints                (n_person,)
    human_qpos: np.ndarray  # qpos addresses                                 (n_person,)
    human_dof: np.ndarray  # dof addresses                                   (n_person,)
    links: tuple[str, ...]  # the person's links in the model, in row order
    human_row: np.ndarray  # rows of human.body.LINKS                        (n_links,)
    shape_row: np.ndarray  # rows of human.body.SHAPES                       (n_shapes,)
    human_body: np.ndarray  # body ids                                       (n_links,)
    human_geom: np.ndarray  # collision geom ids: capsules and spheres       (n_shapes,)

    @cached_property
    def touch(self) -> np.ndarray:
        """Sensors of tools and robot links against the person (n_touch,)."""
        return np.concatenate([*(tool.on_human for tool in self.tools), self.robot_human])

    TOUCH = 6  # numbers of a contact sensor: force [N] (3), position [m] (3)
