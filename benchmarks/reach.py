"""How many itches, or mouths, can a robot reach at all, without pushing the person aside?

    python -m benchmarks.reach --env-name ScratchItchBaxter-v0
    python -m benchmarks.reach --env-name ReachingPR2-v0
    python -m benchmarks.reach --env-name DrinkingPR2-v0

ScratchItch: draws one of AG's two people in the typical pose, a row of the placement bank and an itch, as a reset
does. Reaching: the people, heads and bases of resets. Looks with inverse kinematics from many starts for joint angles
that put the tool's tip on the skin within ``target_radius`` of the itch, or the hand within ``reached`` of the mouth, or the cup where policies
pour (Drinking: ``TIPPED`` from the vertical in any direction, its rim in ``RIM`` around the mouth), while
no moving part of robot or tool is deeper than 4 mm in person or furniture. A search that stops counts as
unreachable: the figure is a lower bound, for a body that stays where it is (in an episode an arm yields, and a contact
gives way).
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import tyro
from rich.progress import track
from scipy.spatial.transform import Rotation

import agym_jax
from agym_jax.errors import ArgumentError
from agym_jax.flags import Count
from agym_jax.human import pose
from agym_jax.human.body import RIGHT_ARM_LINKS
from agym_jax.offline import kinematics
from agym_jax.sim.scene import compose
from agym_jax.sim.validate import COLLISION
from agym_jax.spec import Pose
from agym_jax.tasks import drinking
from benchmarks.keep import keep

DEEPEST = 0.004
"""How far skin may yield; what is deeper is inside the person [m]."""
NEAR = 0.003  # [m] of remaining distance at which inverse kinematics has arrived
TURNED = 0.03  # [rad] the same of the remaining rotation, where it matters
TIPPED = (1.55, 1.75)
"""Angles of the cup's axis from the vertical at which a cup is emptied [rad]. In the 46 of 80 episodes of DrinkingPR2 (seeds 3001 to 3080) that
succeed, the cup was tipped by 1.58 to 1.72 rad at most until three quarters of the water were drunk (counted by a program outside the repository)."""
RIM = ((-0.03, 0.016), (-0.04, -0.005), (0.025, 0.052))
"""Where the centre of its rim was while people drank, from the mouth, world axes [m]: 5 and 95 % of each coordinate."""


@dataclass(frozen=True)
class ReachConfig:
    """Flags of ``python -m benchmarks.reach``."""

    env_name: str = "ScratchItchJaco-v0"
    """Environment id of ScratchItch, Reaching or Drinking."""
    num_targets: Count = 400
    """Itches or mouths to draw."""
    starts: Count = 400
    """Starts of the inverse kinematics for each, spread over the points that will do."""
    seed: int = 0
    """Of everything drawn."""
    json: Path | None = None
    """File to which the result is added as a JSON line."""


def itch_on(limb: tuple[float, float], rng: np.random.Generator) -> tuple[float, float]:
    """Place of an itch on a limb (length, radius): along it [m], and around it [rad]."""
    length, radius = limb
    return radius + (length - radius) * rng.random(), 2 * np.pi * rng.random()


def around(itch: tuple[float, float], radius: float, reach: float) -> np.ndarray:
    """Points of the skin (n, 3) in the limb's frame, at and around an itch, within ``reach`` [m]."""
    along, angle = itch
    offsets = reach * np.array([[0, 0], [1, 0], [-1, 0], [0, 1], [0, -1]]) * 0.9
    turn, s = angle + offsets[:, 1] / radius, along + offsets[:, 0]
    return np.stack([-radius * np.sin(turn), -radius * np.cos(turn), -s], axis=-1)


def moving_parts(model: mujoco.MjModel) -> list[int]:
    """Collision geoms of robot and tools that move."""
    moves = model.body_weldid[model.geom_bodyid] != 0
    names = ((i, model.geom(i).name) for i in range(model.ngeom))
    return [i for i, x in names if moves[i] and x.startswith(("robot/", "tool")) and COLLISION in x]


