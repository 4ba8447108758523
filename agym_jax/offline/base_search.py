"""Search for base poses and start angles of a robot: the batched counterpart of Assistive Gym's base search.

AG v0.1 ``env.py`` position_robot_toc (reference robots.md section 7): sample base poses beside the person,
solve inverse kinematics for the start pose and for the points that the task will need, and prefer bases that
reach all of them, with joints far from their limits and high kinematic isotropy. AG tries 100 bases at every
reset; here thousands are tried at once, offline, over the range of people.

DEVIATION(start-free): start poses in which robot or tool would touch the person, the furniture or the
robot itself are left out; AG only checks for the last.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from agym_jax.data.banks import Placement
from agym_jax.errors import SpecError
from agym_jax.human import body, population
from agym_jax.human import pose as human_pose
from agym_jax.math3d import axis_angle_quat, quat_mul, rotation_matrix
from agym_jax.offline import kinematics
from agym_jax.offline.clearance import Clearance
from agym_jax.sim.scene import build_scene
from agym_jax.spec import RobotSpec, Task

REACHED = 0.001
"""A start pose counts as reached within this distance [m] (AG: 0.03) and ``REACHED_ROTATION`` [rad]."""
REACHED_ROTATION = 0.01
GOAL_REACHED = 0.03
"""A further goal counts as reached within this distance [m], as in AG."""
CLEARANCE = 0.005
"""Least distance [m] of robot and tool from person, furniture and the rest of the robot at the start."""
NEARLY_BEST = 0.8
"""Solutions with at least this share of the best isotropy may be chosen because they resemble the others."""
YAW = np.deg2rad(30.0)
"""Range of the base's yaw on either side of that of its area [rad]."""
TRIES = 8
"""Candidates per row of the bank, where base poses are searched."""


@dataclass(frozen=True)
class Goals:
    """Bases of a batch of N candidates, and what they have to reach, in the world."""

    base_pos: np.ndarray  # (N, 3)
    base_yaw: np.ndarray  # before the fixed base's own orientation, if any [rad] (N,)
    start: np.ndarray  # of each hand (N, n_arms, 3)
    points: tuple[np.ndarray, ...]  # of each arm, further points (N, n_points, 3)


@dataclass(frozen=True)
class Report:
    """Outcome of a search."""

    tried: int
    start_reached: int
    goals_reached: dict[str, int]  # among those whose start was reached
    kept: int

    def table(self) -> str:
        """One line for the terminal."""
        share = lambda n, of: f"{100 * n / max(of, 1):.0f} %"  # noqa: E731
        goals = ", ".join(
            f"{k} {share(v, self.start_reached)}" for k, v in self.goals_reached.items()
        )
        return (
            f"{self.tried} tried, start reached by {share(self.start_reached, self.tried)}; of "
            f"these {goals or 'no further goals'}; {self.kept} kept"
        )


