"""(task, robot, person) -> MuJoCo model and Index: the only reader of names.

Parts are composed with ``MjSpec.attach`` under the prefixes ``robot/``, ``tool/``, ``person/``,
``seat/`` and ``mount/``. The physics model is lean: no visual geoms, hinges only where something
moves. The same function with ``visual=True`` gives the model that people look at.

DEVIATION(contacts): contact is simulated between named primitives only: tool, hand, wrist and forearm
of the robot, the person's arm, torso, head and right thigh, and the right armrest. The robot does not
collide with itself or with the rest of the wheelchair; AG uses convex meshes of everything.
DEVIATION(hard-limits): human joint limits are MuJoCo's limit constraints; AG resets the joint.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from pathlib import Path

import mujoco
import numpy as np

from agym_jax.assets import asset_path
from agym_jax.errors import SpecError, UnknownNameError, did_you_mean
from agym_jax.index import Index
from agym_jax.person import anthropometry, body
from agym_jax.person.model import build as build_person
from agym_jax.spec import Arm, Pose, RobotSpec, Task

ITERATIONS, LS_ITERATIONS = 4, 8
"""Newton iterations and line-search steps of the JAX implementation. ``tests/test_parity.py`` compares a
pressing rollout with C MuJoCo; ``python -m benchmarks.nan`` looks for NaN."""
MAX_CONTACTS = 8
"""Contacts that MJX-JAX keeps per world, the deepest first (Warp keeps all)."""
SKIN_SOLREF = (0.04, 1.0)
SKIN_SOLIMP = (0.7, 0.95, 0.01, 0.5, 2.0)
"""Soft skin: the constraint's time constant is two physics steps, the shortest that is stable."""
FRICTION = 0.5  # AG: lateral friction of person, tool and furniture
SELF_CONTACTS = (
    ("upper_arm", "chest"), ("forearm", "chest"), ("forearm", "waist"), ("forearm", "thigh"),
    ("hand", "chest"), ("hand", "thigh"), ("hand", "head"),
)  # fmt: skip
"""Of the person's moving arm with the rest of the body (AG's self-collision mask, the near ones)."""


@dataclass(frozen=True)
class Scene:
    """A compiled scene.

    Attributes:
        model: MuJoCo model of an average man.
        female: the same for an average woman: invweights are interpolated between the two.
        index: where things are.
        arm: of the robot in use.
    """

    model: mujoco.MjModel
    female: mujoco.MjModel
    index: Index
    arm: Arm


@cache
def build_scene(task: Task, robot: RobotSpec) -> Scene:
    """Compile the scene of a task-robot pair; the result is shared, do not write into it."""
    male = compose(task, robot, sex=0.0)
    return Scene(
        male, compose(task, robot, sex=1.0), _index(male, task, robot), robot.arm(task.arm)
    )


def compose(
    task: Task,
    robot: RobotSpec,
    sex: float = 0.0,
    stature: float = 1.0,
    girth: float = 1.0,
    limit_scale: float = 1.0,
    base: Pose | None = None,
    visual: bool = False,
) -> mujoco.MjModel:
    """Compile one person's scene.

    Args:
        task: of the scene.
        robot: of the scene.
        sex: see ``anthropometry.dims``.
        stature: see there.
        girth: see there.
        limit_scale: of the person's impairment.
        base: the robot's, if not the one fixed to the seat.
        visual: with lights, cameras, floor and the geoms that people look at.

    Raises:
        SpecError: robot, tool or seat lacks a name that the scene needs.
    """
    arm = robot.arm(task.arm)
    spec = _load("scene.xml") if visual else mujoco.MjSpec()
    spec.modelname = f"{task.name}{robot.name}"
    _set_options(spec, task)
    base = base or robot.bases.get(task.seat.name) or Pose()
    robot_spec = _load(robot.model)
    _check_names(robot_spec, robot, arm)
    _close_gripper(robot_spec, arm, robot.gripper_opening.get(task.tool.name, 0.0))
    robot_root = robot_spec.worldbody.first_body().name
    _attach(spec, robot_spec, base, "robot/")
    _hold(spec, arm, robot, task)
    for b in spec.bodies:
        if b.name.startswith(("robot/", "tool/")):
            b.gravcomp = 1.0  # AG switches gravity off for robot and tool
    _attach(spec, _load(task.seat.model), Pose(), "seat/")
    if visual and task.seat.name in robot.mounts:
        _attach(spec, _load(robot.mounts[task.seat.name]), Pose(), "mount/")
    d = anthropometry.dims(sex, stature, girth)
    rows = person_rows(task, d, sex, stature, girth, limit_scale, np)
    links = tuple(link.name for link in body.LINKS) if visual else lean_links(task)
    _attach(spec, build_person(rows, task.person.joints, d, links, visual), Pose(), "person/")
    _add_motors(spec, task, arm)
    touches = contact_pairs(task, arm)
    _add_contacts(spec, touches)
    if not visual:
        _make_lean(spec, f"robot/{robot_root}", links)
    return spec.compile()


