"""How many itches can a robot touch at all, without pushing the person aside?

python -m benchmarks.reach --env-name ScratchItchBaxter-v0

Draws one of AG's two people in the typical pose, a row of the placement bank and an itch, as a reset
does, and looks with inverse kinematics from many starts for joint angles that put the tool's tip on
the skin within ``target_radius`` of the itch while no moving part of robot or tool is deeper than 4 mm
in person or furniture. A search that stops counts as unreachable: the figure is a lower bound, for an
arm that stays where it is (in an episode it yields).
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import tyro
from rich.progress import track

import agym_jax
from agym_jax.flags import Count
from agym_jax.human import pose
from agym_jax.human.body import RIGHT_ARM_LINKS
from agym_jax.offline import kinematics
from agym_jax.sim.scene import compose
from agym_jax.sim.validate import COLLISION
from agym_jax.spec import Pose
from benchmarks.keep import keep

DEEPEST = 0.004  # [m] that skin may yield
NEAR = 0.005  # [m] of remaining distance at which inverse kinematics has arrived


@dataclass(frozen=True)
class ReachConfig:
    """Flags of ``python -m benchmarks.reach``."""

    env_name: str = "ScratchItchJaco-v0"
    """Environment id of ScratchItch."""
    num_itches: Count = 400
    """Itches to draw."""
    starts: Count = 160
    """Starts of the inverse kinematics for each."""
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


class Searcher:
    """Reach of one environment's robot."""

    def __init__(self, env: Any, starts: int, rng: np.random.Generator):
        index = env.scene.index
        self.env, self.starts, self.rng, self.bank = env, starts, rng, env._bank
        tip = index.tools[0].tip
        chain = kinematics.chain_of(env.scene.model, index.robot_joint, tip, index.robot_base)
        self.low, self.high = env.scene.model.jnt_range[index.robot_joint].T
        tool = env.scene.model.geom_size[index.tools[0].geoms[0], 0]
        self.lift = float(tool) - 0.001  # of the tip over the skin: the tool's end is round

        def solve(angles: jax.Array, point: jax.Array) -> tuple:
            return kinematics.inverse(chain, angles, point, jnp.eye(3), weight=0.0, steps=80)

        self.solve = jax.jit(jax.vmap(solve, (0, None)))

    def can_touch(self) -> tuple[bool, float]:
        """Draw person, base and itch: whether it can be touched, and the itch's angle [rad]."""
        env, rng = self.env, self.rng
        sex, row = float(rng.integers(2)), int(rng.integers(len(self.bank.base_pos)))
        base_pos, base_quat = (
            np.asarray(x[row]) for x in (self.bank.base_pos, self.bank.base_quat)
        )
        base = Pose(tuple(base_pos.tolist()), tuple(base_quat.tolist()))
        model = compose(env.task, env.robot, sex=sex, base=base, solid=True)
        data = mujoco.MjData(model)
        joints = env.task.human.joints
        angles = pose.start_angles(pose.typical(env.task.human, sex), joints, 1.0, np)
        for name, angle in zip(joints, angles, strict=True):
            data.joint(f"human/{name}").qpos = angle
        mujoco.mj_kinematics(model, data)
        limb = f"human/{RIGHT_ARM_LINKS[rng.integers(2)]}"
        radius, half = model.geom(limb).size[:2]
        itch = itch_on((2 * half, radius), rng)
        local = around(itch, radius, env.task.config.target_radius)
        outward = local * [1, 1, 0] / radius
        turn = data.body(limb).xmat.reshape(3, 3)
        points = data.body(limb).xpos + (local + self.lift * outward) @ turn.T
        to_base = np.zeros(9)
        mujoco.mju_quat2Mat(to_base, base_quat)
        points = (points - base_pos) @ to_base.reshape(3, 3)
        return any(self._clear(model, data, row, p) for p in points), itch[1]

    def _clear(self, model: mujoco.MjModel, data: mujoco.MjData, row: int, point: Any) -> bool:
        n, count = len(self.low), self.starts
        near = np.asarray(self.bank.arm_angles[row]) + self.rng.normal(0, 0.5, (count // 2, n))
        low, high = np.maximum(self.low, -3.1), np.minimum(self.high, 3.1)
        far = self.rng.uniform(low, high, (count - count // 2, n))
        starts = np.clip(np.concatenate([near, far]), self.low, self.high).astype(np.float32)
        found, distance, _ = self.solve(jnp.asarray(starts), jnp.asarray(point, jnp.float32))
        found, distance = np.asarray(found), np.asarray(distance)
        names = [model.geom(i).name for i in range(model.ngeom)]
        moves = model.body_weldid[model.geom_bodyid] != 0
        robot = [
            i
            for i, name in enumerate(names)
            if name.startswith(("robot/", "tool")) and COLLISION in name and moves[i]
        ]
        rest = [i for i, name in enumerate(names) if name.startswith(("human/", "seat/"))]
        joints = [f"robot/{j}" for arm in self.env.scene.arms for j in arm.joints]
        for i in np.argsort(distance)[:40]:
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


def measure(config: ReachConfig) -> dict[str, Any]:
    """The fields of a result: how many itches can be touched, and how many of those near the trunk."""
    env = agym_jax.make(config.env_name, impl="jax")
    searcher = Searcher(env, config.starts, np.random.default_rng(config.seed))
    draws = [searcher.can_touch() for _ in track(range(config.num_itches), "itches")]
    ok, angle = (np.array(x) for x in zip(*draws, strict=True))
    inner = np.sin(angle) < -np.sqrt(0.5)  # the quarter that faces the trunk
    return {
        "env": config.env_name,
        "itches": config.num_itches,
        "reachable": float(ok.mean()),
        "reachable_inner": float(ok[inner].mean()),
        "reachable_other": float(ok[~inner].mean()),
    }


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; returns the exit status."""
    config = tyro.cli(ReachConfig, prog="python -m benchmarks.reach", args=arguments)
    return 2 if keep("reach", lambda: measure(config), config.json) is None else 0


if __name__ == "__main__":
    sys.exit(main())
