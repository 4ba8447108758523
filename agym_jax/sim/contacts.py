"""Which geoms may touch which: pairs by what their force means, by names with prefixes.

DEVIATION(friction-pyramid): friction against a sliding motion is AG's along two directions of the contact, 71 % of it
between them and 86 % on average: MuJoCo's cone is a pyramid here, Bullet's is round.
DEVIATION(no-rolling): contacts of tools and robots, except with the bed, resist sliding only. AG's scratcher and wiper also resist
rolling and spinning on the person, with 0.5 mm times the force: 0.0025 N m at 5 N, 0.25 % of a motor's torque.
DEVIATION(bed-contact): a limb that falls onto the bed is stopped after the physics step in which it entered, up to 2 cm
deep, and gives way; Bullet stops it at the surface. People with AG's masses land as in Bullet (``landing``): a man's wrist follows AG's
within 1 cm until the arm meets the bed and within 2.4 cm on average over the first second, a woman's within 4 and 5.5 cm. At rest, elbow and
wrist are as high as AG's within 1.6 cm, and a man's wrist is 8 cm nearer to the feet. The bed's edge is round here, in AG a mesh with a
ridge, and in MuJoCo's cone sliding, rolling and spinning share one bound: a limp arm that hangs over the edge rolls and slides down it. With AG's rolling friction
of ArmManipulation, 0.15 m, a sudden push of 12, 20, 30 and 40 N at the elbow moves it by 5, 21, 33 and 35 cm within 0.5 s, in AG by 1, 1, 15 and 14 (medians of
ten people). There, the person's arm has 0.28 m here, which was fitted to these pushes: 1, 2, 5 and 14 cm; where a man's elbow comes to rest is then 3 cm from AG's
instead of 1, and an arm that falls is up to 1 cm inside the bed for 99 % of the time instead of 0.4.
Scoopers and robots roll off the bed's edge more easily here, too: from states of AG's episodes in which a scooper presses on it, recorded actions turn
the joint that turns farthest by 0.17 (PR2), 0.18 (Jaco), 0.21 (Baxter) and 0.10 rad (Sawyer) within 0.5 s with 0.15 m, in AG by 0.05, 0.11, 0.06 and 0.04. In ArmManipulation they
have 0.6 m here, which was fitted to these states (0.08, 0.15, 0.12 and 0.06 rad). A joint is then still up to 0.08 rad from AG's (medians), with 0.15 m up to 0.12: scoopers that stand still in AG
creep here. More than 0.6 m, or more sliding friction, changes this little; three contacts for one, of twice the friction, by a fifth.
In this cone, what turns in a contact also separates, by the angle times the length of the rolling friction, so that an
arm that rests on the bed can hardly be lifted if that is long: with full actions for 2 s, an active person of BedBathing bends the elbow by 1.36 rad in
AG, here by 0.09 with AG's 2.5 m, by 1.09 with 0.28 m and by 1.35 with 0.15 m. Hence the person's arm has 0.15 m in BedBathing, robots and tools 2.5 m. Upper arm and forearm then turn about
their lengths more freely than in AG, by 1.23 instead of 0.67 rad (all joints 0.62 and 0.43; 24 people each). What was tried is in docs/transfer.md.
A robot's arm that comes to rest on the bed is held less, too: from states of 12 episodes of BedBathingSawyer in AG in which it lies on the bed, recorded actions turn the joint that turns farthest by 0.13 rad within
0.5 s, in AG by 0.02 (107 states; without the pillow 0.28; ``benchmarks/results/played_on.jsonl``).
"""

from __future__ import annotations

import math

import mujoco

from agym_jax.data.assets import asset_path
from agym_jax.human import body
from agym_jax.human.regions import REGION_OF
from agym_jax.spec import Arm, RobotSpec, Task

SELF_CONTACTS = (
    ("upper_arm", "chest"), ("forearm", "chest"), ("forearm", "waist"), ("forearm", "thigh"),
    ("forearm", "hips"), ("hand", "chest"), ("hand", "waist"), ("hand", "hips"), ("hand", "thigh"),
    ("hand", "head"),
)  # fmt: skip
"""Of the person's moving arm with the rest of the body (AG's self-collision mask, the near ones)."""


def tool_prefixes(task: Task, arms: tuple[Arm, ...]) -> tuple[str, ...]:
    """Name prefix of the tool in each arm's hand; none for tasks without a tool."""
    return ("tool/", "tool2/")[: len(arms)] if task.tool is not None else ()


