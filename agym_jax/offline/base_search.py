"""Base poses and start angles of a robot, found as Assistive Gym finds them: one simulated reset for each row.

AG v0.1 ``env.py`` position_robot_toc and ``util.py`` ik_random_restarts (reference robots.md section 7): bases are drawn
beside the person, and each pose that the task will need is solved for once, from a random rest pose. Of a hundred bases
from which the start is reached, the one that reaches most, with joints far from their limits and high kinematic
isotropy, is where the episode begins. A robot with a fixed base takes the first solution that fits. Start
poses thus have the families, the proportions and the errors of AG's inverse kinematics (``bullet_ik``); nothing is
chosen among them. A goal that the arm reaches only inside the robot's own body does not count where AG loads the robot with
self-collision (Sawyer, Jaco).

DEVIATION(start-free): start poses in which the arm in use or its tool would touch the person or the furniture are tried
again; AG keeps those in which five physics steps do not push the hand away by 3 cm. Of 452 starts recorded there 5 are in
contact, 3 of the 40 of FeedingJaco and 2 of the 40 of ScratchItchJaco. The search tries it for a typical man and woman. Where people lie in settled
postures, an episode draws another placement if the arm would be inside the person of the posture drawn: of 768 postures x 512 placements 345 (0.088 %) meet in
BedBathingJaco, nearly all of them a woman whose forearm hangs over the edge of the bed (320 of her 512 placements), 88 (0.022 %) in ArmManipulationJaco, five people
of other sizes than AG's, and none in the other six pairs. People of sizes between those of the bank are tried as the person whose posture they have.
DEVIATION(goal-contact): a further goal counts as reached where the inverse kinematics reaches it; in AG the hand, which is
then inside the person's arm, is pushed for five physics steps first. That takes few goals away there: were those left out that
contacts in C MuJoCo push away by 3 cm within five steps, Jaco's mean base would stand 13 cm (ArmManipulation) and 4 cm
(BedBathing) from AG's along the bed; as it is it stands within 1 cm (37 and 40 resets recorded).
DEVIATION(start-person): a start pose is drawn apart from the person of the episode, except DrinkingPR2's; in AG the base is chosen for that
person's arm or mouth. Points of people's arms differ by 2 cm and mouths by 3 cm (standard deviation). From a chosen base the
goals of another person are reached as often as those of the person it was chosen for within 3 % (20 pairs, 32 to 96 bases, 4 other people each). Only PR2 in
Drinking reaches them less often: with the hand turned as at the start, another person's mouth from 23 % of 256 bases, and the mouth for which they were chosen from 53 %. So a
person gets one of the bases chosen for the nearest of 64 mouths (``BaseSearch.for_mouth``; 1 cm away, median, of people of every size 1.3, by a program outside the repository): 54 %. Until 27 November 2026, 01:00 UTC,
DrinkingPR2's bases were drawn apart from the person, too, and its arm was often straight before the cup was at the mouth.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import jax.numpy as jnp
import mujoco
import numpy as np

from agym_jax.data.banks import Placement
from agym_jax.errors import SpecError
from agym_jax.math3d import axis_angle_quat, rotation_matrix
from agym_jax.offline import bullet_ik, kinematics
from agym_jax.offline.clearance import Clearance
from agym_jax.offline.start_goals import draw_goals, goal_quat, goals_of, start_quat
from agym_jax.sim.scene import build_scene
from agym_jax.spec import Arm, Pose, Quat, RobotSpec, Task

REACHED, REACHED_QUAT = 0.03, 0.03
"""A pose is reached within this distance [m], and this length of the difference of the quaternions."""
TURNED_QUAT = 0.03
"""Of quaternions of other sign, the length of the difference may fall this far short of 2: AG takes 40 degrees."""
ROUNDS = 4
"""How often a hundred more bases are drawn for rows without a start."""
FIXED_RESTARTS, FIXED_ITERATIONS = 40, 1000
ITERATIONS = 200
CLEARANCE = 0.005
"""Least distance [m] of robot and tool from person, furniture and the rest of the robot at the start."""
YAW = np.deg2rad(30.0)
"""Range of the base's yaw on either side of that of its area [rad]."""


@dataclass(frozen=True)
class Report:
    """Outcome of a search."""

    tried: int  # bases, or restarts where the base is fixed
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
            f"{self.tried} tried, {share(self.start_reached, self.tried)} reach the start"
            f"{f', of which reach {goals}' if goals else ''}; {self.kept} kept"
        )