class Searcher:
    """Reach of one environment's robot.

    Args:
        env: the environment.
        starts: of the inverse kinematics for each target.
        rng: of everything drawn.
    """

    def __init__(self, env: Any, starts: int, rng: np.random.Generator):
        index = env.scene.index
        self.env, self.starts, self.rng = env, starts, rng
        tip = index.tools[0].tip
        chain = kinematics.chain_of(env.scene.model, index.robot_joint, tip, index.robot_base)
        self.chain = chain
        self.low, self.high = env.scene.model.jnt_range[index.robot_joint].T

        def solve(angles: jax.Array, point: jax.Array, turn: jax.Array, weight: float) -> tuple:
            return kinematics.inverse(chain, angles, point, turn, weight=weight, steps=80)

        self.solve = jax.jit(jax.vmap(solve, (0, 0, 0, None)))

    def scene(self, sex: float, base: Pose, angles: Any) -> tuple[mujoco.MjModel, mujoco.MjData]:
        """Person, robot and furniture.

        Args:
            sex: of the person, 0 or 1.
            base: of the robot.
            angles: of the person's moving joints [rad].
        """
        env = self.env
        model = compose(env.task, env.robot, sex=sex, base=base, solid=True)
        data = mujoco.MjData(model)
        for name, angle in zip(env.task.human.joints, angles, strict=True):
            data.joint(f"human/{name}").qpos = angle
        mujoco.mj_kinematics(model, data)
        return model, data

    def can_reach(
        self, model: mujoco.MjModel, data: mujoco.MjData, base: Pose, near: Any, points: np.ndarray,
        turns: np.ndarray | None = None,
    ) -> bool:  # fmt: skip
        """Whether the tip gets to one of some points, each tried from one start.

        Args:
            model: from ``scene``.
            data: from ``scene``.
            base: of the robot.
            near: angles of the arm around which half of the starts are [rad] (n_arm,).
            points: world [m] (starts, 3).
            turns: of the tip there, rotation matrices in the world (starts, 3, 3); any if left out.
        """
        to_base = np.zeros(9)
        mujoco.mju_quat2Mat(to_base, base.quat)
        to_base = to_base.reshape(3, 3)
        points = (points - base.pos) @ to_base
        n, count = len(self.low), len(points)
        weight = 0.0 if turns is None else 0.3
        turns = np.tile(np.eye(3), (count, 1, 1)) if turns is None else to_base.T @ turns
        starts = np.asarray(near) + self.rng.normal(0, 0.5, (count, n))
        low, high = np.maximum(self.low, -3.1), np.minimum(self.high, 3.1)
        far = self.rng.random(count) < 0.5
        starts[far] = self.rng.uniform(low, high, (int(far.sum()), n))
        starts = np.clip(starts, self.low, self.high).astype(np.float32)
        targets = (jnp.asarray(x, jnp.float32) for x in (points, turns))
        found, distance, rotation = map(
            np.asarray, self.solve(jnp.asarray(starts), *targets, weight)
        )
        distance = np.where((rotation > TURNED) & (weight > 0), np.inf, distance)
        robot = moving_parts(model)
        rest = [i for i in range(model.ngeom) if model.geom(i).name.startswith(("human/", "seat/"))]
        joints = [f"robot/{j}" for arm in self.env.scene.arms for j in arm.joints]
        for i in np.argsort(distance):
            if distance[i] > NEAR:
                return False
            for name, angle in zip(joints, found[i], strict=True):
                data.joint(name).qpos = angle
            mujoco.mj_kinematics(model, data)
            gaps = (
                mujoco.mj_geomDistance(model, data, a, b, 0.05, None) for a in robot for b in rest
            )
            if all(gap > -DEEPEST for gap in gaps):
                return True
        return False


def itch(searcher: Searcher) -> tuple[bool, str]:
    """Draw person, base and itch: whether it can be touched, and whether it is on the quarter that faces the trunk."""
    env, rng = searcher.env, searcher.rng
    sex, row = float(rng.integers(2)), int(rng.integers(len(env._starts.bank.base_pos)))
    base = _pose(env._starts.bank.base_pos[row], env._starts.bank.base_quat[row])
    joints = env.task.human.joints
    angles = pose.start_angles(pose.typical(env.task.human, sex), joints, 1.0, np)
    model, data = searcher.scene(sex, base, angles)
    limb = f"human/{RIGHT_ARM_LINKS[rng.integers(2)]}"
    radius, half = model.geom(limb).size[:2]
    place = itch_on((2 * half, radius), rng)
    local = around(place, radius, env.task.config.target_radius)
    tool = env.scene.model.geom_size[env.scene.index.tools[0].geoms[0], 0]
    lift = float(tool) - 0.001  # of the tip over the skin: the tool's end is round
    outward = local * [1, 1, 0] / radius
    turn = data.body(limb).xmat.reshape(3, 3)
    points = data.body(limb).xpos + (local + lift * outward) @ turn.T
    points = points[np.arange(searcher.starts) % len(points)]
    reachable = searcher.can_reach(model, data, base, env._starts.bank.arm_angles[row], points)
    return reachable, "inner" if np.sin(place[1]) < -np.sqrt(0.5) else "other"


