"""Where episodes begin: bases, arms and hands.

The banks of start placements against resets recorded in Assistive Gym, for every pair of which there are any (v0.1
has no Reaching). Recorded rest poses, put into our inverse kinematics, must give the recorded joint angles. Few resets were
recorded (n in brackets), so the tolerance is what 99.9 % of samples of n rows of the bank stay below (for means and spreads at
least 1 cm or 0.02 rad). Angles are compared on the circle, by Kuiper's distance of the joint that differs most; families
of solutions (angles within 1.2 rad of each other) by the share of resets that is in another family than here, of which one
may always be.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

import numpy as np

from agym_jax.data.banks import load_bank
from agym_jax.math3d import rotation_matrix
from agym_jax.offline.base_search import FIXED_ITERATIONS, Reach
from agym_jax.registry import parse
from benchmarks.parity.row import Row, traces

TASKS = ("ScratchItch", "BedBathing", "Feeding", "Drinking", "Dressing", "ArmManipulation")
ROBOTS = ("Jaco", "Sawyer", "PR2", "Baxter")
REPLAYED = ("ScratchItch", "Feeding", "Drinking", "Dressing")
SAMPLES = 2000
KUIPER = 2.303
"""Of Kuiper's statistic, times the root of the number of samples: exceeded by one in a thousand."""
FAMILY = 1.2
"""Greatest difference of a joint within a family [rad]."""


def wrap(angles: np.ndarray) -> np.ndarray:
    """Angles in [-pi, pi) [rad]."""
    return (angles + np.pi) % (2 * np.pi) - np.pi


def kuiper(a: np.ndarray, b: np.ndarray) -> float:
    """Kuiper's distance of two samples of angles: 0 alike, 1 apart, wherever the circle is cut."""
    at = np.sort(np.concatenate([a, b]))
    below = [np.searchsorted(np.sort(x), at, side="right") / len(x) for x in (a, b)]
    apart = below[0] - below[1]
    return float(apart.max() - min(apart.min(), 0.0))


def families(angles: np.ndarray, count: int = 12) -> np.ndarray:
    """Solutions from the middles of families, the largest first [rad] (k, n)."""
    left, middles = wrap(angles), []
    while len(left) and len(middles) < count:
        near = np.abs(wrap(left[:, None] - left[None])).max(axis=-1) < FAMILY
        middle = np.argmax(near.sum(axis=1))
        middles.append(left[middle])
        left = left[~near[middle]]
    return np.array(middles)


def shares(angles: np.ndarray, middles: np.ndarray) -> np.ndarray:
    """Share of each family, and of none of them (k + 1,)."""
    apart = np.abs(wrap(angles[:, None] - middles[None])).max(axis=-1)
    which = np.where(apart.min(axis=1) < FAMILY, apart.argmin(axis=1), len(middles))
    return np.bincount(which, minlength=len(middles) + 1) / len(angles)


def room(statistic: Callable[..., np.ndarray], values: np.ndarray, n: int, least: float) -> float:
    """By how much a statistic of n of the values may differ from that of all.

    Args:
        statistic: ``np.mean`` or ``np.std``.
        values: (K,).
        n: size of a sample.
        least: is always allowed.
    """
    drawn = values[np.random.default_rng(0).integers(0, len(values), (SAMPLES, n))]
    apart = np.abs(statistic(drawn, axis=1) - statistic(values))
    return max(least, float(np.quantile(apart, 0.999)))


@cache
def reach(task: str, robot: str) -> Reach:
    """The inverse kinematics of a pair."""
    recipe = parse(f"{task}{robot}-v0")
    return Reach(recipe.task, recipe.robot, np.random.default_rng(0))