def search(
    task: Task, robot: RobotSpec, seed: int = 0, size: int = 512, restarts: int = 32
) -> tuple[Placement, Report]:
    """Find start placements for a task-robot pair.

    Args:
        task: defines the hands' start positions and goals.
        robot: defines bases, orientations and chains.
        seed: of all random numbers.
        size: greatest number of rows.
        restarts: random initial angles of the inverse kinematics per start pose, to find its best
            family of solutions; a quarter of them for the further goals.

    Returns:
        the rows, best first, and a report.

    Raises:
        SpecError: robot and task do not fit together, a goal is out of reach of all bases, or no start
            pose is both reached and free of contacts.
    """
    scene = build_scene(task, robot)
    chains = _chains(scene)
    fixed = robot.fixed_base(task)
    n = int(1.5 * size) if fixed else TRIES * size
    goals = _draw_goals(task, robot, len(chains), n, seed)
    rotations = [start_rotation(task, robot, i, scene) for i in range(len(chains))]
    quats = _base_quats(goals.base_yaw, fixed.quat if fixed else (1.0, 0.0, 0.0, 0.0))
    rots = rotation_matrix(quats, np)
    key = jax.random.PRNGKey(seed + 1)

    angles, scores, ok = [], np.zeros(n), np.ones(n, bool)
    reached: dict[str, Any] = {}
    names = _goal_names(task, len(chains))
    for a, chain in enumerate(chains):
        solve = partial(_solve, chain)
        to_base = lambda p: np.einsum("nji,nj->ni", rots, p - goals.base_pos)  # noqa: E731
        turn = np.einsum("nji,jk->nik", rots, rotations[a])
        key, sub = jax.random.split(key)
        q, distance, rotation, score = solve(sub, to_base(goals.start[:, a]), turn, 0.3, restarts)
        good = (distance < REACHED) & (rotation < REACHED_ROTATION)
        rows = np.arange(n)
        value = np.where(good, score, -1.0)
        if len(chains) == 1:
            free = partial(_free_share, Clearance(task, robot), goals.base_pos, quats, q)
            best = _free_family(q, value, chain, free)
        else:  # whether an arm is free of contacts depends on the other one too
            best = _one_family(q, value, chain)
        angles.append(q[rows, best])
        ok &= good[rows, best]
        scores += np.where(good[rows, best], score[rows, best], 0.0)
        for i, name in enumerate(names[a]):
            key, sub = jax.random.split(key)
            _, distance, _, score = solve(
                sub, to_base(goals.points[a][:, i]), turn, 0.0, max(1, restarts // 4)
            )
            good = distance < GOAL_REACHED
            reached[name] = good.any(axis=1)
            scores += np.where(good, score, 0.0).max(axis=1)
    for name, hits in reached.items():
        if ok.any() and not (hits & ok).any():
            raise SpecError(
                f"No base of {robot.name} from which {task.name} can start reaches the goal {name!r} "
                f"({n} tried). Widen RobotSpec.searches[{task.name!r}] or change Task.goals."
            )
    count = sum((hits.astype(int) for hits in reached.values()), np.zeros(n, int))
    order = np.lexsort((-scores, -count))
    joined = _unwind(np.concatenate(angles, axis=1), chains, ok)
    candidates = Placement(goals.base_pos, quats, joined)  # pyrefly: ignore[bad-argument-type]
    rows = _free_rows(task, robot, candidates, order[ok[order]], size)
    report = Report(
        n, int(ok.sum()), {k: int((v & ok).sum()) for k, v in reached.items()}, len(rows)
    )
    if not rows:
        raise SpecError(f"{robot.name} finds no free start for {task.name}: {report.table()}.")
    pick = np.array(rows)
    bank = jax.tree.map(lambda x: jnp.asarray(x[pick], jnp.float32), candidates)
    return bank, report


def start_rotation(task: Task, robot: RobotSpec, arm: int, scene) -> np.ndarray:
    """Orientation of a hand's end-effector site at the start, world (3, 3).

    By default the hand points along +x, at the person, and its fingers open sideways.
    """
    if task.name in robot.start_rotations:
        return rotation_matrix(np.array(robot.start_rotations[task.name]), np)
    model, spec = scene.model, scene.arms[arm]
    rot = lambda name: rotation_matrix(model.site(f"robot/{name}").quat, np)  # noqa: E731
    tool_in_hand = rot(spec.end_effector).T @ rot(spec.tool_frame)
    forwards = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    return forwards @ tool_in_hand.T


def _chains(scene) -> list[kinematics.Chain]:
    model, index = scene.model, scene.index
    chains = []
    for tool, arm in zip(index.tools, scene.arms, strict=True):
        site = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_SITE, f"robot/{arm.end_effector}")
        chains.append(kinematics.chain_of(model, tool.joints, site, index.robot_base))
    return chains


def _goal_names(task: Task, n_arms: int) -> list[list[str]]:
    """Names of the further goals of each arm; a single arm has to reach all of them."""
    if n_arms == len(task.goals):
        return [list(names) for names in task.goals]
    return [[name for names in task.goals for name in names]]