def person_rows(task, d, sex, stature, girth, limit_scale, xp) -> body.BodyFields:
    """The person's rows of the model, seated for the task; NumPy or JAX."""
    height = anthropometry.sitting_height(d, sex, stature, girth)
    # AG human_creation.py / task resets: chest at (0, 0.03, 0.89 or 0.86)
    root = xp.stack([xp.asarray(0.0 * height), xp.asarray(0.03 + 0.0 * height), xp.asarray(height)])
    return body.fields(d, task.person.pose, task.person.joints, limit_scale, root, xp=xp)


def lean_links(task: Task) -> tuple[str, ...]:
    """Links of the person that the physics model needs: those that move or may be touched."""
    free, limbs = task.person.joints, {"chest", *task.person.limbs}
    return tuple(x.name for x in body.LINKS if body.is_free(x, free) or x.name in limbs)


def _make_lean(spec: mujoco.MjSpec, robot_root: str, links: tuple[str, ...]) -> None:
    """Drop what nobody touches, and fuse static bodies: shallow trees run fastest in MJX.

    The robot's root and the person's links stay bodies, because they are posed per world; an
    ``<exclude>`` that names a body keeps it from being fused.
    """
    touching = {name for pair in spec.pairs for name in (pair.geomname1, pair.geomname2)}
    for geom in list(spec.geoms):
        if geom.name not in touching and not geom.name.startswith("person/"):
            spec.delete(geom)
    spec.compiler.fusestatic = True
    for link in links:
        spec.add_exclude(bodyname1=robot_root, bodyname2=f"person/{link}")


def contact_pairs(task: Task, arm: Arm) -> dict[str, list[tuple[str, str]]]:
    """Geom pairs that may touch, by what their force means; names with prefixes.

    The hand and the tool's working part may touch every limb of ``task.person.limbs``; the other
    links and the handle the moving arm, the links also the thigh that lies beneath it.
    """
    limbs = task.person.limbs
    moving = [x for x in limbs if x.split("_", 1)[-1] in ("upper_arm", "forearm", "hand")]
    near = [*moving, *(x for x in limbs if x.endswith("thigh"))]
    working, *rest = (f"tool/{g}" for g in task.tool.geoms)
    hand, *links = (f"robot/{g}" for g in arm.links)
    seat = [f"seat/{g}" for g in task.seat.geoms]
    outer = [x for x in moving if not x.endswith("upper_arm")]
    side = task.person.arm
    return {
        "tool_person": [(working, f"person/{x}") for x in limbs]
        + [(g, f"person/{x}") for g in rest for x in moving],
        "tool_seat": [(working, g) for g in seat],
        "robot_person": [(hand, f"person/{x}") for x in limbs]
        + [(g, f"person/{x}") for g in links for x in near],
        "person_seat": [(f"person/{x}", g) for x in outer for g in seat],
        "person_self": [
            (f"person/{side}_{a}", f"person/{side}_{b}" if b == "thigh" else f"person/{b}")
            for a, b in SELF_CONTACTS
        ],
    }


def _load(asset: str) -> mujoco.MjSpec:
    return mujoco.MjSpec.from_file(str(Path(asset_path(asset))))