def moved_geoms(robot: RobotSpec, arms: tuple[Arm, ...]) -> frozenset[str]:
    """Named geoms of a robot's file that a joint of the arms in use moves."""
    joints = {name for arm in arms for name in arm.joints}
    spec = mujoco.MjSpec.from_file(str(asset_path(robot.model)))

    def moved(body: mujoco.MjsBody | None) -> bool:
        return body is not None and (
            any(joint.name in joints for joint in body.joints) or moved(body.parent)
        )

    return frozenset(geom.name for geom in spec.geoms if geom.name and moved(geom.parent))


def contact_pairs(
    task: Task, robot: RobotSpec, moving: tuple[str, ...]
) -> dict[str, list[tuple[str, str]]]:
    """Geom pairs that may touch, by what their force means; names with prefixes.

    The robot's links and the tool's working part may touch every limb of ``task.human.limbs``; its trunk and the rest of the
    tool only the arm that is helped. The outline of a tool that has one takes the place of its working part but for that arm.
    Furniture, the robot's trunk and its mount meet the tool's working part and the hand. Bed and mount also meet the robot's
    wrist and forearm, the trunk what ``RobotSpec.near_trunk`` names, and the mount a person's arm that hangs over the bed's side.
    What meets the furniture of tools and robots also meets ``SeatSpec.outline``, limbs do not.
    What no joint moves, of trunk and person, makes no pairs: between two such geoms the solver has no finite force.

    Args:
        task: of the scene.
        robot: of the scene.
        moving: joints of the person that are hinges.
    """
    arms = robot.arms_for(task)
    limbs = body.shapes_of(task.human.limbs)
    arm = [x for x in limbs if x.split("_", 1)[-1] in ("upper_arm", "forearm", "hand")]
    seat = [f"seat/{g}" for g in task.seat.geoms]
    met = seat + [f"seat/{g}" for g in task.seat.outline]
    trunk = [f"robot/{g}" for g in robot.trunk]
    turning = moved_geoms(robot, arms) if trunk else frozenset()
    free = [x for x in arm if body.is_free(body.LINK[x], moving)]
    mount = [f"mount/{g}" for g in robot.solid_mounts.get(task.seat.name, ())]
    pairs: dict[str, list[tuple[str, str]]] = {}
    for prefix in tool_prefixes(task, arms):
        tool = task.tool
        assert tool is not None  # or there were no prefixes
        geoms = [f"{prefix}{g}" for g in tool.geoms]
        coarse = [f"{prefix}{tool.outline}"] if tool.outline else geoms[: tool.n_working]
        others = [x for x in limbs if x not in arm]
        pairs[f"{prefix}human"] = [(g, f"human/{x}") for g in geoms for x in arm] + [
            (g, f"human/{x}") for g in coarse for x in others
        ]
        pairs[f"{prefix}seat"] = [(g, x) for g in coarse for x in met]
        pairs[f"{prefix}robot"] = [(g, x) for g in coarse for x in trunk]
        pairs[f"{prefix}mount"] = [(g, x) for g in coarse for x in mount]
    pairs |= {f"robot_{other}": [] for other in ("human", "seat", "robot", "mount")}
    pairs["robot_human"] = [
        (f"robot/{g}", f"human/{x}") for g in robot.trunk for x in (arm if g in turning else free)
    ]
    for each in arms:
        links = [f"robot/{g}" for g in each.links]
        outer = links[: each.hand]
        pairs["robot_human"] += [(g, f"human/{x}") for g in links for x in limbs]
        leaning = links if task.seat.stops_arm else outer
        pairs["robot_seat"] += [(g, x) for g in leaning for x in met]
        near = [f"robot/{g}" for g in robot.near_trunk]
        pairs["robot_robot"] += [(g, x) for g in (*outer, *near) for x in trunk]
        inner = [f"robot/{g}" for g in robot.near_mount]
        pairs["robot_mount"] += [(g, x) for g in (*links, *inner) for x in mount]
    outer = [x for x in free if task.seat.bears_upper_arm or not x.endswith("upper_arm")]
    pairs["human_seat"] = [(f"human/{x}", g) for x in outer for g in seat]
    side = task.human.arm
    # an arm that hangs over the bed's side may come upon what the robot stands on
    hangs = free if task.seat.bears_upper_arm else []
    fronts = [f"mount/{g}" for g in robot.mount_fronts.get(task.seat.name, ())] or mount
    pairs["human_mount"] = [(f"human/{x}", m) for x in hangs for m in fronts]
    girdle = f"{side}_girdle"
    if task.seat.bears_upper_arm and body.is_free(body.LINK[girdle], moving):
        pairs["human_seat"] += [(f"human/{girdle}", f"seat/{g}") for g in task.seat.pillow]
    pairs["human_self"] = [
        (f"human/{side}_{a}", f"human/{side}_{c}" if b == "thigh" else f"human/{c}")
        for a, b in SELF_CONTACTS
        for c in (body.shapes_of([b]) or (b,))
        if f"{side}_{a}" in free and (f"{side}_{b}" if b == "thigh" else b) in limbs
    ]
    return pairs


