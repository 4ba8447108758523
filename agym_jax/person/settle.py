"""People who lie on the bed as gravity lets them: writes the banks that ``posture.py`` reads.

    python -m agym_jax.person.settle build [BedBathing ArmManipulation] [--seed 0] [--size 512]

As Assistive Gym does at every reset (bed_bathing.py, arm_manipulation.py; reference tasks.md
sections 3 and 7), a limp person falls onto the bed for 2 s at -1 m/s^2, face up, with joint angles
U(-0.1, 0.1) rad; in ArmManipulation the right arm, then the only part that moves, is laid over the
bed's edge and falls again. Here that is done once, offline, with C MuJoCo. Three eighths of a bank's
rows are Assistive Gym's man, then as many rows its woman, and the rest are people of any size.

DEVIATION(settle): after AG's 2 s the body is frozen and the right arm goes on settling until it is
still, and in ArmManipulation then once more under -9.81 m/s^2, at which that task runs. AG starts with
whatever motion 2 s have left. In BedBathing falls whose arm slides off the bed are left out.
Contacts are firmer than at run time, so a hanging arm sinks up to 4 mm deeper into the mattress there.
DEVIATION(posture-bank): a reset draws one of the settled people instead of dropping one. They settle with
full joint limits; AG narrows the limits of an impaired person before the fall.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections import Counter
from dataclasses import dataclass, fields
from importlib.metadata import version

import mujoco
import numpy as np

from agym_jax.assets import asset_path
from agym_jax.errors import AgymError, UnknownNameError
from agym_jax.person import anthropometry, body
from agym_jax.person.draw import People
from agym_jax.person.model import build as build_person
from agym_jax.person.posture import Postures, posture_path

LINKS, ALL, ARM = tuple(body.LINK), tuple(body.JOINTS), body.RIGHT_ARM
ARM_LINKS = ("right_girdle", "right_upper_arm", "right_forearm", "right_hand")
FACE_UP = (0.5**0.5, -(0.5**0.5), 0.0, 0.0)  # wxyz of AG's Euler (-pi/2, 0, 0): head towards +y
SPREAD = 0.1  # joint angles at the start, U(-0.1, 0.1) rad
FALL, STEP = 2.0, 0.004  # AG: 100 steps of 0.02 s; finer steps make the same time stable [s]
FIRST_GRAVITY = -1.0  # [m/s^2]
FALL_SOLREF, FALL_SOLIMP = (0.03, 1.0), (0.8, 0.95, 0.005, 0.5, 2.0)  # of contacts: no bouncing
REST_SOLREF, REST_SOLIMP = (0.016, 1.0), (0.9, 0.95, 0.001, 0.5, 2.0)  # firm: sinks in by < 1 mm
SELF_FRICTION = 0.5
STICTION = 20.0  # MuJoCo's impratio: soft friction would let a resting arm creep
FALL_DAMPING, REST_DAMPING = 1.0, 0.05  # of the joints [N m s/rad] (AG: none)
STILL, PATIENCE = 0.01, 60.0  # the arm is at rest below this speed [rad/s]; wait at most [s]
DEEPEST, FLOATING = 0.002, 0.002  # worst penetration and gap that a row may have [m]
STRAYED = 0.1  # a chest that has moved by more across the bed has fallen off [m]
OVERHANG = -0.65  # a wrist beyond this x has slid off the bed, 15 cm past the edge [m]
TRIES = 6  # falls per row, on average, before a bank is given up


@dataclass(frozen=True)
class Scenario:
    """How a task has the person lie.

    Attributes:
        start: of the chest before the fall, world [m].
        arm: angles [rad] at which the right arm falls again; none if it stays where it is.
        gravity: under which the arm comes to rest, one after the other [m/s^2].
        friction: with the bed while the body falls, and while the arm comes to rest; in AG the bed's
            5, then 0.3 in ArmManipulation, times the person's 0.5.
    """

    start: tuple[float, float, float]
    arm: dict[str, float]
    gravity: tuple[float, ...]
    friction: tuple[float, float]


SCENARIOS = {
    "BedBathing": Scenario((-0.15, 0.2, 0.95), {}, (-1.0,), (2.5, 2.5)),
    "ArmManipulation": Scenario(
        (-0.25, 0.2, 0.95),
        {"r_shoulder_y": np.deg2rad(60), "r_shoulder_x": np.deg2rad(-60), "r_elbow_x": 0.0},
        (-1.0, -9.81),
        (2.5, 0.15),
    ),
}


AG = {
    "BedBathing": {
        "chest": ((-0.150, 0.200, 0.875), (-0.151, 0.201, 0.868)),
        "right_upper_arm": ((-0.328, 0.341, 0.862), (-0.309, 0.336, 0.835)),
        "right_forearm": ((-0.413, 0.091, 0.782), (-0.359, 0.084, 0.775)),
        "right_hand": ((-0.506, -0.178, 0.752), (-0.414, -0.170, 0.777)),
        "head": ((-0.150, 0.486, 0.885), (-0.150, 0.451, 0.877)),
        "waist": ((-0.150, 0.044, 0.885), (-0.151, 0.051, 0.875)),
        "hips": ((-0.150, -0.037, 0.891), (-0.151, -0.023, 0.879)),
        "right_shin": ((-0.245, -0.538, 0.837), (-0.231, -0.486, 0.835)),
        "r_shoulder_y": (19, 12), "r_shoulder_x": (20, 22), "r_shoulder_z": (1, 5),
        "r_elbow_x": (-11, -14), "r_forearm_roll_z": (-12, 4), "r_wrist_x": (-1, -10),
        "r_wrist_y": (-6, -8),
    },
    "ArmManipulation": {
        "chest": ((-0.249, 0.200, 0.881), (-0.249, 0.199, 0.871)),
        "right_upper_arm": ((-0.428, 0.340, 0.862), (-0.407, 0.329, 0.835)),
        "right_forearm": ((-0.621, 0.286, 0.670), (-0.619, 0.294, 0.683)),
        "right_hand": ((-0.818, 0.234, 0.466), (-0.827, 0.258, 0.530)),
        "head": ((-0.250, 0.484, 0.910), (-0.249, 0.447, 0.895)),
        "waist": ((-0.249, 0.044, 0.885), (-0.248, 0.049, 0.877)),
        "hips": ((-0.248, -0.037, 0.887), (-0.248, -0.026, 0.880)),
        "right_shin": ((-0.349, -0.537, 0.835), (-0.327, -0.489, 0.830)),
        "r_shoulder_y": (83, 88), "r_shoulder_x": (38, 38), "r_shoulder_z": (-1, 13),
        "r_elbow_x": (1, 0), "r_forearm_roll_z": (-17, -14), "r_wrist_x": (-23, -12),
        "r_wrist_y": (-7, 0),
    },
}  # fmt: skip
"""AG's settled men and women: mean link positions [m] and angles [deg], humans.md section 5."""


