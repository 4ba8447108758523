"""Integer indices into a compiled model, resolved once from names; the kinds are kept apart. The only reader of names."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property

import mujoco
import numpy as np

from agym_jax.errors import UnknownNameError
from agym_jax.human import body
from agym_jax.sim.contacts import (
    contact_pairs,
    is_sensed,
    tool_prefixes,
    touch_rows,
    touched_regions,
)
from agym_jax.spec import Arm, RobotSpec, Task

OBJ = mujoco.mjtObj
Pairs = dict[str, list[tuple[str, str]]]
"""From ``sim.contacts.contact_pairs``."""


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

    @classmethod
    def of(
        cls, model: mujoco.MjModel, task: Task, arm: Arm, prefix: str, pairs: Pairs
    ) -> ToolIndex:
        """The tool in the hand of an arm.

        Args:
            model: of the scene.
            task: of the scene.
            arm: that holds it.
            prefix: of the tool's names.
            pairs: that may touch.
        """
        joints = _ids(model, OBJ.mjOBJ_JOINT, [f"robot/{n}" for n in arm.joints])
        on_human = on_seat = contact = np.zeros(0, np.int32)
        working = np.zeros(0, np.float32)
        if task.tool is None:
            tip, names = f"robot/{arm.end_effector}", [f"robot/{arm.links[0]}"]
        else:
            tip, names = f"{prefix}{task.tool.tip}", [f"{prefix}{g}" for g in task.tool.geoms]
            on_human = _sensors(model, f"{prefix}human", pairs)
            others = [f"{prefix}{x}" for x in ("seat", "robot", "mount")]
            on_seat = np.concatenate([_sensors(model, kind, pairs) for kind in others])
            rows, works = touch_rows(task, pairs[f"{prefix}human"])
            contact, working = np.array(rows, np.int32), np.array(works, np.float32)
        site = int(_ids(model, OBJ.mjOBJ_SITE, [tip])[0])
        return cls(
            body=int(model.site_bodyid[site]),
            quat=model.site_quat[site].astype(np.float32),
            tip=site,
            geoms=_ids(model, OBJ.mjOBJ_GEOM, names),
            joints=joints,
            dofs=model.jnt_dofadr[joints],
            on_human=on_human,
            contact=contact,
            working=working,
            on_seat=on_seat,
        )


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
    robot_pair: np.ndarray  # contact pairs of tools and robot with anything   (n,)
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
    robot: str  # its name
    robot_links: tuple[str, ...]  # those that the joints of the arms in use move
    robot_body: np.ndarray  # body ids                                       (r,)

    @classmethod
    def of(
        cls,
        model: mujoco.MjModel,
        task: Task,
        robot: RobotSpec,
        moving: tuple[str, ...],
        links: tuple[str, ...],
    ) -> Index:
        """Of a compiled scene.

        Args:
            model: of the scene.
            task: of the scene.
            robot: of the scene.
            moving: joints of the person that are hinges, in action order.
            links: of the person that the model has.

        Raises:
            UnknownNameError: the model has no such thing; the message has the nearest.
        """
        arms, pairs = robot.arms_for(task), contact_pairs(task, robot, moving)
        prefixes = tool_prefixes(task, arms) or ("",) * len(arms)
        robot_joint = _ids(
            model, OBJ.mjOBJ_JOINT, [f"robot/{n}" for arm in arms for n in arm.joints]
        )
        human_joint = _ids(model, OBJ.mjOBJ_JOINT, [f"human/{n}" for n in moving])
        shapes = [x for x, link in body.SHAPES.items() if link in links]
        mount = [f"mount/{g}" for g in robot.solid_mounts.get(task.seat.name, ())]
        torso = int(_ids(model, OBJ.mjOBJ_SITE, [f"robot/{robot.torso}"])[0])
        robot_links = _moved(model, robot_joint)
        return cls(
            robot_joint=robot_joint,
            robot_qpos=model.jnt_qposadr[robot_joint],
            robot_dof=model.jnt_dofadr[robot_joint],
            robot_base=int(model.body_rootid[model.site_bodyid[torso]]),
            mount=np.unique(model.geom_bodyid[_ids(model, OBJ.mjOBJ_GEOM, mount)]),
            robot_pair=_pairs_of(model, ("robot/", *prefixes)),
            torso_site=torso,
            tools=tuple(
                ToolIndex.of(model, task, arm, prefix, pairs)
                for arm, prefix in zip(arms, prefixes, strict=True)
            ),
            robot_human=_sensors(model, "robot_human", pairs),
            touch_region=np.array(touched_regions(pairs), np.int32),
            human_joint=human_joint,
            human_qpos=model.jnt_qposadr[human_joint],
            human_dof=model.jnt_dofadr[human_joint],
            links=links,
            human_row=np.array([i for i, x in enumerate(body.LINKS) if x.name in links], np.int32),
            shape_row=np.array([i for i, x in enumerate(body.SHAPES) if x in shapes], np.int32),
            human_body=_ids(model, OBJ.mjOBJ_BODY, [f"human/{name}" for name in links]),
            human_geom=_ids(model, OBJ.mjOBJ_GEOM, [f"human/{x}" for x in shapes]),
            robot=robot.name,
            robot_links=robot_links,
            robot_body=_ids(model, OBJ.mjOBJ_BODY, [f"robot/{name}" for name in robot_links]),
        )

    @cached_property
    def touch(self) -> np.ndarray:
        """Sensors of tools and robot links against the person (n_touch,)."""
        return np.concatenate([*(tool.on_human for tool in self.tools), self.robot_human])

    TOUCH = 6  # numbers of a contact sensor: force [N] (3), position [m] (3)


def ancestors(model: mujoco.MjModel, body: int) -> set[int]:
    """A body and those that it hangs on, without the world."""
    found = set()
    while body:
        found.add(body)
        body = int(model.body_parentid[body])
    return found


def _moved(model: mujoco.MjModel, joints: np.ndarray) -> tuple[str, ...]:
    """Names of the robot's bodies that any of these joints moves, in the order of the model."""
    own = set(model.jnt_bodyid[joints].tolist())
    names = {b: mujoco.mj_id2name(model, OBJ.mjOBJ_BODY, b) or "" for b in range(model.nbody)}
    return tuple(
        name.removeprefix("robot/")
        for b, name in names.items()
        if name.startswith("robot/") and own & ancestors(model, b)
    )


