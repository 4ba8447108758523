"""Banks of postures of people who have settled on the bed, as ``human/posture.py`` reads them.

    agym-jax postures build BedBathing --recorded benchmarks/parity/traces/settled_BedBathing.npz
    agym-jax postures build ArmManipulation --recorded benchmarks/parity/traces/settled_ArmManipulation.npz
    agym-jax postures report        # how they compare with Assistive Gym's
    agym-jax placements meet BedBathingJaco-v0 ...      # after a build, for every robot: whom it would begin inside of

As Assistive Gym does at every reset (bed_bathing.py, arm_manipulation.py; reference tasks.md
sections 3 and 7), a person without muscle torques falls onto the bed for 2 s at -1 m/s^2, face up, with joint
angles U(-0.1, 0.1) rad within the person's own limits; in ArmManipulation the right arm, then the only part
that moves, is placed over the bed's edge and falls again for 2 s. People of its own sizes lie as they came to rest in
Assistive Gym itself, recorded there (``--recorded``). Everybody else falls here, offline, in C MuJoCo, with AG's masses,
drag and friction: every centre of mass at its joint, no damping of joints, rolling and spinning friction of the bed.

A bank has six equal parts, in this order: Assistive Gym's man with full joint limits, the same man with
limits scaled by U(0.5, 1), its woman with full and with scaled limits, and people of random size with full
and with scaled limits. Every part with scaled limits spans 0.5 to 1 evenly, in ascending order.

DEVIATION(settle): an episode begins in the posture after AG's 2 s but at rest; AG starts with the velocities that
remain, in ArmManipulation at most 0.3 rad/s in girdle, shoulder and elbow for three of four people, 2.7 at most. People whose right arm AG
leaves inside the mattress, through whose triangles hands slip, are left out: 11 % of women and 26 % of those with scaled limits in BedBathing,
16 to 35 mm deep; nobody else. People of other sizes fall in MuJoCo, with contacts of
60 ms, as stiff ones let arms bounce away from the body; tried with AG's sizes, this leaves chest, head, elbow and wrist as high as AG's
within 1 cm on average, but for a man's hand (1.2 cm lower on the bed; 2.7 cm higher where it hangs) and a woman's hanging elbow (1.3 cm
lower), and hands spread less, across the bed (5 cm instead of 9) and along it where the arm hangs (4 cm instead of 7).
DEVIATION(posture-bank): a reset samples a settled person of similar size, with the same or slightly narrower
limits. AG's sizes lie as in AG, whose mattress differs by some millimetres under the body: trunk, legs and left arm, which do not
move, are up to 37 mm inside ours (a left hand; legs 15 mm), or 5 mm above it. Others begin up to 16 mm inside the bed, arms up to 12 mm above it.
"""

from __future__ import annotations

import argparse
import sys
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from importlib.metadata import version
from pathlib import Path

import mujoco
import numpy as np

from agym_jax.data.assets import asset_path
from agym_jax.data.npz import read_arrays
from agym_jax.errors import AgymError, MissingPostureError, UnknownNameError, checked_count
from agym_jax.human import body
from agym_jax.human.model import build as build_human
from agym_jax.human.muscles import DRAG
from agym_jax.human.population import Population
from agym_jax.human.posture import (
    SHAPES,
    Postures,
    bank_of,
    load_postures,
    save_postures,
)
from agym_jax.offline.posture_report import compare

LINKS, ALL, ARM = tuple(body.LINK), tuple(body.JOINTS), body.RIGHT_ARM
ARM_LINKS = ("right_girdle", "right_upper_arm", "right_forearm", "right_hand")
FACE_UP = (0.5**0.5, -(0.5**0.5), 0.0, 0.0)  # wxyz of AG's Euler (-pi/2, 0, 0): head towards +y
SPREAD = 0.1  # joint angles at the start, U(-0.1, 0.1) rad
FALL, STEP = 2.0, 0.004  # AG: 100 steps of 0.02 s; finer steps make the same time stable [s]
GRAVITY = -1.0  # [m/s^2]
DRAG_STEP = 0.02  # how often Bullet's drag acts [s]
FALL_SOLREF, FALL_SOLIMP = (0.06, 1.0), (0.8, 0.95, 0.005, 0.5, 2.0)  # of contacts: no bouncing
ARM_SOLREF, ARM_STEP = (0.04, 1.0), 0.01  # while only the arm moves; the skin's at run time
SELF_FRICTION = 0.25  # AG: the product of 0.5 and 0.5
SKULL_BACK = 0.067  # of AG's head mesh, from the head's joint; the capsule is flatter [m]
MAX_PENETRATION, MAX_GAP = 0.006, 0.002  # of the person and the bed, in a row [m]
MAX_SHIFT = 0.1  # a chest that has moved across the bed by more has fallen off [m]
MOST_DISTINCT = 0.9  # of a part's recorded rows, at least; the others occur twice
MAX_TRIES = 6  # falls per row, on average, before the search for a bank is ended


