"""Where physics differs from Assistive Gym's: recorded episodes, played on here from their states.

    python benchmarks/states_in_assistive_gym.py BedBathingPR2-v0 POLICY STATES.npz    # in its own Python
    python -m benchmarks.played_on BedBathingPR2-v0 STATES.npz
    python -m benchmarks.played_on ArmManipulationSawyer-v0 STATES.npz --strength 0.5 --policy POLICY

From states of the episodes, the actions that follow are played here, from the same angles and speeds of robot and person. How far the
robot's joints then are from Assistive Gym's is shown by what touched what there meanwhile. With ``--policy``, the episodes are
also played from their starts with that policy, which acts by what it sees here. Runs on C MuJoCo. A state lacks what the
motors knew of the physics step before: an episode of our own, played on so, ends up to 0.02 rad off.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import jax
import numpy as np
import tyro

import agym_jax
from agym_jax.errors import ArgumentError
from agym_jax.flags import Count
from agym_jax.human.population import Population
from agym_jax.state import Episode, State
from agym_jax.variation import RobotVariation
from benchmarks.keep import keep
from benchmarks.recorded_episode import begin_as, episode_in_place, play_on, read_recorded

TOUCHES = 0.2  # mean normal force from which on it counts [N]
OFF = 0.03  # of what the robot sees at the start [m or rad]; a person's wrist may be clipped to its limits


@dataclass(frozen=True)
class PlayedOnConfig:
    """Flags of ``python -m benchmarks.played_on``."""

    env_name: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="ID")]
    """Environment id."""
    states: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="STATES")]
    """File of ``benchmarks/states_in_assistive_gym.py``."""
    steps: Count = 5
    """Control steps that are played from each state."""
    every: Count = 5
    """Control steps between states."""
    masses: str = "ag"
    """Of the people, see ``Population``."""
    strength: float = 1.0
    """Factor on the torque of the robot's motors; ArmManipulation's are 0.5 of ours in Assistive Gym."""
    policy: Path | None = None
    """Policy file for the episodes from their starts; None plays none."""
    json: Path | None = None
    """File to which the result is added as a JSON line."""


def episode_of(env: agym_jax.Env, states: dict[str, np.ndarray], i: int) -> Episode:
    """A recorded episode's robot base and person.

    Args:
        env: with ``impl="native"``.
        states: of the file.
        i: which episode.
    """
    place = {name: states[name][i] for name in ("base", "chest", "body")}
    person: dict[str, Any] = {name: states[name][i] for name in ("strength", "limit_scale")}
    person["tremor"] = states["tremor"][i][: len(env.scene.moving)]  # of joints that move here
    return episode_in_place(env, place, states["q"][i, 0], float(states["sex"][i]), **person)


def begin(env: agym_jax.Env, states: dict[str, np.ndarray], i: int) -> State:
    """The state in which a recorded episode begins.

    Raises:
        ArgumentError: the robot sees something else than in the recording.
    """
    key = jax.random.PRNGKey(0)
    state = begin_as(env, env.reset(key), episode_of(env, states, i), key)
    seen = states["obs"][i]
    off = np.abs(np.asarray(state.obs)[: len(seen)] - seen).max()
    if off > OFF:
        raise ArgumentError(
            f"The start of seed {states['seed'][i]} is off by {off:.3f} here: is it of another robot or task?"
        )
    return state


def played(
    env: agym_jax.Env, states: dict[str, np.ndarray], config: PlayedOnConfig
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Play on from every moment of every episode.

    Returns:
        how far each joint of the robot turned here and there [rad] (n, n_arm), (n, n_arm), and the mean normal forces there by
        the file's ``kinds`` [N] (n, 4).
    """
    here, there, forces = [], [], []
    for i in range(len(states["seed"])):
        episode = episode_of(env, states, i)
        for k in range(0, states["action"].shape[1] - config.steps + 1, config.every):
            start = {n: states[n][i, k] for n in ("q", "qd", "person_q", "person_qd")}
            after = play_on(env, episode, start, states["action"][i, k : k + config.steps])
            here.append(after - start["q"])
            there.append(states["q"][i, k + config.steps] - start["q"])
            forces.append(states["force"][i, k : k + config.steps + 1].mean(0))
        print(f"seed {states['seed'][i]} played on", file=sys.stderr)
    return np.array(here), np.array(there), np.array(forces)


def by_contact(
    here: np.ndarray, there: np.ndarray, forces: np.ndarray, kinds: Sequence[str]
) -> dict[str, Any]:
    """Medians of the joints that are farthest off, and that turned farthest there and here, by what touched what [rad].

    Args:
        here: from ``played``.
        there: from ``played``.
        forces: from ``played``.
        kinds: of the columns of ``forces``.
    """
    touches = forces > TOUCHES
    alone = touches.sum(1) == 1
    groups = {
        "nothing": ~touches.any(1),
        **{k: touches[:, c] & alone for c, k in enumerate(kinds)},
    }
    groups |= {"several": touches.sum(1) > 1}
    moved = {"off": here - there, "turned there": there, "turned here": here}
    farthest = {name: np.abs(x).max(-1) for name, x in moved.items()}
    return {
        kind: {
            "states": int(mine.sum()),
            **{name: round(float(np.median(x[mine])), 4) for name, x in farthest.items()},
        }
        for kind, mine in groups.items()
        if mine.any()
    }


def touching(states: dict[str, np.ndarray]) -> dict[str, dict[str, list[int]]]:
    """Control steps of each episode there in which something touches, by what and by how the episode ended."""
    ends = {"successes": states["success"], "failures": ~states["success"]}
    count = (states["force"][:, 1:] > TOUCHES).sum(1)
    return {
        str(kind): {end: count[mine, c].tolist() for end, mine in ends.items()}
        for c, kind in enumerate(states["kinds"])
    }


def measure(config: PlayedOnConfig) -> dict[str, Any]:
    """The fields of the result."""
    states = read_recorded(config.states, "benchmarks/states_in_assistive_gym.py")
    robot = RobotVariation(strength=(config.strength, config.strength))
    env = agym_jax.make(config.env_name, impl="native", humans=Population(masses=config.masses), robot=robot)  # fmt: skip
    begin(env, states, 0)  # before long work
    found: dict[str, Any] = {
        "episodes": len(states["seed"]),
        "seeds": states["seed"].tolist(),
        "there": int(states["success"].sum()),
    }
    if config.policy:
        policy = agym_jax.load_policy(config.policy)
        found["policy_commit"] = policy.info["commit"]
        here = [succeeds(env, begin(env, states, i), policy) for i in range(found["episodes"])]
        found |= {"here": sum(here), "both": int((np.array(here) & states["success"]).sum())}
    found["joint that turned farthest, rad"] = by_contact(
        *played(env, states, config), states["kinds"].tolist()
    )
    found["steps that touch there"] = touching(states)
    settings = {"env": config.env_name, "masses": config.masses, "strength": config.strength, "steps": config.steps}  # fmt: skip
    return settings | found


def succeeds(env: agym_jax.Env, state: State, policy: Any) -> bool:
    """Whether a policy succeeds in an episode."""
    for _ in range(env.episode_length):
        state = env.step(state, policy(state.obs))
    return bool(env.task.success(state.task))


def main(arguments: Sequence[str] | None = None) -> int:
    """Run from the command line."""
    config = tyro.cli(PlayedOnConfig, args=arguments, description=__doc__)
    return int(keep("played-on", lambda: measure(config), config.json) is None)


if __name__ == "__main__":
    sys.exit(main())
