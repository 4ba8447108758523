"""Friction.

Bullet gives a pair of bodies the product of their coefficients: 0.5 for the person, robots, tools and the wheelchair
(recorded for every link), 5 for the bed in BedBathing and 0.3 in ArmManipulation. Rolling and spinning are resisted with a length,
times the normal force: of two bodies each one's length times the other's coefficient; the bed's lengths are 5 and 0.3 m. Ours are read from the compiled models
of all 28 pairs of task and robot, with a still and with an active person, a man and a woman; where they differ, the
one farthest from AG's is shown. Sliding is measured with a sphere on a plane that has the contact of tool and person.
"""

from __future__ import annotations

import functools
import itertools

import mujoco
import numpy as np

from agym_jax.robots import ROBOTS
from agym_jax.sim.contacts import SOLIMP, SOLREF, contact_pairs, sides
from agym_jax.sim.scene import build_scene
from agym_jax.tasks import TASKS
from benchmarks.parity.row import Row, traces

Pair = tuple[float, list[float]]
# Coefficient of sliding and length of rolling [m] of the bed, which cannot be queried; ag_traces, facts
BED = {"BedBathing": 5.0, "ArmManipulation": 0.3}
NAMES = {"tool": "tool", "robot": "robot", "human": "person"}
DIRECTIONS, SPEED, LOAD, SLIDE = 32, 0.1, 5.0, 50  # of sliding; [m/s], [N], physics steps
MATERIALS = {"robot": ("robot",), "human": ("person",), "tool": ("tool", "spoon", "cup", "robot"), "seat": ("wheelchair",), "self": ("person",), "mount": ("nightstand",)}  # fmt: skip
"""Recorded bodies that our kinds of geoms stand for; the scooper is part of the robot."""


def recorded(kind: str) -> float:
    """A material's coefficient in Assistive Gym: the same for all of its bodies, or NaN."""
    bodies, lateral = traces("friction")["bodies"], traces("friction")["lateral"]
    of = [str(name).split(":")[1] in MATERIALS[kind] for name in bodies]
    values = np.unique(lateral[of])
    return float(values[0]) if len(values) == 1 else float("nan")


@functools.cache
def pairs() -> tuple[dict[str, Pair], dict[str, Pair]]:
    """What touches what -> AG's coefficient, and ours in every model; the same of rolling and spinning on the bed [m]."""
    sliding: dict[str, Pair] = {}
    rolling: dict[str, Pair] = {}
    for task, robot, active in itertools.product(TASKS.values(), ROBOTS.values(), (False, True)):
        scene = build_scene(task, robot, active)
        for kind, names in contact_pairs(task, robot, scene.moving).items():
            if not names:
                continue
            one, other = sides(kind)
            seat = f"mattress in {task.name}" if task.name in BED else "wheelchair"
            others = {"seat": seat, "self": "himself", "mount": "nightstand"}
            what = f"{NAMES[one]} on {others.get(other, NAMES.get(other))}"
            on_bed = other == "seat" and task.name in BED
            ag = recorded(one) * (BED[task.name] if on_bed else recorded(other))
            _, slid = sliding.setdefault(what, (ag, []))
            _, rolled = rolling.setdefault(what, (ag, [])) if on_bed else (ag, [])
            for model in (scene.model, scene.female):
                rows = [model.pair(f"{a}|{b}").id for a, b in names]
                slid += model.pair_friction[rows, :2].ravel().tolist()
                resisted = model.pair_dim[rows, None] == 6
                rolled += np.where(resisted, model.pair_friction[rows, 2:], 0.0).ravel().tolist()
    return sliding, rolling


def is_given(pair: str) -> bool:
    """Whether a task gives the rolling friction of a kind of pair itself, instead of its materials'."""
    what, _, task = pair.partition(" in ")
    seat = TASKS[task].seat
    return (seat.limb_rolling if what.startswith("person") else seat.tool_rolling) is not None


def farthest(pair: Pair) -> float:
    """Of our values the one that differs most from AG's."""
    ag, ours = pair
    return max(ours, key=lambda x: abs(x - ag))


def sliding(friction: float) -> np.ndarray:
    """Tangential over normal force of a sphere that slides in each of ``DIRECTIONS``."""
    spec = mujoco.MjSpec()
    spec.option.timestep, spec.option.cone = 0.02, mujoco.mjtCone.mjCONE_PYRAMIDAL
    spec.option.gravity = (0.0, 0.0, 0.0)
    spec.worldbody.add_geom(name="plane", type=mujoco.mjtGeom.mjGEOM_PLANE, size=[5.0, 5.0, 0.1])
    ball = spec.worldbody.add_body(name="ball", pos=(0.0, 0.0, 0.01))
    for axis in np.eye(3):
        ball.add_joint(type=mujoco.mjtJoint.mjJNT_SLIDE, axis=axis)
    ball.add_geom(name="ball", type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[0.01, 0.0, 0.0], mass=1.0)
    spec.add_pair(
        name="contact", geomname1="plane", geomname2="ball", condim=3,
        friction=[friction, friction, 0.005, 1e-4, 1e-4], solref=SOLREF, solimp=SOLIMP,
    )  # fmt: skip
    model = spec.compile()
    data, wrench, ratios = mujoco.MjData(model), np.zeros(6), []
    for angle in np.linspace(0.0, 2 * np.pi, DIRECTIONS, endpoint=False):
        mujoco.mj_resetData(model, data)
        data.qfrc_applied[2] = -LOAD
        along = normal = 0.0
        for _ in range(SLIDE):
            data.qvel[:2] = SPEED * np.cos(angle), SPEED * np.sin(angle)
            mujoco.mj_step(model, data)
            if data.ncon:  # it may hop
                mujoco.mj_contactForce(model, data, 0, wrench)
                push = data.contact.frame[0].reshape(3, 3).T @ wrench[:3]
                along += push @ [np.cos(angle), np.sin(angle), 0.0]
                normal += push[2]
        ratios.append(abs(along / normal))
    return np.array(ratios)


def rows() -> list[Row]:
    """The comparison."""
    slides, rolls = pairs()
    product = slides["tool on person"][0]
    slid = sliding(product)
    # Bullet: of one body times the lateral friction of the other, and the other way round
    rolling = recorded("human") * float(traces("friction")["rolling"].max())
    return [
        *(Row(f"coefficient, {what}", "", x[0], farthest(x), 1e-4) for what, x in slides.items()),
        *(
            Row(f"rolling and spinning, {what}", "m", x[0], farthest(x), 1e-4, "bed-contact" if is_given(what) else "")
            for what, x in rolls.items()
        ),
        Row("tangential over normal force of a sliding tool, most", "", product, float(slid.max()), 0.05 * product),
        Row("the same, mean of all directions", "", product, float(slid.mean()), 0.05 * product, "friction-pyramid"),
        Row("the same, least", "", product, float(slid.min()), 0.05 * product, "friction-pyramid"),
        Row("rolling resistance of a tool on the person", "mm", 1e3 * rolling, 0.0, 0.05, "no-rolling"),
    ]  # fmt: skip