@dataclass(frozen=True)
class Scenario:
    """How the person of a task lies.

    Attributes:
        start: position of the chest before the fall, world [m].
        arm: angles [rad] from which the right arm falls again; none if it stays where it is.
        friction: of person and bed while the body falls, and while the arm does: in AG the bed's 5, then 0.3 in
            ArmManipulation, times the person's 0.5. Rolling and spinning friction are as large, in metres.
    """

    start: tuple[float, float, float]
    arm: dict[str, float]
    friction: tuple[float, float]


SCENARIOS = {
    "BedBathing": Scenario((-0.15, 0.2, 0.95), {}, (2.5, 2.5)),
    "ArmManipulation": Scenario(
        (-0.25, 0.2, 0.95),
        {"r_shoulder_y": np.deg2rad(60), "r_shoulder_x": np.deg2rad(-60), "r_elbow_x": 0.0},
        (2.5, 0.15),
    ),
}


def _limb(link: str) -> tuple[str, str]:
    """Kind of limb ("arm", "leg" or "torso") and side of a link."""
    side, _, part = link.partition("_")
    kinds = {"upper_arm": "arm", "forearm": "arm", "hand": "arm"}
    kinds |= {"thigh": "leg", "shin": "leg", "foot": "leg"}
    return kinds.get(part, "torso"), side


def may_collide(a: str, b: str) -> bool:
    """Whether two links may collide: AG's self-collision mask (reference humans.md section 3)."""
    (kind_a, side_a), (kind_b, side_b) = _limb(a), _limb(b)
    if kind_a == "torso":
        (a, kind_a, side_a), (b, kind_b, side_b) = (b, kind_b, side_b), (a, kind_a, side_a)
    if kind_a == "torso" or (kind_a, side_a) == (kind_b, side_b):
        return False
    if kind_b == "torso":
        return b not in ("waist", "hips") if kind_a == "leg" else b != f"{side_a}_girdle"
    return True


def lying_model(
    human: Postures, free: tuple[str, ...], friction: float, falling: bool = False
) -> mujoco.MjModel:
    """Model of one person on the bed.

    Args:
        human: one row; the joints that are not free have its angles.
        free: joints that move.
        friction: of person and bed.
        falling: whether the chest is free.
    """
    spec = mujoco.MjSpec()
    spec.option.timestep = STEP if falling else ARM_STEP
    spec.option.gravity = (0.0, 0.0, GRAVITY)
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    if falling:  # the arm alone slides and rolls under the cone that it has at run time
        spec.option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    carrier = spec.worldbody.add_body(name="root", pos=human.root_pos, quat=human.root_quat)
    if falling:
        carrier.add_freejoint()
    angles, d = dict(zip(ALL, human.angles, strict=True)), human.dims
    rows = body.fields(d, angles, free, human.limit_scale, np.zeros(3), np.eye(4)[0], np, 1.0)
    spec.attach(
        build_human(rows, free, d, LINKS, False), frame=carrier.add_frame(), prefix="human/"
    )
    bed = mujoco.MjSpec.from_file(str(asset_path("furniture/bed.xml")))
    on_bed = [g.name for g in bed.geoms if g.name.endswith("_collision")]
    spec.attach(bed, frame=spec.worldbody.add_frame(), prefix="bed/")
    moving = LINKS if falling else ARM_LINKS if free else ()
    pairs = [(x, f"bed/{g}", friction, 6) for x in moving for g in on_bed]
    pairs += [
        (a, f"human/{b}", SELF_FRICTION, 3)
        for i, a in enumerate(LINKS)
        for b in LINKS[i + 1 :]
        if may_collide(a, b) and (a in moving or b in moving)
    ]
    for a, b, mu, condim in pairs:
        spec.add_pair(
            geomname1=f"human/{a}", geomname2=b, condim=condim,
            friction=[mu] * 5 if condim == 6 else [mu, mu, 0.005, 1e-4, 1e-4],
            solref=FALL_SOLREF if falling else ARM_SOLREF, solimp=FALL_SOLIMP,
        )  # fmt: skip
    model = spec.compile()
    model.dof_damping[:] = 0.0
    model.dof_armature[:] = 0.0
    if falling:
        head = model.geom("human/head").id
        model.geom_pos[head, 1] = SKULL_BACK - model.geom_size[head, 0]
    return model


