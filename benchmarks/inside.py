"""Which parts of a robot or tool go into the person under a shipped policy without touching them?

    python -m benchmarks.inside --only Reaching --json benchmarks/results/inside.jsonl

Contact is simulated between some primitives only (deviation ``contacts``). Here episodes are played, and every fifth control step
is looked at in the scene in which everything has its collision shape: where a part is more than 4 mm inside the person and the
two are no pair of the simulation, it passes through. A cup is hollow and counts as full.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import jax
import mujoco
import numpy as np
import tyro
from rich.progress import track

from agym_jax.flags import Count
from agym_jax.policy.files import find_policies, load_policies
from agym_jax.sim.scene import compose
from agym_jax.spec import Pose
from benchmarks.keep import ShippedConfig, keep_of_shipped
from benchmarks.reach import DEEPEST, moving_parts
from train.envs import make_env

EVERY = 5
"""Control steps from one look to the next."""


@dataclass(frozen=True)
class InsideConfig(ShippedConfig):
    """Flags of ``python -m benchmarks.inside``."""

    num_episodes: Count = 5
    """Episodes of each."""
    seed: int = 0
    """Seed of the first episode; the next ones have the numbers after it."""


class Solid:
    """The scene of an episode in which robot, tool and person meet with all that they have.

    Args:
        env: with ``impl="native"``.
        episode: of a state.
    """

    def __init__(self, env: Any, episode: Any):
        human, place = episode.human, episode.placement
        (x, y, z), (qw, qx, qy, qz) = place.base_pos.tolist(), place.base_quat.tolist()
        simulated = env.physics.model
        self.model = model = compose(
            env.task, env.robot, env.active, float(human.sex), float(human.stature), float(human.girth),
            float(human.limit_scale), jax.tree.map(np.asarray, episode.pose), Pose((x, y, z), (qw, qx, qy, qz)),
            solid=True,
        )  # fmt: skip
        self.data = mujoco.MjData(model)
        self.names = [model.geom(i).name for i in range(model.ngeom)]
        model.geom_contype[:] = model.geom_margin[:] = model.geom_gap[:] = 0
        model.geom_contype[moving_parts(model)] = 1
        model.geom_conaffinity[:] = [name.startswith("human/") for name in self.names]
        model.body_contype[:] = model.body_conaffinity[:] = 1  # what any geom of a body has
        pairs = zip(simulated.pair_geom1, simulated.pair_geom2, strict=True)
        self.pairs = {frozenset(simulated.geom(i).name for i in pair) for pair in pairs}

    def passing(self, qpos: np.ndarray) -> Iterator[tuple[str, str, float]]:
        """Part, limb and depth [m] of what is inside without being a pair.

        Args:
            qpos: of the state (nq,).
        """
        self.data.qpos[:] = qpos
        mujoco.mj_kinematics(self.model, self.data)
        mujoco.mj_comPos(self.model, self.data)
        mujoco.mj_collision(self.model, self.data)
        contact = self.data.contact
        for pair, distance in zip(contact.geom, contact.dist, strict=True):
            names = {self.names[i] for i in pair}
            limbs = {x for x in names if x.startswith("human/")}
            if distance < -DEEPEST and len(limbs) == 1 and names not in self.pairs:
                (part,), (limb,) = names - limbs, limbs
                yield part, limb, float(-distance)


def measure(env_name: str, config: InsideConfig) -> dict[str, Any]:
    """The fields of a result.

    Raises:
        AgymError: there is no such environment, or no policy that fits it.
    """
    env = make_env(env_name, "native")
    policy = load_policies(find_policies(env_name), env)
    deepest: dict[tuple[str, str], float] = {}
    looks = found = 0
    for number in track(range(config.num_episodes), env_name):
        state = env.reset(jax.random.PRNGKey(config.seed + number))
        solid = Solid(env, state.episode)
        for step in range(1, env.episode_length):  # the last one begins nothing anew
            state = env.step(state, policy(state.obs))
            if step % EVERY:
                continue
            inside = list(solid.passing(np.asarray(state.data.qpos)))
            looks, found = looks + 1, found + bool(inside)
            for part, limb, depth in inside:
                deepest[part, limb] = max(depth, deepest.get((part, limb), 0.0))
    parts = sorted(deepest.items(), key=lambda x: -x[1])
    return {
        "env": env_name,
        "episodes": config.num_episodes,
        "share": found / looks,
        "parts": [[part, limb, round(depth, 4)] for (part, limb), depth in parts],
    }


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; returns the exit status, 2 if something could not be measured."""
    config = tyro.cli(InsideConfig, prog="python -m benchmarks.inside", args=arguments)
    return keep_of_shipped("inside", config.only, lambda name: measure(name, config), config.json)


if __name__ == "__main__":
    sys.exit(main())