def _attach(spec: mujoco.MjSpec, child: mujoco.MjSpec, pose: Pose, prefix: str) -> None:
    frame = spec.worldbody.add_frame(pos=pose.pos, quat=pose.quat)
    spec.attach(child, frame=frame, prefix=prefix)


def _set_options(spec: mujoco.MjSpec, task: Task) -> None:
    option = spec.option
    option.timestep = task.control.time_step
    option.gravity = (0.0, 0.0, task.gravity)
    option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    option.cone = mujoco.mjtCone.mjCONE_PYRAMIDAL
    option.solver = mujoco.mjtSolver.mjSOL_NEWTON
    option.iterations, option.ls_iterations = ITERATIONS, LS_ITERATIONS
    option.disableflags |= mujoco.mjtDisableBit.mjDSBL_EULERDAMP
    spec.add_numeric(name="max_contact_points", size=1, data=[MAX_CONTACTS])


def _check_names(spec: mujoco.MjSpec, robot: RobotSpec, arm: Arm) -> None:
    wanted = {
        "joint": (*arm.joints, *arm.gripper),
        "site": (arm.end_effector, arm.tool_frame, robot.torso),
        "geom": arm.links,
    }
    existing = {
        "joint": [j.name for j in spec.joints],
        "site": [s.name for s in spec.sites],
        "geom": [g.name for g in spec.geoms],
    }
    for kind, names in wanted.items():
        for name in names:
            if name not in existing[kind]:
                raise SpecError(
                    f"{robot.name}'s file {robot.model} has no {kind} {name!r}. "
                    + did_you_mean(name, [n for n in existing[kind] if n])
                )


def _close_gripper(spec: mujoco.MjSpec, arm: Arm, opening: float) -> None:
    """Weld the fingers at an opening [rad or m along the joint's axis]."""
    for name in arm.gripper:
        joint = spec.joint(name)
        finger = joint.parent
        if joint.type == mujoco.mjtJoint.mjJNT_HINGE:
            turn, quat = np.zeros(4), np.zeros(4)
            mujoco.mju_axisAngle2Quat(turn, np.asarray(joint.axis, float), opening)
            mujoco.mju_mulQuat(quat, np.asarray(finger.quat, float), turn)
            finger.quat = quat
        else:
            shift = np.zeros(3)
            mujoco.mju_rotVecQuat(
                shift, np.asarray(joint.axis, float), np.asarray(finger.quat, float)
            )
            finger.pos = np.asarray(finger.pos) + opening * shift
        spec.delete(joint)


def _hold(spec: mujoco.MjSpec, arm: Arm, robot: RobotSpec, task: Task) -> None:
    """Attach the tool rigidly to the hand."""
    grasp = robot.grasps.get(task.tool.name, task.tool.grasp)
    site = spec.site(f"robot/{arm.tool_frame}")
    pos, quat = np.zeros(3), np.zeros(4)
    mujoco.mju_mulPose(
        pos, quat, np.asarray(site.pos, float), np.asarray(site.quat, float),
        np.asarray(grasp.pos, float), np.asarray(grasp.quat, float),
    )  # fmt: skip
    frame = site.parent.add_frame(pos=pos, quat=quat)
    spec.attach(_load(task.tool.model), frame=frame, prefix="tool/")


def _add_motors(spec: mujoco.MjSpec, task: Task, arm: Arm) -> None:
    c = task.control
    for name in arm.joints:
        motor = spec.add_actuator(
            name=name, target=f"robot/{name}", trntype=mujoco.mjtTrn.mjTRN_JOINT
        )
        motor.set_to_position(kp=c.stiffness, kv=c.damping)