def _qpos(model: mujoco.MjModel, joints: tuple[str, ...]) -> np.ndarray:
    return np.array([model.joint(f"human/{n}").qposadr[0] for n in joints])


def _clipped(angles: np.ndarray, joints: tuple[str, ...], limit_scale: float) -> np.ndarray:
    return np.clip(angles, *body.joint_limits(joints, limit_scale, np).T)


def _settle(model: mujoco.MjModel, data: mujoco.MjData) -> None:
    """Let everything fall for AG's 2 s, under Bullet's drag."""
    for _ in range(round(FALL / DRAG_STEP)):
        mujoco.mj_step(model, data, round(DRAG_STEP / model.opt.timestep))
        data.qvel *= 1.0 - DRAG_STEP * DRAG * (1.0 + np.abs(data.qvel))


def fall(human: Postures, how: Scenario, rng: np.random.Generator) -> Postures:
    """Drop a person without muscle torques onto the bed; returns the person in the pose after the fall."""
    angles = _clipped(rng.uniform(-SPREAD, SPREAD, len(ALL)), ALL, human.limit_scale)
    human = replace(human, root_pos=np.array(how.start), root_quat=np.array(FACE_UP))
    model = lying_model(human, ALL, how.friction[0], True)
    data, where = mujoco.MjData(model), _qpos(model, ALL)
    data.qpos[where] = angles
    _settle(model, data)
    quat = data.qpos[3:7] / np.linalg.norm(data.qpos[3:7])
    angles = _clipped(data.qpos[where], ALL, human.limit_scale)
    return replace(human, root_pos=data.qpos[:3].copy(), root_quat=quat, angles=angles)


def drop_arm(human: Postures, how: Scenario) -> Postures:
    """Let a person's right arm fall over the edge of the bed while the body is fixed."""
    angles = dict(zip(ALL, human.angles, strict=True)) | how.arm
    model = lying_model(human, ARM, how.friction[1])
    data, where = mujoco.MjData(model), _qpos(model, ARM)
    data.qpos[where] = _clipped(np.array([angles[j] for j in ARM]), ARM, human.limit_scale)
    _settle(model, data)
    angles |= zip(ARM, _clipped(data.qpos[where], ARM, human.limit_scale), strict=True)
    return replace(human, angles=np.array([angles[j] for j in ALL]))


def clearances(human: Postures) -> dict[str, float]:
    """Distances of a person's links from the bed [m], negative inside it."""
    model = lying_model(human, (), 1.0)
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    names = [model.geom(i).name for i in range(model.ngeom)]
    bed = [i for i, n in enumerate(names) if n.startswith("bed/") and n.endswith("_collision")]
    return {
        x: min(mujoco.mj_geomDistance(model, data, model.geom(f"human/{x}").id, g, 0.5, None) for g in bed)
        for x in LINKS
    }  # fmt: skip


def settle(
    name: str, who: tuple[float, float, float, float], rng: np.random.Generator
) -> Postures | str:
    """One row of a bank, or the reason why the fall was rejected.

    Args:
        name: of the task.
        who: sex, stature, girth and limit_scale.
        rng: of the initial angles.
    """
    how = SCENARIOS[name]
    human = fall(Postures(*who, np.zeros(3), np.zeros(4), np.zeros(len(ALL))), how, rng)
    if np.abs(human.root_pos[:2] - how.start[:2]).max() > MAX_SHIFT:
        return "fell off the bed"
    if how.arm:
        human = drop_arm(human, how)
    gap = clearances(human)
    if min(gap.values()) < -MAX_PENETRATION:
        return "penetrates the bed"
    floats = min(gap["chest"], gap["waist"], gap["hips"]) > MAX_GAP
    return "floats" if floats else human


def read_recorded(path: Path) -> Postures:
    """People whom AG settled, in four parts of any length, ordered like a bank's first; float32.

    Raises:
        MissingPostureError: there is no such file, or it is damaged.
    """
    arrays = read_arrays(
        path, "recording of settled people", SHAPES, MissingPostureError,
        "Take the one that comes with the sources, or build without --recorded.",
    )  # fmt: skip
    return Postures(**{f.name: arrays[f.name] for f in fields(Postures)})


