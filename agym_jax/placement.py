"""Banks of start poses: where the robot stands and how its arm is bent when an episode begins.

Assistive Gym searches inverse kinematics (and, for robots on the floor, base poses) at every reset;
here thousands of problems are solved at once, offline, and a reset draws a row.

    python -m agym_jax.placement build ScratchItchJaco-v0

DEVIATION(start-free): start poses in which the robot or its tool would touch the person or the
seat are left out of the bank; AG starts with them.
"""

from __future__ import annotations

import argparse
import json
import sys
from functools import cache
from importlib.metadata import version
from pathlib import Path

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from agym_jax import kinematics
from agym_jax.assets import asset_root
from agym_jax.errors import AgymError, MissingPlacementError, SpecError
from agym_jax.scene import build_scene
from agym_jax.spec import RobotSpec, Task
from agym_jax.state import Placement

REACHED = 0.001
"""A pose counts as reached within this distance [m] (AG: 0.03) and REACHED_ROTATION [rad]."""
REACHED_ROTATION = 0.01
CLEARANCE = 0.005
"""Least distance [m] of robot and tool from person and seat at the start."""


def bank_path(task: Task, robot: RobotSpec) -> Path:
    """Where a pair's bank is kept."""
    return asset_root() / "placements" / f"{task.name}{robot.name}.npz"


@cache
def load_bank(task: Task, robot: RobotSpec) -> Placement:
    """The pair's placements, K rows.

    Raises:
        MissingPlacementError: nobody has built them; the message has the command that does.
    """
    path = bank_path(task, robot)
    if not path.is_file():
        raise MissingPlacementError(
            f"{task.name} with {robot.name} has no placement bank. Build it with: "
            f"python -m agym_jax.placement build {task.name}{robot.name}-v0"
        )
    with np.load(path, allow_pickle=False) as z:
        return Placement(z["base_pos"], z["base_quat"], z["arm_angles"])


def build_bank(
    task: Task, robot: RobotSpec, seed: int = 0, size: int = 1024, restarts: int = 32
) -> tuple[Placement, dict]:
    """Solve start poses for a pair and keep the free ones.

    Args:
        task: gives the hand's start position.
        robot: gives its orientation and the base.
        seed: of targets and restarts.
        size: rows to return, at most.
        restarts: random beginnings of the inverse kinematics for each target.

    Returns:
        the bank, and a report: how many targets were tried, reached and free.

    Raises:
        SpecError: the base is not fixed, or no start pose can be reached.
    """
    base = robot.bases.get(task.seat.name)
    if base is None:
        raise SpecError(f"{robot.name} has no base pose beside the {task.seat.name}.")
    if task.name not in robot.start_rotations:
        raise SpecError(f"{robot.name} has no start orientation for {task.name}.")
    scene = build_scene(task, robot)
    model, index = scene.model, scene.index
    site = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_SITE, f"robot/{scene.arm.end_effector}")
    chain = kinematics.chain_of(model, index.robot_joint, site, index.robot_base)
    base_rot = kinematics.rotation_matrix(np.array(base.quat))
    goal_rot = base_rot.T @ kinematics.rotation_matrix(np.array(robot.start_rotations[task.name]))
    n = int(1.5 * size)
    key_target, key_start = jax.random.split(jax.random.PRNGKey(seed))
    targets = jax.vmap(task.start)(jax.random.split(key_target, n))
    goals = (targets - jnp.array(base.pos)) @ base_rot
    low, high = np.maximum(chain.lower, -np.pi), np.minimum(chain.upper, np.pi)
    high = np.where(high < low + 0.5, chain.upper, high)
    starts = jax.random.uniform(key_start, (restarts, len(low)), minval=low, maxval=high)

    @jax.jit
    def solve(goals):
        one = lambda goal, start: kinematics.inverse(chain, start, goal, jnp.asarray(goal_rot))  # noqa: E731
        angles, distance, turn = jax.vmap(lambda g: jax.vmap(lambda s: one(g, s))(starts))(goals)
        ok = (distance < REACHED) & (turn < REACHED_ROTATION)
        score = jax.vmap(jax.vmap(lambda q: kinematics.isotropy(chain, q)))(angles)
        return angles, jnp.where(ok, score, -1.0)

    angles, scores = (np.asarray(x) for x in solve(goals))
    free = _Clearance(task, robot)
    rows, reached, tried = [], 0, 0
    for candidates, score in zip(angles, scores, strict=True):
        order = np.argsort(-score)
        order = order[score[order] > 0]
        reached += bool(len(order))
        best = next((candidates[i] for i in order[:8] if free(candidates[i]) > CLEARANCE), None)
        if best is not None:
            rows.append(best)
        tried += 1
        if len(rows) == size:
            break
    report = {"tried": tried, "reached": reached, "kept": len(rows)}
    if not rows:
        raise SpecError(f"No start pose of {task.name} can be reached by {robot.name}: {report}.")
    k = len(rows)
    tile = lambda x: jnp.tile(jnp.array(x, jnp.float32), (k, 1))  # noqa: E731
    angles = jnp.asarray(_unwind(np.array(rows, np.float32), chain))
    return Placement(tile(base.pos), tile(base.quat), angles), report