def _draw_goals(task: Task, robot: RobotSpec, n_arms: int, n: int, seed: int) -> Goals:
    """Base poses, start positions, and goals of as many people (64 different ones)."""
    rng = np.random.default_rng(seed)
    fixed, area = robot.fixed_base(task), robot.base_search(task.name)
    if fixed:
        base, yaw = np.tile(np.array(fixed.pos), (n, 1)), np.zeros(n)
    else:
        away = area.side * rng.uniform(0.0, area.spread, n)
        along = rng.uniform(-area.spread, area.spread, n)
        base = np.array(area.centre) + np.stack([away, along, np.zeros(n)], axis=1)
        yaw = area.yaw + rng.uniform(-YAW, YAW, n)
    keys = jax.random.split(jax.random.PRNGKey(seed), n)
    start = np.asarray(jax.vmap(lambda k: task.start(k, robot.name))(keys))
    if start.ndim != 3 or start.shape[1] < n_arms or start.shape[2] != 3:
        raise SpecError(
            f"{task.name}.start must give one row [m] for each arm, of shape ({n_arms}, 3); with "
            f"{robot.name} it gives {start.shape[1:]}."
        )
    humans = _points(task, [x for names in task.goals for x in names], 64, seed)
    who = rng.integers(0, 64, n)
    points = tuple(
        np.stack([humans[name][who] for name in names], axis=1) if names else np.zeros((n, 0, 3))
        for names in _goal_names(task, n_arms)
    )
    return Goals(base, yaw, start[:, :n_arms], points)


def _points(task: Task, names: list[str], count: int, seed: int) -> dict[str, np.ndarray]:
    """Positions of named points of sampled people, world [m] name -> (count, 3)."""
    spec = task.human

    def one(key: jax.Array) -> tuple[population.Human, human_pose.BodyPose]:
        key_human, key_pose = jax.random.split(key)
        human = population.sample_human(
            key_human,
            population.Population(),
            len(spec.joints),
            spec.tremor_amplitude,
            spec.impairments,
        )
        return human, human_pose.sample_pose(key_pose, spec, human)

    keys = jax.random.split(jax.random.PRNGKey(seed), count)
    drawn = jax.tree.map(np.asarray, jax.jit(jax.vmap(one))(keys))
    order = [link.name for link in body.LINKS]
    found: dict[str, list] = {name: [] for name in names}
    for i in range(count):
        human, pose = jax.tree.map(lambda x: x[i], drawn)  # noqa: B023
        # no joint is free here, so every link has a pose in the world
        rows = human_pose.rows(spec, pose, human.dims, (), human.limit_scale, np)
        for name in found:
            row = order.index("head" if name == "mouth" else name)
            point = np.array(rows.body_pos[row])
            if name == "mouth":
                local = np.array([0.0, human.dims.mouth_y, human.dims.mouth_z])
                point = point + rotation_matrix(rows.body_quat[row], np) @ local
            found[name].append(point)
    return {name: np.array(rows) for name, rows in found.items()}


def _one_family(q: np.ndarray, score: np.ndarray, chain: kinematics.Chain) -> np.ndarray:
    """Choose a solution per candidate, so that the chosen ones are similar and nearly the best.

    A pose has several families of solutions (elbow up or down, wrist flipped), often equally good. A policy learns
    more easily if every episode starts from the same family.

    Args:
        q: solutions [rad] (N, restarts, n).
        score: of each, -1 where it does not reach (N, restarts).
        chain: for the limits.

    Returns:
        index of the solution (N,); the best one where no candidate reaches.
    """
    fine = (score > 0) & (score >= NEARLY_BEST * score.max(axis=1, keepdims=True))
    if not fine.any():
        return np.argmax(score, axis=1)
    wrap = partial(_wrap, chain=chain)
    pool = q[fine]
    pick = np.random.default_rng(0).permutation(len(pool))
    seeds, others = pool[pick[:256]], pool[pick[-2048:]]
    similar = np.abs(wrap(seeds[:, None] - others[None])).max(axis=-1) < 1.0
    middle = seeds[np.argmax(similar.sum(axis=1))]
    apart = np.linalg.norm(wrap(q - middle), axis=-1)
    return np.argmin(np.where(fine, apart, np.inf), axis=1)


def _wrap(difference: np.ndarray, chain: kinematics.Chain) -> np.ndarray:
    """Differences of angles (..., n) [rad]; those of continuous joints in [-pi, pi)."""
    free = chain.upper - chain.lower > 2 * np.pi + 0.1
    return np.where(free, (difference + np.pi) % (2 * np.pi) - np.pi, difference)


