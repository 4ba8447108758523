"""(task, robot, person) -> MuJoCo model and ``Index``.

Parts are composed with ``MjSpec.attach`` under the prefixes ``robot/``, ``tool/`` (and ``tool2/`` in
a second hand), ``human/``, ``seat/``, ``seat/<prop>/`` and ``mount/``. The physics model is lean: no
visual geoms, hinges only where something moves. The same function with ``visual=True`` gives the model that
people look at, with ``solid=True`` the one in which everything has its collision shape.

DEVIATION(contacts): contact is simulated between named primitives only: tool, hand, fingers, wrist and
forearm of the robot, the limbs that a task names, the right armrest or the mattress, of Jaco its two lowest links and
the nightstand, and of Sawyer the pedestal and the base of its arm (``sim.contacts``). The armrest meets the tool and the hand alone (of PR2 its fingertips). Until 24 November 2026 so did the mattress, and arms reached up to 20 cm into it:
policies of BedBathingSawyer and BedBathingPR2 that had learned so, with 91 and 83 % here, helped in 0 and 9 of 20 episodes of AG, where the arm lies on the
edge of the bed; with the present contacts they help 4.5 and 50.5 % of 200 here. Under the policies that ship, the corners of the wiper's plate pass through the trunk by up to 16 mm, and Jaco's
third link through a hand by 34 mm (DressingJaco; 5 episodes of each id, ``benchmarks.inside``). Nothing meets the rest of the furniture or of the robot; AG uses convex meshes of everything. In
AG a ScratchItchJaco policy touched the wheelchair in up to 9 % of its steps, with 1 to 6 N, most of it at the armrest.
DEVIATION(hard-limits): human joint limits are MuJoCo's limit constraints; AG resets the joint, as ``Population(masses="ag")``
does besides. AG does so at the limits of the first person that its process has met, whoever the person is: after one whose limits were 0.1 % narrower a woman's
girdle was put back in every physics step, and her elbow moved 10 cm within 0.3 s of the start, 1 cm with her own. In AG a joint at its limit is let go in every other step:
an elbow swung beyond it in 36 to 60 % of the steps of three episodes, a girdle in 0 to 24 %.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import mujoco
import numpy as np

from agym_jax.data.assets import asset_path
from agym_jax.errors import UnknownNameError
from agym_jax.human import anthropometry, body
from agym_jax.human import pose as human_pose
from agym_jax.human.model import build as build_human
from agym_jax.rendering.meshes import VISUALS, add_meshes
from agym_jax.sim.contacts import (
    SOLIMP,
    SOLREF,
    contact_pairs,
    is_sensed,
    pair_friction,
    pair_rolling,
    tool_prefixes,
)
from agym_jax.sim.index import Index
from agym_jax.sim.motors import add_motors, stiffen_motors
from agym_jax.sim.validate import check_pairs, check_robot, check_seat, check_task, check_tool
from agym_jax.spec import Arm, Goal, Pose, RobotSpec, Surface, Task, ToolSpec, Vec3

MAX_CONTACTS = 8
"""Contacts that MJX-JAX keeps per environment, the deepest first (Warp keeps all)."""
SURFACE_RADIUS = 0.002  # half thickness of what is drawn [m]


@dataclass(frozen=True)
class Scene:
    """A compiled scene.

    Attributes:
        model: MuJoCo model of an average man.
        female: the same for an average woman: invweights are interpolated between the two.
        index: where things are.
        arms: of the robot, those in use, in action order.
        moving: joints of the person that are hinges, in action order.
    """

    model: mujoco.MjModel
    female: mujoco.MjModel
    index: Index
    arms: tuple[Arm, ...]
    moving: tuple[str, ...]


@cache
def build_scene(task: Task, robot: RobotSpec, active: bool = False) -> Scene:
    """Compile the scene of a task-robot pair; the result is shared, do not write into it."""
    male = compose(task, robot, active)
    moving = task.human.moving(active)
    return Scene(
        male, compose(task, robot, active, sex=1.0),
        Index.of(male, task, robot, moving, lean_links(task, moving)),
        robot.arms_for(task), moving,
    )  # fmt: skip


def compose(
    task: Task,
    robot: RobotSpec,
    active: bool = False,
    sex: float = 0.0,
    stature: float = 1.0,
    girth: float = 1.0,
    limit_scale: float = 1.0,
    pose: human_pose.BodyPose | None = None,
    base: Pose | None = None,
    visual: bool = False,
    solid: bool = False,
    surfaces: Sequence[Surface] = (),
    visuals: str = "primitives",
) -> mujoco.MjModel:
    """Compile one person's scene.

    Args:
        task: of the scene.
        robot: of the scene.
        active: whether the person acts.
        sex: see ``anthropometry.dims``.
        stature: see there.
        girth: see there.
        limit_scale: of the person's impairment.
        pose: the person's, if not the task's typical one.
        base: the robot's, if not the one fixed to the seat.
        visual: with lights, cameras, floor and the geoms that people look at.
        solid: with every collision geom and link, not only those that may touch in physics.
        surfaces: meshes to draw; ``draw_surfaces`` moves their vertices.
        visuals: with ``visual``, what the robot looks like: "primitives", or "meshes" of other packages.

    Raises:
        SpecError: robot, tool, seat or task do not fit together, see ``validate``.
        UnknownNameError: the task names a joint or link that no person has.
    """
    check_task(task)
    if visuals not in VISUALS:
        raise UnknownNameError("visuals", visuals, VISUALS)
    arms, moving = robot.arms_for(task), task.human.moving(active)
    spec = _load("scene.xml") if visual else mujoco.MjSpec()
    if visual and task.seat.front is not None:
        _look(spec.camera("front"), *task.seat.front)
    spec.modelname = f"{task.name}{robot.name}"
    _set_options(spec, task)
    fixed_base = robot.fixed_base(task)
    base = base or fixed_base or Pose()
    robot_spec, seat_spec = _load(robot.model), _load(task.seat.model)
    check_robot(robot_spec, robot, task)
    check_seat(seat_spec, task.seat)
    if task.tool is not None:
        check_tool(_load(task.tool.model), task.tool)
    if visual and visuals == "meshes":
        add_meshes(robot_spec, robot)
    _weld_the_rest(robot_spec, robot, task, arms)
    robot_root = robot_spec.worldbody.first_body().name
    _attach(spec, robot_spec, base, "robot/")
    if task.tool is not None:
        for prefix, arm in zip(tool_prefixes(task, arms), arms, strict=True):
            _hold(spec, arm, robot, task.tool, prefix)
    for b in spec.bodies:
        if b.name.startswith(("robot/", "tool")):
            b.gravcomp = 1.0  # AG switches gravity off for robot and tool
    _attach(spec, seat_spec, Pose(), "seat/")
    everything = visual or solid
    if task.seat.name in (robot.mounts if everything else robot.solid_mounts):
        # one that belongs to the seat is drawn in the world, one that moves with the robot at its base
        mount = Pose(base.pos) if fixed_base is None else Pose()
        _attach(spec, _load(robot.mounts[task.seat.name]), mount, "mount/")
    for prop in task.seat.props if everything else ():
        _attach(spec, _load(prop.model), prop.pose, f"seat/{prop.name}/")
    d = anthropometry.dims(sex, stature, girth)
    pose = pose or human_pose.typical(task.human, sex, stature, girth, limit_scale)
    rows = human_pose.rows(task.human, pose, d, moving, limit_scale, np)
    links = tuple(x.name for x in body.LINKS) if everything else lean_links(task, moving)
    _attach(spec, build_human(rows, moving, d, links, visual), Pose(), "human/")
    for i, surface in enumerate(surfaces):
        _add_surface(spec, f"surface_{i}", surface)
    control = task.control
    driven = [f"robot/{n}" for arm in arms for n in arm.joints]
    add_motors(spec, driven, control.max_torque, control.time_step)
    for name in moving:
        spec.joint(f"human/{name}").frictionloss = task.human.max_torque
    _add_contacts(spec, task, robot, contact_pairs(task, robot, moving))
    if not everything:
        _make_lean(spec, f"robot/{robot_root}", links)
    model = spec.compile()
    check_pairs(model)
    stiffen_motors(model)
    return model


def lean_links(task: Task, moving: tuple[str, ...]) -> tuple[str, ...]:
    """Links of the person that the physics model needs: those that move, may be touched or matter."""
    goals = {Goal.of(goal).link for arm in task.goals for goal in arm}
    limbs = {"chest", *task.human.limbs, *task.human.links, *goals}
    limbs |= {f"{task.human.arm}_{x}" for x in ("upper_arm", "forearm", "hand")}
    return tuple(x.name for x in body.LINKS if body.is_free(x, moving) or x.name in limbs)


def _add_surface(spec: mujoco.MjSpec, name: str, surface: Surface) -> None:
    """A mesh that takes no part in physics: MuJoCo's flexible surface, all vertices fixed in the world."""
    flex = spec.add_flex()
    flex.name, flex.dim, flex.radius, flex.rgba = name, 2, SURFACE_RADIUS, surface.rgba
    flex.vert = np.asarray(surface.vertices, float).ravel().tolist()
    flex.elem = np.asarray(surface.triangles).ravel().tolist()
    flex.vertbody = ["world"]
    flex.contype = flex.conaffinity = 0