@cache
def ours(task: str, robot: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Angles [rad] (K, n), bases as AG gives them, x, y, z, yaw (K, 4), and hands [m] (K, 3) of a bank."""
    recipe = parse(f"{task}{robot}-v0")
    bank = load_bank(recipe.task, recipe.robot)
    rots = rotation_matrix(np.asarray(bank.base_quat, float), np)
    angles = np.asarray(bank.arm_angles, float)
    solver = reach(task, robot).solvers[0]
    hand = np.einsum("nij,jn->ni", rots, solver.forward(angles[:, : solver.n].T)[0])
    pivot = (
        np.zeros(3)
        if recipe.robot.fixed_base(recipe.task)
        else recipe.robot.base_search(task).pivot
    )
    yaw = 2 * np.arctan2(bank.base_quat[:, 3], bank.base_quat[:, 0])
    base = np.column_stack([bank.base_pos + rots @ np.array(pivot), yaw])
    return angles, base, hand + bank.base_pos


def replayed(task: str) -> tuple[np.ndarray, np.ndarray]:
    """Angles [rad] (n, 7) that our inverse kinematics of Jaco on the wheelchair gives, and the recorded ones."""
    recipe, solver = parse(f"{task}Jaco-v0"), reach(task, "Jaco")
    fixed = recipe.robot.bases.get(task, recipe.robot.bases["wheelchair"])
    start, rest, goal = (
        traces("starts")[f"{task}Jaco_replay_{k}"] for k in ("start", "rest", "goal")
    )
    rot = rotation_matrix(np.array(fixed.quat), np)
    turn = rot.T @ rotation_matrix(np.array(solver.quats[0]), np)
    found = solver.solvers[0].solve(
        start, rest, (goal - fixed.pos) @ rot, np.tile(turn, (len(goal), 1, 1)), FIXED_ITERATIONS
    )
    limits = solver.limits[0]
    return np.clip(found, limits.lower, limits.upper), traces("starts")[f"{task}Jaco_arm_q"]


def rows() -> list[Row]:
    """The inverse kinematics, then pair by pair."""
    found = []
    for task in REPLAYED:
        mine, theirs = replayed(task)
        found.append(
            Row(
                f"{task}, Jaco: replayed inverse kinematics, largest difference of a joint ({len(theirs)})",
                "rad",
                0.0,
                float(np.abs(mine - theirs).max()),
                0.02,
            )
        )
    for task in TASKS:
        for robot in ROBOTS:
            found += _pair(task, robot)
    return found


def _pair(task: str, robot: str) -> list[Row]:
    angles, base, hand = ours(task, robot)
    ag = {
        k: traces("starts")[f"{task}{robot}_{k}"].astype(float) for k in ("arm_q", "base", "hand")
    }
    n, name = len(ag["arm_q"]), f"{task}, {robot}"
    less = "goal-contact" if ag["base"][:, 1].std() > 0 else "start-free"
    found: list[Row] = []

    def add(quantity: str, unit: str, theirs: float, mine: float, tolerance: float) -> None:
        found.append(Row(f"{name}: {quantity} ({n})", unit, theirs, mine, tolerance, less))

    if ag["base"][:, 1].std() > 0:
        turn = ag["base"][0, 3]  # yaw of Dressing is about pi
        ag["base"][:, 3], base[:, 3] = (turn + wrap(x[:, 3] - turn) for x in (ag["base"], base))
        for i, axis, unit in ((0, "x", "m"), (1, "y", "m"), (3, "yaw", "rad")):
            theirs, mine = ag["base"][:, i], base[:, i]
            least = 0.02 if axis == "yaw" else 0.01
            free = room(np.mean, mine, n, least)
            add(f"base {axis}, mean", unit, theirs.mean(), mine.mean(), free)
            if n >= 10:
                free = room(np.std, mine, n, least)
                add(f"base {axis}, spread", unit, theirs.std(), mine.std(), free)
    worst = max(kuiper(wrap(a), wrap(b)) for a, b in zip(ag["arm_q"].T, angles.T, strict=True))
    size = np.sqrt(n * len(angles) / (n + len(angles)))
    add(
        "Kuiper's distance of a joint, largest",
        "",
        0.0,
        worst,
        KUIPER / (size + 0.155 + 0.24 / size),
    )
    middles = families(angles)
    mine, theirs = shares(angles, middles), shares(ag["arm_q"], middles)
    draws = np.random.default_rng(0).multinomial(n, mine, 4000) / n
    free = max(1 / n, float(np.quantile(np.abs(draws - mine).sum(axis=1) / 2, 0.999)))
    add("resets in another family", "", 0.0, float(np.abs(mine - theirs).sum() / 2), free)
    if task != "ArmManipulation":  # AG reports the tool's centre of mass there
        apart = np.abs(hand.mean(axis=0) - ag["hand"].mean(axis=0))
        free = max(room(np.mean, x, n, 0.005) for x in hand.T)
        add("hand, mean place, largest difference of x, y, z", "m", 0.0, float(apart.max()), free)
    return found