def _pairs_of(model: mujoco.MjModel, prefixes: tuple[str, ...]) -> np.ndarray:
    """Ids of the contact pairs of geoms whose names begin with one of these, but for an empty one (n,)."""
    starts = tuple(x for x in prefixes if x)
    geoms = np.stack([model.pair_geom1, model.pair_geom2], -1)
    names = [[mujoco.mj_id2name(model, OBJ.mjOBJ_GEOM, x) or "" for x in pair] for pair in geoms]
    return np.array([i for i, x in enumerate(names) if any(n.startswith(starts) for n in x)], int)


def _ids(model: mujoco.MjModel, kind: mujoco.mjtObj, names: Iterable[str]) -> np.ndarray:
    """Ids of things of one kind, by their names (n,)."""
    found = []
    for name in names:
        found.append(mujoco.mj_name2id(model, kind, name))
        if found[-1] < 0:
            existing = [mujoco.mj_id2name(model, kind, i) or "" for i in range(_count(model, kind))]
            raise UnknownNameError(kind.name.removeprefix("mjOBJ_").lower(), name, existing)
    return np.array(found, np.int32)


def _sensors(model: mujoco.MjModel, kind: str, pairs: Pairs) -> np.ndarray:
    """Addresses of the contact sensors of one kind of pairs (n,)."""
    assert is_sensed(kind)
    names = [f"{kind}|{a}|{b}" for a, b in pairs[kind]]
    return model.sensor_adr[_ids(model, OBJ.mjOBJ_SENSOR, names)].astype(np.int32)


def _count(model: mujoco.MjModel, kind: mujoco.mjtObj) -> int:
    return {
        OBJ.mjOBJ_JOINT: model.njnt, OBJ.mjOBJ_BODY: model.nbody, OBJ.mjOBJ_SITE: model.nsite,
        OBJ.mjOBJ_GEOM: model.ngeom, OBJ.mjOBJ_SENSOR: model.nsensor,
    }[kind]  # fmt: skip