def draw_surfaces(data: mujoco.MjData, surfaces: Sequence[Surface]) -> None:
    """Move the vertices of ``compose``'s surfaces; kinematics of the model would put them back."""
    if surfaces:
        data.flexvert_xpos[:] = np.concatenate([np.asarray(s.vertices) for s in surfaces])


def _make_lean(spec: mujoco.MjSpec, robot_root: str, links: tuple[str, ...]) -> None:
    """Drop what nobody touches, and fuse static bodies: shallow trees run fastest in MJX.

    The robot's root, its mount and the person's links stay bodies, because they are posed per environment; an
    ``<exclude>`` that names a body keeps it from being fused.
    """
    touching = {name for pair in spec.pairs for name in (pair.geomname1, pair.geomname2)}
    for geom in list(spec.geoms):
        if geom.name not in touching and not geom.name.startswith("human/"):
            spec.delete(geom)
    spec.compiler.fusestatic = True
    mounts = [b.name for b in spec.worldbody.bodies if b.name.startswith("mount/")]
    for name in (*mounts, *(f"human/{link}" for link in links)):
        spec.add_exclude(bodyname1=robot_root, bodyname2=name)


def _load(asset: str) -> mujoco.MjSpec:
    return mujoco.MjSpec.from_file(str(Path(asset_path(asset))))


