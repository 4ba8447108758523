"""Do the largest forces on people have a cause? An account of every physics step in which they occur.

    python -m benchmarks.causes --only ArmManipulationJaco-v0 --num-episodes 1000 --json benchmarks/results/causes.jsonl

Plays episodes of a shipped policy on C MuJoCo, takes the control steps with the largest peak forces on the person once more, each
from the state before it, and accounts for the impulses on the robot's joints in each of their physics steps
(``agym_jax/sim/impulse.py``): is a force larger than what motors at their bound, limits and momentum give? A peak lasts one
physics step; over a control step it would be averaged out.
"""

from __future__ import annotations

import heapq
import itertools
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import jax
import numpy as np
import tyro
from rich.progress import track

from agym_jax.flags import Count
from agym_jax.human.regions import NAMES
from agym_jax.policy.files import find_policies, load_policies
from agym_jax.sim.impulse import Balance, watch
from benchmarks.keep import ShippedConfig, keep_of_shipped
from train.envs import make_env
from train.evaluation.evaluator import AT_ONCE, Evaluator


@dataclass(frozen=True)
class CausesConfig(ShippedConfig):
    """Flags of ``python -m benchmarks.causes``."""

    num_episodes: Count = 1000
    """Episodes of each; 64 run at a time."""
    steps: Count = 100
    """Control steps of each that are accounted for."""
    seed: int = 5001
    """Of the episodes."""


class Hardest:
    """The control steps with the largest peaks, each with the state before it.

    Args:
        count: how many of them.
        length: control steps of an episode; the last one's state is of the next episode, and does not count.
    """

    def __init__(self, count: int, length: int):
        self.count, self.length, self.seen = count, length, 0
        self.kept: list[tuple[float, int, int, Any]] = []  # peak [N], number, region, state
        self._numbers = itertools.count()  # two peaks may be equal, states have no order
        self._before: Any = None

    def __call__(self, state: Any) -> None:
        """Look at all environments, before the first step of a batch and after each step."""
        first = self.seen % (self.length + 1) == 0
        last = self.seen % (self.length + 1) == self.length
        if not first and not last:
            peaks = np.asarray(state.regions.peak)
            for row in np.argsort(-peaks.max(axis=1)):
                peak = float(peaks[row].max())
                if peak <= 0.0 or (len(self.kept) == self.count and peak <= self.kept[0][0]):
                    break
                before = jax.tree.map(lambda x, row=row: x[row], self._before)
                entry = (peak, next(self._numbers), int(peaks[row].argmax()), before)
                push = heapq.heappushpop if len(self.kept) == self.count else heapq.heappush
                push(self.kept, entry)
        self._before, self.seen = state, self.seen + 1


def summary(peaks: Sequence[float], steps: Sequence[Balance]) -> dict[str, Any]:
    """What the accounts say of the largest forces.

    Args:
        peaks: forces on a region of the person [N].
        steps: physics steps of the control steps that have them.

    Returns:
        ``peak`` and ``least_peak``, the largest and the smallest of them [N]; ``force``, the largest sum of normal forces on robot and tool in
        a physics step [N]; ``beyond``, by how much such a sum exceeds what motors, limits and momentum give, at most, as a share of
        it; ``lacks``, the torque that an account lacks, at most [N m], and ``lacks_of``, as a share of the largest torque of contacts in it.
    """
    touched = [x for x in steps if x.force > 0.0]
    return {
        "peak": round(max(peaks), 1),
        "least_peak": round(min(peaks), 1),
        "force": round(max(x.force for x in steps), 1),
        "beyond": round(max(max(x.force / x.possible - 1.0, 0.0) for x in touched), 4),
        "lacks": round(max(x.error for x in steps), 3),
        "lacks_of": round(max(x.error / max(np.abs(x.contacts).max(), x.bound) for x in steps), 4),
    }


def measure(env_name: str, config: CausesConfig) -> dict[str, Any]:
    """The fields of a result; where nobody was touched, ``steps`` is 0 and there is no account.

    Raises:
        AgymError: there is no such environment, or no policy that fits it.
    """
    env = make_env(env_name, "native")
    policy = load_policies(find_policies(env_name), env)
    hardest = Hardest(config.steps, env.episode_length)
    Evaluator(env, config.num_episodes, AT_ONCE)(
        policy, jax.random.PRNGKey(config.seed), watch=hardest
    )
    played = {
        "env": env_name, "impl": env.impl, "episodes": config.num_episodes, "seed": config.seed, "steps": len(hardest.kept),
    }  # fmt: skip
    if not hardest.kept:  # nobody was touched
        return played
    peaks, off = [], 0.0
    with watch(env.physics, each_physics_step=True) as account:
        for peak, _, _, before in track(hardest.kept, f"{env_name}, accounts"):
            again = env.step(before, policy(before.obs))
            peaks.append(float(np.max(again.regions.peak)))
            off = max(off, abs(peaks[-1] - peak) / peak)
    return {
        **played,
        "region": NAMES[max(hardest.kept)[2]],
        "replay_off": round(off, 4),
        **summary(peaks, account.steps),
    }


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; returns the exit status, 2 if something could not be measured."""
    config = tyro.cli(CausesConfig, prog="python -m benchmarks.causes", args=arguments)
    return keep_of_shipped("causes", config.only, lambda name: measure(name, config), config.json)


if __name__ == "__main__":
    sys.exit(main())
