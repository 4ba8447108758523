"""Whether a robot, tool, seat and task fit together, asked before MuJoCo is: every error names the field.

``scene.compose`` calls these, so that scenes, banks and environments all refuse the same mistakes.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import get_args

import mujoco

from agym_jax.errors import SpecError, UnknownNameError, did_you_mean
from agym_jax.human import body, population
from agym_jax.human.regions import comfort_limits
from agym_jax.spec import Arm, Goal, PassiveMode, Prepared, RobotSpec, SeatSpec, Task, ToolSpec

COLLISION = "collision"
"""What names of collision geoms contain: the search for start placements goes by it."""
ROUND = (mujoco.mjtGeom.mjGEOM_CAPSULE, mujoco.mjtGeom.mjGEOM_SPHERE)


def check_task(task: Task) -> None:
    """The task's own names, those of its person, and what it makes of its data.

    Raises:
        UnknownNameError: there is no such joint, link, region, impairment or way to be still.
        SpecError: a field is empty, a text instead of a tuple, or of another length than it should be.
        AgymError: what ``Prepared.prepare`` of the task raises.
    """
    human, owner = task.human, f"{task.name}'s HumanSpec"
    _check_tuple(f"{task.name}'s arms", task.arms)
    _check_tuple(f"{task.name}'s goals", task.goals)
    if len(task.goals) != len(task.arms):
        raise SpecError(
            f"{task.name}'s goals must have one tuple of links for each of its arms, in order: it has "
            f"{len(task.goals)} for {len(task.arms)} ({', '.join(task.arms)}). () stands for none."
        )
    for goals in task.goals:
        _check_text(f"{task.name}'s goals", goals)
        links = tuple(Goal.of(goal).link for goal in goals)
        _check_names(f"{task.name}'s goals", "link", links, (*body.LINK, "mouth"))
    _check_names(f"{owner}.limbs", "link", human.limbs, body.LINK)
    _check_names(f"{owner}.joints", "joint", human.joints, body.JOINTS)
    _check_names(f"{owner}.pose", "joint", tuple(human.pose), body.JOINTS)
    _check_names(f"{owner}.pose_range", "joint", tuple(human.pose_range), body.JOINTS)
    _check_tuple(f"{owner}.impairments", human.impairments, 'A healthy person is ("none",).')
    _check_names(f"{owner}.impairments", "impairment", human.impairments, population.IMPAIRMENTS)
    _check_names(
        f"{owner}.passive_mode", "passive mode", (human.passive_mode,), get_args(PassiveMode)
    )
    _check_names(f"{owner}.arm", "side", (human.arm,), ("left", "right"))
    comfort_limits(task)
    if isinstance(task, Prepared):
        task.prepare()


def check_robot(spec: mujoco.MjSpec, robot: RobotSpec, task: Task) -> None:
    """The names of a robot in its file, and the shapes of the links that a task uses.

    Raises:
        SpecError: the file lacks one of them, or a shape cannot be sensed.
    """
    where = f"{robot.name}'s file {robot.model}"
    joints = _named(spec.joints)
    _check_there(where, "joint", (*robot.rest, *robot.endless), joints)
    geoms = _named(spec.geoms)
    if not any(COLLISION in name for name in geoms):
        raise SpecError(
            f"{where} has no geom with {COLLISION!r} in its name, so the search for start placements would "
            f"see nothing of the robot. It has: {', '.join(geoms) or 'none with a name'}."
        )
    for kind in ("trunk", "near_trunk", "near_mount"):
        _check_text(f"{robot.name}'s {kind}", getattr(robot, kind))
        _check_there(where, "geom", getattr(robot, kind), geoms)
    for kind in ("solid_mounts", "mount_fronts"):
        for seat, names in getattr(robot, kind).items():
            _check_text(f"{robot.name}'s {kind}[{seat!r}]", names)
            if seat not in robot.mounts:
                raise SpecError(
                    f"{robot.name}'s {kind} has {seat!r}, its mounts do not: "
                    f"{did_you_mean(seat, list(robot.mounts))}"
                )
    for arm in robot.arms_for(task):
        _check_arm(where, spec, robot, arm)
        if task.tool is None:  # the hand is sensed as a tool would be
            _check_round(f"{where}: the hand, Arm.links[0],", spec, arm.links[:1])


def check_pairs(model: mujoco.MjModel) -> None:
    """That one of the two geoms of every contact pair can move against the other.

    Raises:
        SpecError: neither can: their contact would have no finite force.
    """
    welded = model.body_weldid[model.geom_bodyid]
    for one, other in zip(model.pair_geom1, model.pair_geom2, strict=True):
        if welded[one] == welded[other]:
            raise SpecError(
                f"{model.geom(one).name!r} and {model.geom(other).name!r} form a contact pair, but no joint moves one "
                f"against the other. Arm.links, near_trunk and near_mount of a robot are geoms that its arm moves."
            )


def check_tool(spec: mujoco.MjSpec, tool: ToolSpec) -> None:
    """The names of a tool in its file, and the shapes of its collision geoms.

    Raises:
        SpecError: the file lacks one of them, or a shape cannot be sensed.
    """
    where = f"The tool {tool.name}'s file {tool.model}"
    _check_tuple(f"The tool {tool.name}'s geoms", tool.geoms)
    _check_there(where, "site", (tool.tip,), _named(spec.sites))
    _check_there(where, "geom", tool.geoms, _named(spec.geoms))
    _check_collision(f"The tool {tool.name}'s geoms", tool.geoms)
    _check_round(f"{where}: ToolSpec.geoms'", spec, tool.geoms)
    if tool.outline:
        _check_there(where, "geom", (tool.outline,), _named(spec.geoms))
        _check_collision(f"The tool {tool.name}'s outline", (tool.outline,))
        if tool.outline in tool.geoms:
            raise SpecError(
                f"The tool {tool.name}'s outline {tool.outline!r} is one of its geoms too."
            )
    if not 1 <= tool.n_working <= len(tool.geoms):
        raise SpecError(
            f"The tool {tool.name} has {len(tool.geoms)} geoms, of which n_working={tool.n_working} do the "
            f"work: it must be 1 to {len(tool.geoms)}."
        )
    if tool.parts and (sum(tool.parts) != len(tool.geoms) or min(tool.parts) < 1):
        raise SpecError(
            f"The tool {tool.name}'s parts {tool.parts} must be sizes of at least 1 whose sum is the number of its "
            f"geoms, {len(tool.geoms)}."
        )


def check_seat(spec: mujoco.MjSpec, seat: SeatSpec) -> None:
    """The names of a seat in its file.

    Raises:
        SpecError: the file lacks one of them.
    """
    for field in ("geoms", "pillow", "outline"):
        _check_text(f"The seat {seat.name}'s {field}", getattr(seat, field))
    _check_there(
        f"The seat {seat.name}'s file {seat.model}", "geom", (*seat.geoms, *seat.pillow, *seat.outline),
        _named(spec.geoms),
    )  # fmt: skip


def _check_arm(where: str, spec: mujoco.MjSpec, robot: RobotSpec, arm: Arm) -> None:
    for field in ("joints", "links"):
        _check_tuple(f"{robot.name}'s Arm.{field}", getattr(arm, field))
    _check_text(f"{robot.name}'s Arm.gripper", arm.gripper)
    sites = (arm.end_effector, arm.tool_frame, robot.torso)
    _check_there(where, "joint", (*arm.joints, *arm.gripper), _named(spec.joints))
    _check_there(where, "site", sites, _named(spec.sites))
    _check_there(where, "geom", arm.links, _named(spec.geoms))
    _check_collision(f"{robot.name}'s Arm.links", arm.links)


def _check_text(what: str, names: object) -> None:
    """A tuple of one name is easily written without its comma, and is then its letters."""
    if isinstance(names, str):
        raise SpecError(f"{what} is the text {names!r}; a tuple of one has a comma: ({names!r},).")


def _check_tuple(what: str, names: tuple, advice: str = "") -> None:
    _check_text(what, names)
    if not names:
        raise SpecError(f"{what} is empty; it needs at least one entry. {advice}".strip())


def _check_names(what: str, kind: str, names: tuple[str, ...], options: Iterable[str]) -> None:
    _check_text(what, names)
    for name in names:
        if name not in options:
            raise UnknownNameError(f"{kind} in {what}:", name, options)


def _check_there(where: str, kind: str, names: Iterable[str], existing: list[str]) -> None:
    for name in names:
        if name not in existing:
            raise SpecError(f"{where} has no {kind} {name!r}. {did_you_mean(name, existing)}")


def _check_collision(what: str, names: tuple[str, ...]) -> None:
    for name in names:
        if COLLISION not in name:
            raise SpecError(
                f"{what}: {name!r} needs {COLLISION!r} in its name, here and in the file, or the search for "
                f"start placements would not see it."
            )


def _check_round(what: str, spec: mujoco.MjSpec, names: tuple[str, ...]) -> None:
    for name in names:
        geom = spec.geom(name)
        if geom.type not in ROUND:
            shape = mujoco.mjtGeom(geom.type).name.removeprefix("mjGEOM_").lower()
            raise SpecError(
                f"{what} {name!r} is a {shape}, but its distance to the person is that of a capsule or sphere: "
                f"make it one of these."
            )


def _named(elements: Iterable) -> list[str]:
    return [x.name for x in elements if x.name]