def _limb(link: str) -> tuple[str, str]:
    """Kind of limb ("arm", "leg" or "torso") and side of a link."""
    side, _, part = link.partition("_")
    kinds = {"upper_arm": "arm", "forearm": "arm", "hand": "arm"}
    kinds |= {"thigh": "leg", "shin": "leg", "foot": "leg"}
    return kinds.get(part, "torso"), side


def may_touch(a: str, b: str) -> bool:
    """AG's self-collision mask (reference humans.md section 3) for two links."""
    (kind_a, side_a), (kind_b, side_b) = _limb(a), _limb(b)
    if kind_a == "torso":
        (a, kind_a, side_a), (b, kind_b, side_b) = (b, kind_b, side_b), (a, kind_a, side_a)
    if kind_a == "torso" or (kind_a, side_a) == (kind_b, side_b):
        return False
    if kind_b == "torso":
        return b not in ("waist", "hips") if kind_a == "leg" else b != f"{side_a}_girdle"
    return True


def lying_model(
    d: anthropometry.Dims,
    free: tuple[str, ...],
    angles: dict[str, float],
    root: np.ndarray,
    quat: np.ndarray,
    friction: float,
    falling: bool = False,
) -> mujoco.MjModel:
    """A person on the bed.

    Args:
        d: sizes.
        free: joints that move.
        angles: of the others [rad].
        root: position of the chest, world [m] (3,).
        quat: orientation of the chest, world (4,) wxyz.
        friction: of the bed.
        falling: the chest is free.
    """
    spec = mujoco.MjSpec()
    spec.option.timestep = STEP
    spec.option.gravity = (0.0, 0.0, FIRST_GRAVITY)
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    spec.option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    spec.option.impratio = 1.0 if falling else STICTION
    carrier = spec.worldbody.add_body(name="root", pos=root, quat=quat)
    if falling:
        carrier.add_freejoint()
    rows = body.fields(d, angles, free, 1.0, np.zeros(3), np.array([1.0, 0, 0, 0]), xp=np)
    person = build_person(rows, free, d, LINKS, False)
    spec.attach(person, frame=carrier.add_frame(), prefix="person/")
    bed = mujoco.MjSpec.from_file(str(asset_path("furniture/bed.xml")))
    on_bed = [g.name for g in bed.geoms if g.name.endswith("_collision")]
    spec.attach(bed, frame=spec.worldbody.add_frame(), prefix="bed/")
    moving = LINKS if falling else ARM_LINKS if free else ()
    pairs = [(x, f"bed/{g}", friction) for x in moving for g in on_bed]
    pairs += [
        (a, f"person/{b}", SELF_FRICTION)
        for i, a in enumerate(LINKS)
        for b in LINKS[i + 1 :]
        if may_touch(a, b) and (a in moving or b in moving)
    ]
    for a, b, mu in pairs:
        spec.add_pair(
            geomname1=f"person/{a}", geomname2=b, condim=3, friction=[mu, mu, 0.005, 1e-4, 1e-4],
            solref=FALL_SOLREF if falling else REST_SOLREF,
            solimp=FALL_SOLIMP if falling else REST_SOLIMP,
        )  # fmt: skip
    model = spec.compile()
    model.dof_damping[6 if falling else 0 :] = FALL_DAMPING if falling else REST_DAMPING
    return model


