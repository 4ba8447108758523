"""Results of an evaluation: sums over each environment's first episode, and the result computed from them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ..learning.rollout import FORCE_KEY
from .gentleness import (
    MAXIMA,
    Gentleness,
    gentleness_gains,
    gentleness_of,
    zero_gentleness,
)
from .outcome import UNDONE, Outcome, outcome_gains, outcome_of, zero_outcome
from .people import Group, People, by_group, group_rows, people_of, worst


def wilson_interval(successes: int, trials: int, z: float = 1.959964) -> tuple[float, float]:
    """Compute the Wilson interval of a probability.

    Args:
        successes: number of successes.
        trials: number of trials.
        z: quantile of the normal distribution; the default gives 95 %.

    Returns:
        Lower and upper bound; (0, 1) without trials.
    """
    if trials == 0:
        return 0.0, 1.0
    share, weight = successes / trials, z * z / trials
    centre = (share + weight / 2) / (1 + weight)
    half = z / (1 + weight) * math.sqrt(share * (1 - share) / trials + weight / (4 * trials))
    return max(0.0, centre - half), min(1.0, centre + half)


@dataclass(frozen=True)
class EvaluationResult:
    """Results of an evaluation; arrays have one entry per episode.

    Attributes:
        env: environment id.
        returns: return of the episode.
        forces: force on the person, mean over the steps of the episode [N].
        successes: whether the task was done at the last step.
        nan: whether the episode ended because the physics became non-finite.
        overflow: number of steps in which the physics lost contacts, over all episodes.
        seconds: duration of the rollout, including compilation.
        gentleness: peak forces, and steps above limits; None if the environment does not measure them.
        outcome: progress of the task in its own units, and when it was done.
        people: the people who were helped; None if the environment does not report them.
    """

    env: str
    returns: np.ndarray
    forces: np.ndarray
    successes: np.ndarray
    nan: np.ndarray
    overflow: int
    seconds: float
    gentleness: Gentleness | None = None
    outcome: Outcome | None = None
    people: People | None = None

    @property
    def episodes(self) -> int:
        """Number of episodes."""
        return len(self.returns)

    @property
    def success(self) -> float:
        """Success rate of the episodes."""
        return float(np.mean(self.successes))

    @property
    def success_interval(self) -> tuple[float, float]:
        """95 % Wilson interval of the success rate."""
        return wilson_interval(int(np.sum(self.successes)), self.episodes)

    @property
    def gentle_successes(self) -> np.ndarray | None:
        """Whether the task was done with no step above the comfort limit (episodes,)."""
        return None if self.gentleness is None else self.successes & self.gentleness.kept

    @property
    def gentle_success(self) -> float | None:
        """Rate of gentle success; None if it is not measured."""
        return None if self.gentle_successes is None else float(np.mean(self.gentle_successes))

    @property
    def groups(self) -> list[Group]:
        """Success by sex, impairment and size of the person; empty if the environment does not report them."""
        if self.people is None:
            return []
        return by_group(self.people, self.successes, self.gentle_successes)

    @property
    def least_helped(self) -> Group | None:
        """The group with the lowest success; None if no group has enough episodes."""
        return worst(self.groups)

    def table(self, groups: bool = False) -> str:
        """Format the result as a table.

        Args:
            groups: also include the success of each group of people.
        """
        low, high = self.success_interval
        rows = [
            ("return", f"{self.returns.mean():9.2f} ± {self.returns.std():.2f}"),
            ("force on the person [N]", f"{self.forces.mean():9.2f} ± {self.forces.std():.2f}"),
            ("success", f"{self.success:9.1%}   95 % interval {low:.1%} to {high:.1%}"),
        ]
        gentle = self.gentle_successes
        if self.gentleness is not None and gentle is not None:
            low, high = wilson_interval(int(gentle.sum()), self.episodes)
            interval = f"{gentle.mean():9.1%}   95 % interval {low:.1%} to {high:.1%}"
            rows += [("gentle success", interval), *self.gentleness.rows()]
        if self.outcome is not None:
            rows += self.outcome.rows()
        least = self.least_helped
        if groups:
            rows += group_rows(self.groups)
        elif least:
            rows.append(("least helped", f"{group_rows([least])[0][1]}: {least.name}"))
        rows.append(("episodes that went NaN", f"{int(self.nan.sum()):9d}"))
        if self.overflow:
            rows.append(("steps with lost contacts", f"{self.overflow:9d}   do not trust these"))
        head = f"{self.env}, {self.episodes} episodes"
        return "\n".join([head] + [f"  {name:<24}{value}" for name, value in rows])

    def summary(self) -> dict[str, Any]:
        """Return the result as fields of a JSON line."""
        low, high = self.success_interval
        gentle = {}
        if self.gentleness is not None and self.gentle_successes is not None:
            ends = wilson_interval(int(self.gentle_successes.sum()), self.episodes)
            gentle = {
                "gentle_success": self.gentle_success,
                "gentle_success_low": ends[0],
                "gentle_success_high": ends[1],
                **self.gentleness.summary(),
            }
        return {
            "env": self.env,
            "episodes": self.episodes,
            "return_mean": float(self.returns.mean()),
            "return_std": float(self.returns.std()),
            "force_mean": float(self.forces.mean()),
            "force_std": float(self.forces.std()),
            "success": self.success,
            "success_low": low,
            "success_high": high,
            **gentle,
            **({} if self.outcome is None else self.outcome.summary()),
            **({} if self.people is None else {"groups": [vars(x) for x in self.groups]}),
            "nan_episodes": int(self.nan.sum()),
            "overflow": self.overflow,
            "seconds": round(self.seconds, 2),
        }


def zero_sums(first: Any, num_envs: int) -> dict[str, jax.Array]:
    """Return initial sums for ``add_step``, with one entry per environment.

    Args:
        first: states of the environments before the first step.
        num_envs: number of environments.
    """
    names = ("return", "force", "length", "success", "nan", "overflow")
    zeros = jnp.zeros(num_envs, jnp.float32)
    sums = dict.fromkeys(names, zeros) | zero_outcome(first, zeros)
    return sums | zero_gentleness(first, num_envs)


def add_step(
    going: jax.Array, sums: dict[str, jax.Array], state: Any
) -> tuple[jax.Array, dict[str, jax.Array]]:
    """Add one step to the sums over the first episode of each environment.

    Args:
        going: 1 in the environments whose first episode had not ended before the step    (B,).
        sums: sums so far.
        state: state of all environments after the step.

    Returns:
        ``going`` and ``sums`` after the step.
    """
    zero, metrics = jnp.zeros_like(going), state.metrics
    gains = {
        "return": state.reward,
        "force": metrics.get(FORCE_KEY, zero),
        "length": zero + 1,
        "success": metrics.get("success", zero) * state.done,
        "nan": metrics.get("nan", zero),
        "overflow": metrics.get("overflow", zero),
        **outcome_gains(state, sums["length"] + 1),
        **gentleness_gains(state),
    }

    def joined(name: str, gain: jax.Array) -> jax.Array:
        total = sums[name]
        # not a product: what comes after a failure may not be finite
        gain = jnp.where(jnp.expand_dims(going, range(1, total.ndim)) > 0, gain, 0.0)
        return jnp.maximum(total, gain) if name in (*MAXIMA, UNDONE) else total + gain

    return going * (1 - state.done), {name: joined(name, gain) for name, gain in gains.items()}


def result_of(env: Any, sums: Mapping[str, Any], seconds: float) -> EvaluationResult:
    """Compute the result of an environment from the sums over all steps."""
    sums = {name: np.asarray(value) for name, value in sums.items()}
    successes = sums["success"] > 0.5
    return EvaluationResult(
        env=env.name,
        returns=sums["return"],
        forces=sums["force"] / np.maximum(sums["length"], 1),
        successes=successes,
        nan=sums["nan"] > 0,
        overflow=int(sums["overflow"].sum()),
        seconds=seconds,
        gentleness=gentleness_of(sums, getattr(env, "comfort", None)),
        outcome=outcome_of(env, sums, successes),
        people=people_of(sums),
    )