def _add_contacts(spec: mujoco.MjSpec, touches: dict[str, list[tuple[str, str]]]) -> None:
    bits = (1 << int(mujoco.mjtConDataField.mjCONDATA_FORCE)) | (
        1 << int(mujoco.mjtConDataField.mjCONDATA_POS)
    )
    for kind, pairs in touches.items():
        for a, b in pairs:
            spec.add_pair(
                name=f"{a}|{b}", geomname1=a, geomname2=b, condim=3,
                friction=[FRICTION, FRICTION, 0.005, 0.0001, 0.0001],
                solref=SKIN_SOLREF, solimp=SKIN_SOLIMP,
            )  # fmt: skip
            if kind in ("tool_person", "tool_seat", "robot_person"):
                spec.add_sensor(
                    name=f"{kind}|{a}|{b}", type=mujoco.mjtSensor.mjSENS_CONTACT,
                    objtype=mujoco.mjtObj.mjOBJ_GEOM, objname=a,
                    reftype=mujoco.mjtObj.mjOBJ_GEOM, refname=b,
                    intprm=[bits, 2, 1],  # force and position of the contact of largest force
                )  # fmt: skip


def _index(model: mujoco.MjModel, task: Task, robot: RobotSpec) -> Index:
    def ids(kind: mujoco.mjtObj, names) -> np.ndarray:
        found = [mujoco.mj_name2id(model, kind, n) for n in names]
        for name, i in zip(names, found, strict=True):
            if i < 0:
                raise UnknownNameError(
                    kind.name.removeprefix("mjOBJ_").lower(), name, _all(model, kind)
                )
        return np.array(found, np.int32)

    o = mujoco.mjtObj
    arm = robot.arm(task.arm)
    robot_joint = ids(o.mjOBJ_JOINT, [f"robot/{n}" for n in arm.joints])
    person_joint = ids(o.mjOBJ_JOINT, [f"person/{n}" for n in task.person.joints])
    lean = lean_links(task)
    links = [f"person/{name}" for name in lean]
    limb = [f"person/{task.person.arm}_{x}" for x in ("upper_arm", "forearm", "hand")]
    upper, fore, hand = ids(o.mjOBJ_BODY, limb)
    tip = ids(o.mjOBJ_SITE, [f"tool/{task.tool.tip}"])[0]
    adr = {
        kind: model.sensor_adr[ids(o.mjOBJ_SENSOR, [f"{kind}|{a}|{b}" for a, b in pairs])]
        for kind, pairs in contact_pairs(task, arm).items()
        if kind in ("tool_person", "tool_seat", "robot_person")
    }
    base = model.site_bodyid[ids(o.mjOBJ_SITE, [f"robot/{robot.torso}"])[0]]
    return Index(
        robot_joint=robot_joint,
        robot_qpos=model.jnt_qposadr[robot_joint],
        robot_dof=model.jnt_dofadr[robot_joint],
        robot_ctrl=ids(o.mjOBJ_ACTUATOR, arm.joints),
        robot_base=int(model.body_rootid[base]),
        person_joint=person_joint,
        person_qpos=model.jnt_qposadr[person_joint],
        person_dof=model.jnt_dofadr[person_joint],
        person_row=np.array([i for i, x in enumerate(body.LINKS) if x.name in lean], np.int32),
        person_body=ids(o.mjOBJ_BODY, links),
        person_geom=ids(o.mjOBJ_GEOM, links),
        tool_body=int(model.site_bodyid[tip]),
        tool_quat=model.site_quat[tip].astype(np.float32),
        tip_site=int(tip),
        torso_site=int(ids(o.mjOBJ_SITE, [f"robot/{robot.torso}"])[0]),
        chest_body=int(ids(o.mjOBJ_BODY, ["person/chest"])[0]),
        upper_arm_body=int(upper),
        forearm_body=int(fore),
        hand_body=int(hand),
        tool_person=adr["tool_person"],
        tool_seat=adr["tool_seat"],
        robot_person=adr["robot_person"],
    )


def _all(model: mujoco.MjModel, kind: mujoco.mjtObj) -> list[str]:
    count = {
        mujoco.mjtObj.mjOBJ_JOINT: model.njnt, mujoco.mjtObj.mjOBJ_BODY: model.nbody,
        mujoco.mjtObj.mjOBJ_SITE: model.nsite, mujoco.mjtObj.mjOBJ_GEOM: model.ngeom,
        mujoco.mjtObj.mjOBJ_SENSOR: model.nsensor, mujoco.mjtObj.mjOBJ_ACTUATOR: model.nu,
    }[kind]  # fmt: skip
    return [mujoco.mj_id2name(model, kind, i) or "" for i in range(count)]