def _qpos(model: mujoco.MjModel, joints: tuple[str, ...]) -> np.ndarray:
    return np.array([model.joint(f"person/{n}").qposadr[0] for n in joints])


def _clipped(angles: np.ndarray, joints: tuple[str, ...]) -> np.ndarray:
    return np.clip(angles, *body.joint_limits(joints, 1.0, np).T)


def fall(d: anthropometry.Dims, how: Scenario, rng: np.random.Generator):
    """Drop a limp person onto the bed.

    Returns:
        position (3,) [m] and orientation (4,) wxyz of the chest, angles of all joints (41,) [rad].
    """
    model = lying_model(d, ALL, {}, np.array(how.start), np.array(FACE_UP), how.friction[0], True)
    data, where = mujoco.MjData(model), _qpos(model, ALL)
    data.qpos[where] = _clipped(rng.uniform(-SPREAD, SPREAD, len(ALL)), ALL)
    mujoco.mj_step(model, data, round(FALL / STEP))
    quat = data.qpos[3:7] / np.linalg.norm(data.qpos[3:7])
    return data.qpos[:3].copy(), quat, _clipped(data.qpos[where], ALL)


def rest_arm(
    d: anthropometry.Dims, how: Scenario, pos: np.ndarray, quat: np.ndarray, angles: np.ndarray
) -> tuple[np.ndarray, float]:
    """Let the right arm come to rest while the body stays as it is.

    Args:
        d: sizes.
        how: gravity and friction.
        pos: of the chest [m] (3,).
        quat: of the chest (4,) wxyz.
        angles: of all joints [rad] (41,).

    Returns:
        angles of all joints (41,) [rad], and the arm's greatest joint speed at the end [rad/s].
    """
    everything = dict(zip(ALL, angles, strict=True)) | how.arm
    model = lying_model(d, ARM, everything, pos, quat, how.friction[1])
    data, where = mujoco.MjData(model), _qpos(model, ARM)
    data.qpos[where] = [everything[j] for j in ARM]
    for gravity in how.gravity:
        model.opt.gravity[2] = gravity
        for i in range(round(PATIENCE / STEP)):
            mujoco.mj_step(model, data)
            if (i + 1) * STEP >= FALL and i % 25 == 0 and np.abs(data.qvel).max() < STILL:
                break
    result = angles.copy()
    result[[ALL.index(j) for j in ARM]] = _clipped(data.qpos[where], ARM)
    return result, float(np.abs(data.qvel).max())


def clearances(
    d: anthropometry.Dims, pos: np.ndarray, quat: np.ndarray, angles: np.ndarray
) -> dict[str, float]:
    """Distance of every link from the bed [m], negative inside it."""
    model = lying_model(d, (), dict(zip(ALL, angles, strict=True)), pos, quat, 1.0)
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    names = [model.geom(i).name for i in range(model.ngeom)]
    bed = [i for i, n in enumerate(names) if n.startswith("bed/") and n.endswith("_collision")]
    return {
        x: min(mujoco.mj_geomDistance(model, data, model.geom(f"person/{x}").id, g, 0.5, None) for g in bed)
        for x in LINKS
    }  # fmt: skip


def link_positions(
    d: anthropometry.Dims, pos: np.ndarray, quat: np.ndarray, angles: np.ndarray
) -> dict[str, np.ndarray]:
    """Where every link is, world [m] (3,)."""
    posed = dict(zip(ALL, angles, strict=True))
    return dict(zip(LINKS, body.fields(d, posed, (), 1.0, pos, quat, xp=np).body_pos, strict=True))


def settle(name: str, sex: float, stature: float, girth: float, rng: np.random.Generator):
    """One row of a bank as ``Postures``, or the words for why it was rejected."""
    how, d = SCENARIOS[name], anthropometry.dims(sex, stature, girth)
    pos, quat, angles = fall(d, how, rng)
    if np.abs(pos[:2] - how.start[:2]).max() > STRAYED:
        return "fell off the bed"
    angles, speed = rest_arm(d, how, pos, quat, angles)
    if speed >= STILL:
        return "not at rest"
    wrist = link_positions(d, pos, quat, angles)["right_hand"]
    if not how.arm and wrist[0] < OVERHANG:
        return "arm slid off the bed"
    gap = clearances(d, pos, quat, angles)
    if min(gap.values()) < -DEEPEST:
        return "penetrates the bed"
    if min(gap["chest"], gap["waist"], gap["hips"]) > FLOATING:
        return "floats"
    return Postures(sex, stature, girth, pos, quat, angles)