def search(
    task: Task, robot: RobotSpec, seed: int = 0, size: int = 512, attempts: int = 100
) -> tuple[Placement, Report, np.ndarray | None]:
    """Find start placements for a task-robot pair.

    Args:
        task: defines the hands' start positions and goals.
        robot: defines bases, orientations and chains.
        seed: of all random numbers.
        size: greatest number of rows.
        attempts: bases that are tried for each row.

    Returns:
        the rows, in the order in which they were drawn, a report, and the mouth for which each base was
        chosen, world [m] (K, 3), if the robot's ``BaseSearch.for_mouth`` asks for it.

    Raises:
        SpecError: robot and task do not fit together, a goal is out of reach of all bases, or no start
            pose is both reached and free of contacts.
    """
    reach = Reach(task, robot, np.random.default_rng(seed))
    starts, points = draw_goals(task, robot, reach.goals, size, seed, reach.rng)
    fixed = robot.fixed_base(task)
    by_mouth = robot.base_search(task.name).for_mouth and not fixed
    mouths = _mouths(reach, points) if by_mouth else None
    if fixed:
        found = reach.from_fixed_base(fixed, starts)
    else:
        found = reach.from_best_base(starts, points, attempts)
    _check_goals(task, robot, reach)
    report = Report(reach.tried, reach.reached, dict(reach.goals_reached), int(found.ok.sum()))
    if not report.kept:
        raise SpecError(f"{robot.name} finds no free start for {task.name}: {report.table()}.")
    angles = _canonical(found.angles, reach.chains)
    bank = [jnp.asarray(x[found.ok], jnp.float32) for x in (found.pos, found.quat, angles)]
    return Placement(*bank), report, None if mouths is None else mouths[found.ok]


@dataclass(frozen=True)
class _Found:
    """Start placements of R rows."""

    pos: np.ndarray  # of the base, world [m] (R, 3)
    quat: np.ndarray  # wxyz (R, 4)
    angles: np.ndarray  # of the arms [rad] (R, n_arm)
    ok: np.ndarray  # whether there is one (R,) bool


