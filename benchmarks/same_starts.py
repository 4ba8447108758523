"""A policy of ScratchItch from the starts of episodes that were played in Assistive Gym.

    python benchmarks/in_assistive_gym.py ScratchItchBaxter-v0 POLICY --seed 7000 --starts STARTS.npz    # in its own Python
    python -m benchmarks.same_starts ScratchItchBaxter-v0 STARTS.npz
    python -m benchmarks.same_starts ScratchItchBaxter-v0 STARTS.npz --masses ag --friction 1.16

The arm's pose, the robot's base, the person with impairment, and the itch are those of the recorded episodes. Runs on C
MuJoCo. What differs then is physics alone.
"""

from __future__ import annotations

import dataclasses
import math
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import tyro

import agym_jax
from agym_jax.errors import ArgumentError
from agym_jax.human.population import Population
from agym_jax.math3d import quat_mul, rotation_matrix
from agym_jax.registry import parse
from agym_jax.sim.c_mujoco import NativePhysics
from agym_jax.state import Episode, State
from benchmarks.keep import keep
from benchmarks.recorded_episode import begin_as, episode_as, read_recorded

HELD = math.radians(20.0)
"""Largest turn of a tool in Assistive Gym's hand that counts as held [rad]."""
SEEN = [*range(7), *range(13, 29)]
"""Columns that are compared: all but those of the itch, which is set after the start, and of the force."""


@dataclass(frozen=True)
class StartsConfig:
    """Flags of ``python -m benchmarks.same_starts``."""

    env_name: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="ID")]
    """Environment id."""
    starts: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="STARTS")]
    """File of ``benchmarks/in_assistive_gym.py --starts``."""
    masses: str = "body"
    """Of the people, see ``Population``."""
    friction: float = 1.0
    """Factor on the friction of all contacts."""
    round_cone: bool = False
    """Round friction cones, as Bullet's, instead of pyramids."""
    json: Path | None = None
    """File to which the result is added as a JSON line."""


def begin(env: agym_jax.Env, start: dict[str, np.ndarray]) -> State:
    """The state in which a recorded episode begins; its base stands so that the arm is seen as it was recorded."""
    seen = start["obs"]
    person: dict[str, Any] = {n: start[n] for n in ("strength", "limit_scale", "tremor")}
    state = env.reset(jax.random.PRNGKey(0))

    def stand(drawn: Episode) -> State:
        episode = episode_as(env, seen[13:20], float(start["sex"]), drawn, **person)
        return begin_as(env, state, episode, jax.random.PRNGKey(0))

    def moved(state: State, **fields: Any) -> State:
        place = dataclasses.replace(state.episode.placement, **fields)
        return stand(dataclasses.replace(state.episode, placement=place))

    now = stand(state.episode)
    turn = rotation_matrix(jnp.asarray(seen[3:7])) @ rotation_matrix(now.obs[3:7]).T
    half = 0.5 * math.atan2(float(turn[1, 0]), float(turn[0, 0]))
    yaw = jnp.array([math.cos(half), 0.0, 0.0, math.sin(half)])
    now = moved(now, base_quat=quat_mul(yaw, now.episode.placement.base_quat))
    shift = (np.asarray(now.obs) - seen)[20:23] * (1.0, 1.0, 0.0)  # of the shoulder
    now = moved(now, base_pos=now.episode.placement.base_pos + jnp.asarray(shift, jnp.float32))
    off = np.abs((np.asarray(now.obs) - seen)[SEEN]).max()
    if off > 1e-3:
        raise ArgumentError(
            f"A start of the file is off by {off:.4f} here: is it of another robot?"
        )
    itch = {"on_forearm": start["on_forearm"], "target_limb": start["itch"]}
    itch = {name: jnp.asarray(value, jnp.float32) for name, value in itch.items()}
    obs = now.obs.at[7:13].set(seen[7:13])
    return now.replace(task=dataclasses.replace(now.task, **itch), obs=obs)


def measure(config: StartsConfig) -> dict[str, Any]:
    """Play the episodes; the fields of the result."""
    if parse(config.env_name).task.name != "ScratchItch":
        raise ArgumentError(f"{config.env_name}: starts are recorded of ScratchItch alone.")
    starts = read_recorded(config.starts, "benchmarks/in_assistive_gym.py --starts")
    env = agym_jax.make(config.env_name, impl="native", humans=Population(masses=config.masses))
    assert isinstance(env.physics, NativePhysics)
    model = env.physics.model
    model.pair_friction[:, :2] *= config.friction
    if config.round_cone:
        model.opt.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    policy = agym_jax.load_policy(config.env_name)
    here = []
    for i, seed in enumerate(starts["seed"]):
        state = begin(env, {name: values[i] for name, values in starts.items()})
        for _ in range(env.episode_length):
            state = env.step(state, policy(state.obs))
        here.append(bool(env.task.success(state.task)))
        there = "success" if starts["success"][i] else "failure"
        print(
            f"seed {seed}: {'success' if here[-1] else 'failure'} here, {there} there; the tool turned by {np.degrees(starts['turned'][i]):.0f} degrees there",
            file=sys.stderr,
        )
    here, there, held = np.array(here), starts["success"], starts["turned"] < HELD
    return {
        "env": config.env_name, "masses": config.masses, "friction": config.friction,
        "round_cone": config.round_cone, "episodes": len(here), "first_seed": int(starts["seed"][0]),
        "here": int(here.sum()), "there": int(there.sum()), "both": int((here & there).sum()),
        "held": int(held.sum()), "held_here": int(here[held].sum()), "held_there": int(there[held].sum()),
    }  # fmt: skip


def main(arguments: Sequence[str] | None = None) -> int:
    """Run from the command line."""
    config = tyro.cli(StartsConfig, args=arguments, description=__doc__)
    return int(keep("same-starts", lambda: measure(config), config.json) is None)


if __name__ == "__main__":
    sys.exit(main())