class _Clearance:
    """Least distance of the robot and its tool from person and seat, over both of AG's people."""

    def __init__(self, task: Task, robot: RobotSpec):
        scene = build_scene(task, robot)
        self.models = [(m, mujoco.MjData(m)) for m in (scene.model, scene.female)]
        self.index, self.pose = scene.index, task.person
        names = [scene.model.geom(i).name for i in range(scene.model.ngeom)]
        self.robot = [i for i, n in enumerate(names) if n.startswith(("robot/", "tool/"))]
        self.rest = [i for i, n in enumerate(names) if n.startswith(("person/", "seat/"))]

    def __call__(self, angles: np.ndarray) -> float:
        nearest = np.inf
        for model, data in self.models:
            data.qpos[self.index.robot_qpos] = angles
            data.qpos[self.index.person_qpos] = [
                self.pose.pose.get(j, 0.0) for j in self.pose.joints
            ]
            mujoco.mj_kinematics(model, data)
            for a in self.robot:
                for b in self.rest:
                    nearest = min(nearest, mujoco.mj_geomDistance(model, data, a, b, 0.1, None))
                    if nearest < CLEARANCE:
                        return nearest
        return nearest


def _unwind(angles: np.ndarray, chain: kinematics.Chain) -> np.ndarray:
    """Bring joints that turn freely to within pi of the bank's mean direction, and that to (-pi, pi].

    Args:
        angles: (K, n) [rad].
        chain: for the limits.
    """
    free = chain.upper - chain.lower > 2 * np.pi + 0.1
    mean = np.arctan2(np.sin(angles).mean(0), np.cos(angles).mean(0))
    near = mean + (angles - mean + np.pi) % (2 * np.pi) - np.pi
    return np.where(free, near, angles).astype(np.float32)


def save_bank(bank: Placement, path: Path, provenance: dict) -> None:
    """Write a bank without pickle, with where it came from."""
    path.parent.mkdir(parents=True, exist_ok=True)
    np.savez_compressed(
        path, base_pos=bank.base_pos, base_quat=bank.base_quat, arm_angles=bank.arm_angles,
        provenance=np.array(json.dumps(provenance)),
    )  # fmt: skip


def main(argv: list[str] | None = None) -> int:
    """Command line: build banks."""
    from agym_jax.registry import parse

    parser = argparse.ArgumentParser(prog="python -m agym_jax.placement", description=__doc__)
    build = parser.add_subparsers(required=True).add_parser("build", help="build a pair's bank")
    build.add_argument("ids", nargs="+", help="environment ids, such as ScratchItchJaco-v0")
    build.add_argument("--seed", type=int, default=0)
    build.add_argument("--size", type=int, default=1024)
    args = parser.parse_args(argv)
    try:
        for name in args.ids:
            recipe = parse(name)
            bank, report = build_bank(recipe.task, recipe.robot, args.seed, args.size)
            provenance = {
                **report, "seed": args.seed, "size": args.size, "versions":
                {p: version(p) for p in ("mujoco", "jax")}, "command": f"build {name}",
            }  # fmt: skip
            path = bank_path(recipe.task, recipe.robot)
            save_bank(bank, path, provenance)
            print(f"{name}: {report['kept']} start poses of {report['tried']} tried -> {path.name}")
    except AgymError as error:
        print(error, file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