def touch_rows(task: Task, pairs: list[tuple[str, str]]) -> tuple[list[int], list[bool]]:
    """Which pairs of a tool and the person count as one contact: those of one part and one limb.

    Args:
        task: of the scene.
        pairs: a value of ``contact_pairs`` whose key ends in "human".

    Returns:
        for each pair the number of its contact, and for each contact whether the tool's working part makes it.
    """
    tool = task.tool
    assert tool is not None
    sizes = tool.parts or (1,) * len(tool.geoms)
    part = dict(zip(tool.geoms, (i for i, n in enumerate(sizes) for _ in range(n)), strict=True))
    part[tool.outline] = len(sizes)
    works = set(tool.geoms[: tool.n_working])
    seen: dict[tuple[int, str], int] = {}
    rows, working = [], []
    for geom, limb in pairs:
        name = geom.partition("/")[2]
        key = (part[name], body.SHAPES[limb.partition("/")[2]])
        if key not in seen:
            seen[key] = len(seen)
            working.append(name in works)
        rows.append(seen[key])
    return rows, working


def touched_regions(pairs: dict[str, list[tuple[str, str]]]) -> list[int]:
    """Rows of ``human.regions.REGIONS``: what each pair of ``contact_pairs`` with the person touches, in order."""
    kinds = [kind for kind in pairs if is_sensed(kind) and kind.endswith("human")]
    return [REGION_OF[limb.removeprefix("human/")] for kind in kinds for _, limb in pairs[kind]]


def pair_friction(kind: str, task: Task, robot: RobotSpec) -> float:
    """Coefficient of friction of one kind of pair: the product of both materials', as in Bullet.

    Args:
        kind: a key of ``contact_pairs``.
        task: of the scene.
        robot: of the scene.
    """
    return math.prod(_materials(kind, task, robot))


def pair_rolling(kind: str, task: Task, robot: RobotSpec) -> float:
    """Rolling and spinning friction of one kind of pair [m]; 0 for those that resist sliding only.

    Bullet's is ``r1 * f2 + r2 * f1`` of two materials' lengths and friction coefficients. Only the bed has a length (``no-rolling``). For
    limbs it is ``SeatSpec.limb_rolling``, and for tools and robots ``tool_rolling``, where given; these are not multiplied (``bed-contact``).

    Args:
        kind: a key of ``contact_pairs``.
        task: of the scene.
        robot: of the scene.
    """
    one, other = sides(kind)
    if other != "seat":
        return 0.0
    seat = task.seat
    given = seat.limb_rolling if one == "human" else seat.tool_rolling
    return seat.rolling * _materials(kind, task, robot)[0] if given is None else given


def sides(kind: str) -> tuple[str, str]:
    """What touches what in pairs of one kind: tool, robot, human; human, self, robot, seat, mount.

    Args:
        kind: a key of ``contact_pairs``.
    """
    one, other = kind.replace("/", "_").replace("tool2", "tool").split("_")
    return one, other


def _materials(kind: str, task: Task, robot: RobotSpec) -> tuple[float, float]:
    """Friction coefficients of both materials of a kind of pair."""
    materials = {
        "human": task.human.friction, "self": task.human.friction, "seat": task.seat.friction,
        "robot": robot.friction, "tool": task.tool.friction if task.tool is not None else 0.0,
        "mount": MOUNT_FRICTION,
    }  # fmt: skip
    one, other = sides(kind)
    return materials[one], materials[other]


MOUNT_FRICTION = 0.5
"""Of what carries a robot's base: Bullet's of anything that has no other."""

SOLREF, SOLIMP = (0.04, 1.0), (0.7, 0.95, 0.01, 0.5, 2.0)
"""Of every contact. Bullet's are as good as rigid: 0.4 mm deep while a tool presses with 3 to 5 N, ours 0.1 mm. The time
constant is two physics steps of 0.02 s, the shortest that is stable; twice that is as deep as AG's, with forces of up to
25 N where AG's fast presses reach 10 N and these 11 N (``benchmarks.parity.pressing``)."""


def is_sensed(kind: str) -> bool:
    """Whether pairs of this kind carry a contact sensor."""
    return kind.startswith(("tool", "robot_human"))