def _look(camera: mujoco.MjsCamera, origin: Vec3, target: Vec3) -> None:
    """Point a camera, upright."""
    back = np.subtract(origin, target) / np.linalg.norm(np.subtract(origin, target))
    right = np.cross((0.0, 0.0, 1.0), back)
    right /= np.linalg.norm(right)
    camera.pos = origin
    camera.alt.xyaxes = (*right, *np.cross(back, right))  # how the stage's file orients it too


def _attach(spec: mujoco.MjSpec, child: mujoco.MjSpec, pose: Pose, prefix: str) -> None:
    frame = spec.worldbody.add_frame(pos=pose.pos, quat=pose.quat)
    spec.attach(child, frame=frame, prefix=prefix)


def _set_options(spec: mujoco.MjSpec, task: Task) -> None:
    option = spec.option
    option.timestep = task.control.time_step
    option.gravity = (0.0, 0.0, task.gravity)
    option.integrator = mujoco.mjtIntegrator.mjINT_EULER
    option.cone = mujoco.mjtCone.mjCONE_PYRAMIDAL
    option.solver = mujoco.mjtSolver.mjSOL_NEWTON
    option.disableflags |= mujoco.mjtDisableBit.mjDSBL_EULERDAMP
    spec.add_numeric(name="max_contact_points", size=1, data=[MAX_CONTACTS])


def _weld_the_rest(
    spec: mujoco.MjSpec, robot: RobotSpec, task: Task, arms: tuple[Arm, ...]
) -> None:
    """Weld every joint that the task does not move: fingers at the opening, others at rest."""
    holds = task.tool.name if task.tool is not None else "hand"
    opening = robot.gripper_opening.get(holds, 0.0)
    used = {name for arm in arms for name in arm.joints}
    fingers = {name for arm in arms for name in arm.gripper}
    for joint in list(spec.joints):
        if joint.name in used:
            continue
        angle = robot.rest.get(joint.name, 0.0)
        if joint.name in fingers:
            # the second finger of a parallel gripper opens the other way
            angle = -opening if joint.range[1] <= 0.0 < joint.range[1] - joint.range[0] else opening
        _weld(spec, joint, angle)