def _free_family(
    q: np.ndarray, score: np.ndarray, chain: kinematics.Chain, free: Callable[[np.ndarray], float]
) -> np.ndarray:
    """As ``_one_family``, but a family that is mostly in contact is replaced by the next one.

    Args:
        q: solutions [rad] (N, restarts, n).
        score: of each, -1 where it does not reach (N, restarts).
        chain: for the limits.
        free: share of contact-free poses, given the solution of each candidate (N,).

    Returns:
        index of the solution (N,), of the first family that is free of contacts for at least half of the
        candidates, or else of the one that is free most often.
    """
    rows, left = np.arange(len(q)), score.copy()
    best, most = _one_family(q, left, chain), -1.0
    while (left > 0).any() and most < 0.5:
        pick = _one_family(q, left, chain)
        reached = left[rows, pick] > 0
        share = free(np.where(reached, pick, -1))
        if share > most:
            best, most = np.where(reached, pick, best), share
        similar = np.abs(_wrap(q - q[rows, pick][:, None], chain)).max(axis=-1) < 1.0
        left = np.where(similar & reached[:, None], -1.0, left)
    return best


def _free_share(
    clearance: Clearance, pos: np.ndarray, quat: np.ndarray, q: np.ndarray, pick: np.ndarray
) -> float:
    """Share of contact-free poses among 24 of the picked solutions (N,), -1 for none."""
    some = np.random.default_rng(0).permutation(np.flatnonzero(pick >= 0))[:24]
    return float(np.mean([
        _is_free(clearance, Placement(pos[i], quat[i], q[i, pick[i]])) for i in some
    ]))  # fmt: skip


def _is_free(clearance: Clearance, place: Placement) -> bool:
    return clearance.inside(place) > CLEARANCE and clearance.outside(place) > CLEARANCE


def _solve(chain, key, pos, rot, weight, restarts):
    """Inverse kinematics of N poses from several initial angles each: (N, restarts, ...)."""
    low, high = np.maximum(chain.lower, -np.pi), np.minimum(chain.upper, np.pi)
    high = np.where(high < low + 0.5, chain.upper, high)
    starts = jax.random.uniform(
        key, (len(pos), restarts, len(low)), minval=jnp.asarray(low), maxval=jnp.asarray(high)
    )
    out = _solver(id(chain), chain)(
        starts, jnp.asarray(pos, jnp.float32), jnp.asarray(rot, jnp.float32), weight
    )
    return tuple(np.asarray(x) for x in out)


_COMPILED: dict[int, Any] = {}


def _solver(key: int, chain: kinematics.Chain) -> Any:
    if key not in _COMPILED:

        def one(start, pos, rot, weight):
            q, distance, turn = kinematics.inverse(chain, start, pos, rot, 40, weight=weight)
            return q, distance, turn, kinematics.isotropy(chain, q)

        _COMPILED[key] = jax.jit(jax.vmap(jax.vmap(one, (0, None, None, None)), (0, 0, 0, None)))
    return _COMPILED[key]


def _base_quats(yaw: np.ndarray, quat: tuple[float, ...]) -> np.ndarray:
    """Quaternions wxyz (N, 4) of a base orientation, rotated about the vertical."""
    about_z = axis_angle_quat(np.array([0.0, 0.0, 1.0]), yaw, np)
    return quat_mul(about_z, np.array(quat), np)


def _free_rows(
    task: Task, robot: RobotSpec, candidates: Placement, order: np.ndarray, size: int
) -> list[int]:
    """The first ``size`` of the ordered candidates that are free of contacts."""
    clearance = Clearance(task, robot)
    rows: list[int] = []
    for i in order:
        place = jax.tree.map(lambda x: x[i], candidates)  # noqa: B023
        if _is_free(clearance, place):
            rows.append(int(i))
            if len(rows) == size:
                break
    return rows


def _unwind(angles: np.ndarray, chains: list[kinematics.Chain], ok: np.ndarray) -> np.ndarray:
    """Bring continuous joints to within pi of the mean angle of the reached rows.

    Args:
        angles: (N, n) [rad].
        chains: of the arms, for the limits.
        ok: rows whose start is reached (N,) bool.
    """
    lower = np.concatenate([c.lower for c in chains])
    upper = np.concatenate([c.upper for c in chains])
    free = upper - lower > 2 * np.pi + 0.1
    used = angles[ok] if ok.any() else angles
    mean = np.arctan2(np.sin(used).mean(0), np.cos(used).mean(0))
    near = mean + (angles - mean + np.pi) % (2 * np.pi) - np.pi
    inside = free & (near >= lower) & (near <= upper)
    return np.where(inside, near, angles).astype(np.float32)