def mouth(searcher: Searcher) -> tuple[bool, str]:
    """Draw the start of an episode: whether the hand gets near the mouth, and whose it is."""

    def near(rng: np.random.Generator) -> tuple[np.ndarray, None]:
        ways = rng.normal(size=(searcher.starts, 3))
        ways /= np.linalg.norm(ways, axis=1, keepdims=True)
        reach = searcher.env.task.config.reached - NEAR
        return reach * rng.random((searcher.starts, 1)) ** (1 / 3) * ways, None

    return _at_mouth(searcher, near)


def pour(searcher: Searcher) -> tuple[bool, str]:
    """Draw the start of an episode: whether the cup can be held where policies pour, and who would drink."""

    def above(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
        turns, (low, high) = tipped_cups(searcher.starts, rng), np.transpose(RIM)
        rim = rng.uniform(low, high, (searcher.starts, 3))
        return rim - drinking.TOP * turns[:, :, 1], turns

    return _at_mouth(searcher, above)


def _at_mouth(searcher: Searcher, draw: Callable[[np.random.Generator], tuple]) -> tuple[bool, str]:
    """Draw the start of an episode: whether the tip gets to its mouth, and whose that is.

    Args:
        searcher: of the environment.
        draw: gives points from the mouth, world axes [m] (starts, 3), and how the tip is to be turned there, see ``can_reach``.
    """
    env, rng = searcher.env, searcher.rng
    state = env.reset(jax.random.PRNGKey(rng.integers(2**31)))
    placement, sex = state.episode.placement, float(state.episode.human.sex)
    base = _pose(placement.base_pos, placement.base_quat)
    model, data = searcher.scene(sex, base, np.asarray(state.episode.human_angles))
    away, turns = draw(rng)
    points = np.asarray(state.task.mouth_pos_w) + away
    reachable = searcher.can_reach(model, data, base, placement.arm_angles, points, turns)
    return reachable, "men" if sex < 0.5 else "women"


def tipped_cups(count: int, rng: np.random.Generator) -> np.ndarray:
    """Orientations of a cup, whose axis is its y axis, tipped by ``TIPPED`` in any direction and turned about its axis (count, 3, 3)."""
    turn = 2 * np.pi
    about, towards, tilt = rng.uniform((0, 0, TIPPED[0]), (turn, turn, TIPPED[1]), (count, 3)).T
    upright = Rotation.from_euler("XY", np.stack([np.full(count, np.pi / 2), about], axis=-1))
    return (Rotation.from_euler("ZY", np.stack([towards, tilt], axis=-1)) * upright).as_matrix()


TARGETS = {"ScratchItch": itch, "Reaching": mouth, "Drinking": pour}
"""Task -> what draws a target and says whether it can be reached, and of which kind it is."""


def _pose(pos: Any, quat: Any) -> Pose:
    return Pose(tuple(np.asarray(pos, float).tolist()), tuple(np.asarray(quat, float).tolist()))


def measure(config: ReachConfig) -> dict[str, Any]:
    """The fields of a result: how many targets can be reached, of each kind.

    Raises:
        ArgumentError: it is another task.
        AgymError: there is no such environment.
    """
    env = agym_jax.make(config.env_name, impl="native")
    task = env.task.name
    if task not in TARGETS:
        raise ArgumentError(f"Reach is measured in {', '.join(TARGETS)}, not in {task}.")
    searcher = Searcher(env, config.starts, np.random.default_rng(config.seed))
    found: dict[str, list[bool]] = {}
    for _ in track(range(config.num_targets), "targets"):
        reachable, kind = TARGETS[task](searcher)
        found.setdefault(kind, []).append(reachable)
    return {
        "env": config.env_name,
        "targets": config.num_targets,
        "starts": config.starts,
        "reachable": float(np.mean([x for kind in found.values() for x in kind])),
        **{f"reachable_{kind}": float(np.mean(x)) for kind, x in sorted(found.items())},
    }


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; returns the exit status."""
    config = tyro.cli(ReachConfig, prog="python -m benchmarks.reach", args=arguments)
    return 2 if keep("reach", lambda: measure(config), config.json) is None else 0


if __name__ == "__main__":
    sys.exit(main())