def recorded_rows(recorded: Postures, each: int) -> tuple[list[Postures], int]:
    """The rows of a bank's first four parts, from people whom AG settled.

    Args:
        recorded: of ``read_recorded``.
        each: rows of each part.

    Returns:
        the rows, and how many people were left out because their right arm lies inside the bed.

    Raises:
        AgymError: too few are fit.
    """
    rows: list[Postures] = []
    unfit = 0
    for part in range(4):
        plain = recorded.limit_scale == 1
        mine = np.flatnonzero((recorded.sex == part // 2) & (plain if part % 2 == 0 else ~plain))
        people = [recorded.row(int(i)) for i in mine]
        fit = [x for x in people if arm_clearance(x) >= -MAX_PENETRATION]
        unfit += len(people) - len(fit)
        if len(fit) < MOST_DISTINCT * each:
            wanted = f"for part {part + 1} of a bank, not {each}"
            raise AgymError(f"the recording has {len(fit)} people {wanted}")
        fit.sort(key=lambda x: float(x.limit_scale))  # as evenly as they can be had
        rows += [fit[i] for i in np.linspace(0, len(fit) - 1, each).round().astype(int)]
    return rows, unfit


def arm_clearance(human: Postures) -> float:
    """Distance of the arm that moves from the bed [m], negative inside it."""
    gap = clearances(human)
    return min(gap[x] for x in ARM_LINKS)


def build_bank(
    name: str, seed: int = 0, each: int = 128, recorded: Postures | None = None
) -> tuple[Postures, Counter]:
    """Settle people until a bank is complete.

    Args:
        name: of the task.
        seed: of sizes, limits and joint angles.
        each: rows of each of the six parts.
        recorded: people of AG's sizes whom AG settled, for the first four parts.

    Returns:
        the bank, and how often each reason for a rejection occurred; "kept" counts the rows.

    Raises:
        AgymError: too few falls are accepted.
    """
    rng, humans, counts = np.random.default_rng(seed), Population(sizes="continuous"), Counter()
    ranges = humans.blend, humans.stature, humans.girth
    rows: list[Postures] = []
    if recorded is not None:
        rows, counts["recorded arm in the bed"] = recorded_rows(recorded, each)
        counts["kept"] = len(rows)
    while len(rows) < 6 * each:
        part, i = divmod(len(rows), each)
        sex, stature, girth = float(part // 2), 1.0, 1.0
        if part >= 4:
            sex, stature, girth = (rng.uniform(*x) for x in ranges)
        limit_scale = 0.5 + 0.5 * (i + rng.uniform()) / each if part % 2 else 1.0
        row = settle(name, (sex, stature, girth, limit_scale), rng)
        counts["kept" if isinstance(row, Postures) else row] += 1
        rows += [row] if isinstance(row, Postures) else []
        print(f"\r{name}: {len(rows)}/{6 * each}", end="", flush=True)
        if counts.total() > MAX_TRIES * 6 * each:
            raise AgymError(f"{name}: too few falls onto the bed are accepted: {dict(counts)}")
    print()
    return bank_of(rows), counts


def _build(name: str, seed: int, each: int, recorded: Path | None) -> None:
    """Build the bank of one task."""
    bank, counts = build_bank(name, seed, each, read_recorded(recorded) if recorded else None)
    source = f" --recorded {recorded}" if recorded else ""
    provenance = {
        "command": f"agym-jax postures build {name} --seed {seed} --each {each}{source}",
        "seed": seed, "counts": dict(counts),
        "versions": {p: version(p) for p in ("mujoco", "numpy")},
    }  # fmt: skip
    save_postures(bank, name, provenance)
    print(f"{name}: {dict(counts)}")


def main(argv: Sequence[str] | None = None, prog: str = "agym-jax postures") -> int:
    """The command line; returns the exit status."""
    parser = argparse.ArgumentParser(
        prog=prog, description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    commands = parser.add_subparsers(required=True, dest="command")
    build = commands.add_parser("build", help="build banks of postures")
    build.add_argument("--seed", type=int, default=0)
    build.add_argument("--each", type=int, default=128, help="rows of each of the six parts")
    build.add_argument(
        "--recorded", type=Path, help="people whom Assistive Gym settled, for the rows of its sizes"
    )
    report = commands.add_parser("report", help="compare banks with Assistive Gym's people")
    for command in (build, report):
        command.add_argument("tasks", nargs="*", default=list(SCENARIOS), metavar="TASK")
    args = parser.parse_args(argv)
    try:
        if args.command == "build":
            checked_count("--each", args.each)
            checked_count("--seed", args.seed, at_least=0)
        for name in args.tasks:  # the last of them too, before the first is built
            if name not in SCENARIOS:
                raise UnknownNameError("task on the bed", name, SCENARIOS)
        for name in args.tasks:
            if args.command == "report":
                compare(load_postures(name), name)
            else:
                _build(name, args.seed, args.each, args.recorded)
    except AgymError as error:
        print(error, file=sys.stderr)
        return 1
    return 0