def _weld(spec: mujoco.MjSpec, joint: mujoco.MjsJoint, angle: float) -> None:
    """Fix a joint at an angle [rad], or a shift [m] along its axis. Its anchor must be the origin."""
    child = joint.parent
    if joint.type == mujoco.mjtJoint.mjJNT_HINGE:
        turn, quat = np.zeros(4), np.zeros(4)
        mujoco.mju_axisAngle2Quat(turn, np.asarray(joint.axis, float), angle)
        mujoco.mju_mulQuat(quat, np.asarray(child.quat, float), turn)
        child.quat = quat
    else:
        shift = np.zeros(3)
        mujoco.mju_rotVecQuat(shift, np.asarray(joint.axis, float), np.asarray(child.quat, float))
        child.pos = np.asarray(child.pos) + angle * shift
    spec.delete(joint)


def _hold(spec: mujoco.MjSpec, arm: Arm, robot: RobotSpec, tool: ToolSpec, prefix: str) -> None:
    """Attach a tool rigidly to a hand.

    DEVIATION(rigid-grip): AG holds a tool by a constraint that yields: while the scratcher presses, its tip gives way by 5 mm (95 %: 10 mm), the spoon's by
    2 mm. In ScratchItch, Baxter's and PR2's scratcher turned in the hand by 2 to 9 degrees in 10 of 16 episodes there, of which 4 failed, and by more than 20
    in the others, of which 5 failed. Forces of presses at 0.3 and 1 of the full action are 3.0 and 1.3 N in the last second (AG: 4.5 and 2.2), slow ones agree
    within 2 %. The grip is a part of the cause at most: when it was 3.0 and 1.6 N (with muscles that were dampers), with contacts that yield instead, by 1 to 2
    and by 6 to 7 mm, the forces are 3.3 and 3.8 N at 0.3, and 3.0 and 0.2 N at the full action, where they depend on when the tip slides off the arm.
    """
    grasp = robot.grasps.get(tool.name, tool.grasp)
    site = spec.site(f"robot/{arm.tool_frame}")
    pos, quat = np.zeros(3), np.zeros(4)
    mujoco.mju_mulPose(
        pos, quat, np.asarray(site.pos, float), np.asarray(site.quat, float),
        np.asarray(grasp.pos, float), np.asarray(grasp.quat, float),
    )  # fmt: skip
    frame = site.parent.add_frame(pos=pos, quat=quat)
    spec.attach(_load(tool.model), frame=frame, prefix=prefix)


def _add_contacts(
    spec: mujoco.MjSpec, task: Task, robot: RobotSpec, touches: dict[str, list[tuple[str, str]]]
) -> None:
    data = mujoco.mjtConDataField
    bits = 1 << int(data.mjCONDATA_FORCE) | 1 << int(data.mjCONDATA_POS)
    for kind, pairs in touches.items():
        friction = pair_friction(kind, task, robot)
        roll = pair_rolling(kind, task, robot)
        for a, b in pairs:
            spec.add_pair(
                name=f"{a}|{b}", geomname1=a, geomname2=b, condim=6 if roll else 3,
                friction=[friction, friction, *([roll] * 3 if roll else (0.005, 0.0001, 0.0001))],
                solref=SOLREF, solimp=SOLIMP,
            )  # fmt: skip
            if is_sensed(kind):
                spec.add_sensor(
                    name=f"{kind}|{a}|{b}", type=mujoco.mjtSensor.mjSENS_CONTACT,
                    objtype=mujoco.mjtObj.mjOBJ_GEOM, objname=a,
                    reftype=mujoco.mjtObj.mjOBJ_GEOM, refname=b,
                    # force and position of the deepest contact; not of that of largest force: where that
                    # is zero, MJX-JAX 3.17 reports the force of another pair
                    intprm=[bits, 1, 1],
                )  # fmt: skip