def build_bank(name: str, seed: int = 0, size: int = 512) -> tuple[Postures, Counter]:
    """Settle people until a bank is full.

    Args:
        name: of the task.
        seed: of sizes and joint angles.
        size: rows; the first 3/8 are AG's men, the next 3/8 its women, the rest of any size.

    Returns:
        the bank, and how often which word came back; "kept" are the rows.

    Raises:
        AgymError: too few falls end well.
    """
    rng, people, counts = np.random.default_rng(seed), People(sizes="continuous"), Counter()
    rows: list[Postures] = []
    while len(rows) < size:
        kind = 8 * len(rows) // (3 * size)
        sex, stature, girth = float(kind), 1.0, 1.0
        if kind == 2:
            sex, stature, girth = (
                rng.uniform(*x) for x in (people.blend, people.stature, people.girth)
            )
        row = settle(name, sex, stature, girth, rng)
        counts["kept" if isinstance(row, Postures) else row] += 1
        rows += [row] if isinstance(row, Postures) else []
        print(f"\r{name}: {len(rows)}/{size}", end="", flush=True)
        if counts.total() > TRIES * size:
            raise AgymError(f"{name}: too few people come to lie well on the bed: {dict(counts)}")
    print()
    stack = {
        f.name: np.array([getattr(r, f.name) for r in rows], np.float32) for f in fields(Postures)
    }
    # float32 may round a limit outwards
    low, high = body.joint_limits(ALL, 1.0, np).T.astype(np.float32)
    stack["angles"] = np.clip(stack["angles"], low, high)
    return Postures(**stack), counts


def save_bank(bank: Postures, name: str, provenance: dict) -> None:
    """Write a bank without pickle, with where it came from."""
    path = posture_path(name)
    path.parent.mkdir(parents=True, exist_ok=True)
    arrays = {f.name: getattr(bank, f.name) for f in fields(Postures)}
    np.savez_compressed(path, **arrays, provenance=np.array(json.dumps(provenance)))


def statistics(bank: Postures, sex: float) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Mean and spread of links [m] and angles [deg] over AG's men (0) or women (1) of a bank."""
    chosen = np.flatnonzero((bank.sex == sex) & (bank.stature == 1) & (bank.girth == 1))
    d, seen = anthropometry.dims(sex), {}
    for i in chosen:
        links = link_positions(d, bank.root_pos[i], bank.root_quat[i], bank.angles[i])
        degrees = dict(zip(ALL, np.rad2deg(bank.angles[i]), strict=True))
        for key, value in (links | degrees).items():
            seen.setdefault(key, []).append(value)
    return {key: (np.mean(v, axis=0), np.std(v, axis=0)) for key, v in seen.items()}


def compare(bank: Postures, name: str) -> None:
    """Print a bank's statistics beside AG's."""
    for sex, who in enumerate(("men", "women")):
        found = statistics(bank, sex)
        for key in (*AG[name], *(j for j in ARM if j not in AG[name])):
            mean, spread = (np.round(x, 3 if key in LINKS else 0) for x in found[key])
            wanted = AG[name][key][sex] if key in AG[name] else "not measured"
            print(f"{who:6} {key:18} {mean!s:24} +- {spread!s:22} AG {wanted}")


def main(argv: list[str] | None = None) -> int:
    """Command line: build banks."""
    parser = argparse.ArgumentParser(prog="python -m agym_jax.person.settle", description=__doc__)
    build = parser.add_subparsers(required=True).add_parser("build", help="build banks of postures")
    build.add_argument("tasks", nargs="*", default=list(SCENARIOS), metavar="TASK")
    build.add_argument("--seed", type=int, default=0)
    build.add_argument("--size", type=int, default=512)
    args = parser.parse_args(argv)
    try:
        for name in args.tasks:
            if name not in SCENARIOS:
                raise UnknownNameError("task on the bed", name, SCENARIOS)
            bank, counts = build_bank(name, args.seed, args.size)
            command = f"python -m agym_jax.person.settle build {name} --seed {args.seed} --size {args.size}"
            provenance = {
                "command": command, "seed": args.seed, "counts": dict(counts),
                "versions": {p: version(p) for p in ("mujoco", "numpy")},
            }  # fmt: skip
            save_bank(bank, name, provenance)
            print(f"{name}: {dict(counts)}")
            compare(bank, name)
    except AgymError as error:
        print(error, file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
