"""Integer indices into a compiled model, resolved once from names; the kinds are kept apart."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Index:
    """Where things are in ``mjx.Model`` and ``mjx.Data``. All arrays are int32 NumPy arrays.

    Rows of the person's arrays are the links that the physics model has; those of the joints follow
    the action.
    """

    robot_joint: np.ndarray  # joint ids of the arm in use                    (n_arm,)
    robot_qpos: np.ndarray  # qpos addresses                                  (n_arm,)
    robot_dof: np.ndarray  # dof addresses                                    (n_arm,)
    robot_ctrl: np.ndarray  # actuator ids                                    (n_arm,)
    robot_base: int  # body id that a placement moves
    person_joint: np.ndarray  # joint ids of the controllable joints          (n_person,)
    person_qpos: np.ndarray  # qpos addresses                                 (n_person,)
    person_dof: np.ndarray  # dof addresses                                   (n_person,)
    person_row: np.ndarray  # rows of person.body.LINKS                       (n_links,)
    person_body: np.ndarray  # body ids                                       (n_links,)
    person_geom: np.ndarray  # collision geom ids                             (n_links,)
    tool_body: int  # body id that the tool is part of
    tool_quat: np.ndarray  # of the tool in that body, wxyz, float              (4,)
    tip_site: int  # the tool's position
    torso_site: int  # the robot's reference point
    chest_body: int
    upper_arm_body: int  # of the arm that is helped; its origin is the shoulder
    forearm_body: int  # its origin is the elbow
    hand_body: int  # its origin is the wrist
    # sensordata addresses of contact sensors, TOUCH numbers each: force [N] (3), position [m] (3)
    tool_person: np.ndarray  # working part and handle against the person     (n_touch,)
    tool_seat: np.ndarray  # against furniture                                (n,)
    robot_person: np.ndarray  # robot links against the person                (n,)

    TOUCH = 6