class Reach:
    """Inverse kinematics of a pair's arms, and what was reached so far."""

    def __init__(self, task: Task, robot: RobotSpec, rng: np.random.Generator):
        self.task, self.robot, self.rng = task, robot, rng
        self.scene = build_scene(task, robot)
        self.chains = _chains(self.scene)
        self.clearance = Clearance(task, robot)
        half_turn = robot.half_turns.get(task.name, 1.0)
        self.limits = [bullet_ik.limits_of(c, robot.half_range) for c in self.chains]
        self.solvers = [
            bullet_ik.Solver(c, limits, half_turn)
            for c, limits in zip(self.chains, self.limits, strict=True)
        ]
        self.endless = [np.isin(arm.joints, robot.endless) for arm in self.scene.arms]
        self.rest = [_posture(robot, c) for c in self.scene.arms]
        self.quats = [start_quat(task, robot, a, self.scene) for a in range(len(self.chains))]
        self.goals = goals_of(task, robot, len(self.chains))
        self.tried = self.reached = 0
        names = [g.link for goals in self.goals for g in goals]
        self.goals_reached = {} if robot.fixed_base(task) else dict.fromkeys(names, 0)

    # -- one goal ------------------------------------------------------------------------------

    def solve(
        self,
        arm: int,
        start: np.ndarray,
        pos: np.ndarray,
        quat: Quat | None,
        base_pos: np.ndarray,
        base_quat: np.ndarray,
        iterations: int,
        reached: float = REACHED,
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """One solution for each of N poses, from a random rest pose.

        Args:
            arm: which.
            start: angles that the iterations begin at [rad] (N, n).
            pos: wanted, world [m] (N, 3).
            quat: wanted, world, wxyz (4,), or None.
            base_pos: world [m] (N, 3).
            base_quat: wxyz (N, 4).
            iterations: at most.
            reached: least distance [m] that does not count as reached.

        Returns:
            angles within the limits [rad] (N, n), whether the pose is reached (N,), isotropy (N,).
        """
        limits, solver = self.limits[arm], self.solvers[arm]
        rest = self.rng.uniform(limits.lower, limits.upper, (len(pos), solver.n))
        rots = rotation_matrix(base_quat, np)
        local = np.einsum("nji,nj->ni", rots, pos - base_pos)
        turn = None
        if quat is not None:
            turn = np.einsum("nji,jk->nik", rots, rotation_matrix(np.array(quat), np))
        raw = solver.solve(start, rest, local, turn, iterations)
        q = np.clip(raw, limits.lower, limits.upper)
        tip, rot, jacobian = solver.forward(q.T)
        distance = np.linalg.norm(tip.T - local, axis=1)
        good = distance < reached
        if quat is not None:
            world = bullet_ik.bullet_quat(np.einsum("nij,jkn->ikn", rots, rot)).T
            apart = np.linalg.norm(world - np.array(quat), axis=1)
            # AG v0.1 util.py: np.isclose(apart, 2, atol=threshold)
            good &= (apart < REACHED_QUAT) | (np.abs(apart - 2) <= TURNED_QUAT + 2e-5)
        score = bullet_ik.isotropy(jacobian, raw.T, limits, self.endless[arm])
        return q, good, score

    # -- a row ---------------------------------------------------------------------------------

    def from_fixed_base(self, fixed: Pose, starts: np.ndarray) -> _Found:
        """The first solution that fits, each try beginning where the one before ended.

        Args:
            fixed: where the base stands, in the world.
            starts: of the hand, world [m] (R, n_arms, 3).
        """
        rows, reached = len(starts), self.robot.start_within.get(self.task.name, REACHED)
        pos, quat = (np.tile(np.array(x, float), (rows, 1)) for x in (fixed.pos, fixed.quat))
        angles = np.tile(np.concatenate(self.rest), (rows, 1))
        ok, left = np.zeros(rows, bool), np.arange(rows)
        for _ in range(FIXED_RESTARTS):
            q, good, _ = self.solve(
                0, angles[left], starts[left, 0], self.quats[0], pos[left], quat[left],
                FIXED_ITERATIONS, reached,
            )  # fmt: skip
            good &= [self._free(pos[i], quat[i], x) for i, x in zip(left, q, strict=True)]
            angles[left], ok[left] = q, good
            self.tried += len(left)
            left = left[~good]
            if not len(left):
                break
        self.reached = int(ok.sum())
        return _Found(pos, quat, angles, ok)

    def from_best_base(self, starts: np.ndarray, points: list[np.ndarray], attempts: int) -> _Found:
        """The best of ``attempts`` bases for each row; more where none of them has a start.

        Args:
            starts: of the hands, world [m] (R, n_arms, 3).
            points: of each arm, goals, world [m] (R, n_goals, 3).
            attempts: for each row.
        """
        rows, n = len(starts), sum(s.n for s in self.solvers)
        out = _Found(
            np.zeros((rows, 3)), np.zeros((rows, 4)), np.zeros((rows, n)), np.zeros(rows, bool)
        )
        left = np.arange(rows)
        for round_ in range(ROUNDS):
            who = np.repeat(left, attempts)
            pos, quat = self._bases(len(who))
            q, count, score = self._try(starts, points, who, pos, quat)
            count, score = count.reshape(-1, attempts), score.reshape(-1, attempts)
            rank = -1e3 * count - score
            if round_:  # AG stops at the first
                rank = np.where(count > 0, np.arange(attempts), np.inf)
            best = np.full(len(left), -1)
            for i, order in enumerate(
                np.argsort(rank, axis=1) + attempts * np.arange(len(left))[:, None]
            ):
                valid = (j for j in order if count.reshape(-1)[j] > 0)
                best[i] = next((j for j in valid if self._free(pos[j], quat[j], q[j])), -1)
            good = best >= 0
            to, of = left[good], best[good]
            out.pos[to], out.quat[to], out.angles[to], out.ok[to] = pos[of], quat[of], q[of], True
            left = left[~good]
            if not len(left):
                break
        return out

    def _try(
        self,
        starts: np.ndarray,
        points: list[np.ndarray],
        who: np.ndarray,
        pos: np.ndarray,
        quat: np.ndarray,
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Angles at the start (N, n), poses reached (N,), 0 for discarded bases, and the sum of isotropies (N,)."""
        angles, count, score = [], np.zeros(len(who)), np.zeros(len(who))
        alive = np.ones(len(who), bool)
        self.tried += len(who)

        def reach(
            arm: int, wanted: np.ndarray, turn: Quat | None
        ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
            at = np.flatnonzero(alive)
            begin = np.tile(self.rest[arm], (len(at), 1))
            q, good, value = self.solve(
                arm, begin, wanted[who[at]], turn, pos[at], quat[at], ITERATIONS
            )
            if len(angles) == len(
                self.solvers
            ):  # a goal, which the arm must not reach in the robot's body
                for i in np.flatnonzero(good):
                    arms = [q[i] if a == arm else x[at[i]] for a, x in enumerate(angles)]
                    place = Placement(pos[at[i]], quat[at[i]], np.concatenate(arms))  # pyrefly: ignore[bad-argument-type]
                    good[i] = self._outside_itself(place, 0.0)
            count[at] += good
            score[at] += np.where(good, value, 0.0)
            return at, q, good

        for arm, solver in enumerate(self.solvers):
            at, q, good = reach(arm, starts[:, arm], self.quats[arm])
            angles.append(np.zeros((len(who), solver.n)))
            angles[-1][at] = q
            alive[at] &= good
        self.reached += int(alive.sum())
        for arm, goals in enumerate(self.goals):
            for i, goal in enumerate(goals):
                turn = goal_quat(goal, self.quats[arm])
                at, _, good = reach(arm, points[arm][:, i], turn)
                if not goal.required:
                    self.goals_reached[goal.link] += int(good.sum())
                else:
                    alive[at] &= good
        return np.concatenate(angles, axis=1), np.where(alive, count, 0.0), score

    def _free(self, pos: np.ndarray, quat: np.ndarray, angles: np.ndarray) -> bool:
        """Whether the arms touch nothing."""
        place = Placement(pos, quat, angles)  # pyrefly: ignore[bad-argument-type]
        return self._outside_itself(place, CLEARANCE) and self.clearance.outside(place) > CLEARANCE

    def _outside_itself(self, place: Placement, apart: float) -> bool:
        """Whether the arms are ``apart`` [m] from the robot's own body; some are not kept from it in AG."""
        return self.robot.meets_itself or self.clearance.inside(place) > apart

    def _bases(self, n: int) -> tuple[np.ndarray, np.ndarray]:
        """Positions [m] (n, 3) and orientations wxyz (n, 4) of candidates."""
        area = self.robot.base_search(self.task.name)
        away = area.side * self.rng.uniform(0.0, area.spread, n)
        along = self.rng.uniform(-area.spread, area.spread, n)
        yaw = area.yaw + self.rng.uniform(-YAW, YAW, n)
        quat = axis_angle_quat(np.array([0.0, 0.0, 1.0]), yaw, np)
        placed = np.array(area.centre) + np.stack([away, along, np.zeros(n)], axis=1)
        return placed - rotation_matrix(quat, np) @ np.array(area.pivot), quat


def _mouths(reach: Reach, points: list[np.ndarray]) -> np.ndarray:
    """The mouth of each row's person, world [m] (R, 3).

    Raises:
        SpecError: no arm has a mouth to reach.
    """
    for goals, of_arm in zip(reach.goals, points, strict=True):
        for i, goal in enumerate(goals):
            if goal.link == "mouth" and not goal.above:
                return of_arm[:, i]
    raise SpecError(
        f"{reach.robot.name} asks for bases by the person's mouth (for_mouth), but {reach.task.name} has no goal there."
    )


def _posture(robot: RobotSpec, arm: Arm) -> np.ndarray:
    """Angles that the arm has before each solution is looked for [rad] (n,)."""
    return np.array([robot.rest.get(j, 0.0) for j in arm.joints])


def _chains(scene: Any) -> list[kinematics.Chain]:
    model, index = scene.model, scene.index
    chains = []
    for tool, arm in zip(index.tools, scene.arms, strict=True):
        site = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_SITE, f"robot/{arm.end_effector}")
        chains.append(kinematics.chain_of(model, tool.joints, site, index.robot_base))
    return chains


def _check_goals(task: Task, robot: RobotSpec, reach: Reach) -> None:
    """Raise SpecError if a goal is out of reach of every base."""
    if not reach.reached:
        return
    for name, hits in reach.goals_reached.items():
        if not hits:
            raise SpecError(
                f"No base of {robot.name} from which {task.name} can start reaches the goal {name!r} "
                f"({reach.tried} tried). Widen RobotSpec.searches[{task.name!r}] or change Task.goals."
            )


def _canonical(angles: np.ndarray, chains: list[kinematics.Chain]) -> np.ndarray:
    """Angles (R, n) [rad] with those of joints that turn freely in [-pi, pi)."""
    span = np.concatenate([c.upper - c.lower for c in chains])
    return np.where(span > 2 * np.pi + 3.5, (angles + np.pi) % (2 * np.pi) - np.pi, angles)
