"""What an evaluation found: sums over each environment's first episode, and the result that they make."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ..learning.rollout import FORCE_KEY


def wilson_interval(successes: int, trials: int, z: float = 1.959964) -> tuple[float, float]:
    """Wilson's interval of a probability.

    Args:
        successes: how often it happened.
        trials: out of how many.
        z: quantile of the normal distribution; the default gives 95 %.

    Returns:
        Lower and upper end; (0, 1) without trials.
    """
    if trials == 0:
        return 0.0, 1.0
    share, weight = successes / trials, z * z / trials
    centre = (share + weight / 2) / (1 + weight)
    half = z / (1 + weight) * math.sqrt(share * (1 - share) / trials + weight / (4 * trials))
    return max(0.0, centre - half), min(1.0, centre + half)


@dataclass(frozen=True)
class EvaluationResult:
    """What an evaluation found; arrays have one entry an episode.

    Attributes:
        env: environment id.
        returns: return of the episode.
        forces: mean over its steps of the force on the person [N].
        successes: whether the task was done at its last step.
        nan: whether it ended because the physics went non-finite.
        overflow: steps in which the physics lost contacts, all episodes.
        seconds: time of the rollout, compiling included.
    """

    env: str
    returns: np.ndarray
    forces: np.ndarray
    successes: np.ndarray
    nan: np.ndarray
    overflow: int
    seconds: float

    @property
    def episodes(self) -> int:
        """Number of episodes."""
        return len(self.returns)

    @property
    def success(self) -> float:
        """Share of episodes that succeeded."""
        return float(np.mean(self.successes))

    @property
    def success_interval(self) -> tuple[float, float]:
        """Its 95 % Wilson interval."""
        return wilson_interval(int(np.sum(self.successes)), self.episodes)

    def table(self) -> str:
        """The result for people."""
        low, high = self.success_interval
        rows = [
            ("return", f"{self.returns.mean():9.2f} ± {self.returns.std():.2f}"),
            ("force on the person [N]", f"{self.forces.mean():9.2f} ± {self.forces.std():.2f}"),
            ("success", f"{self.success:9.1%}   95 % interval {low:.1%} to {high:.1%}"),
            ("episodes that went NaN", f"{int(self.nan.sum()):9d}"),
        ]
        if self.overflow:
            rows.append(("steps with lost contacts", f"{self.overflow:9d}   do not trust these"))
        head = f"{self.env}, {self.episodes} episodes"
        return "\n".join([head] + [f"  {name:<24}{value}" for name, value in rows])

    def summary(self) -> dict[str, Any]:
        """The result for a JSON line."""
        low, high = self.success_interval
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
            "nan_episodes": int(self.nan.sum()),
            "overflow": self.overflow,
            "seconds": round(self.seconds, 2),
        }


def zero_sums(num_envs: int) -> dict[str, jax.Array]:
    """What ``add_step`` adds to: one entry an environment."""
    names = ("return", "force", "length", "success", "nan", "overflow")
    return dict.fromkeys(names, jnp.zeros(num_envs, jnp.float32))


def add_step(
    going: jax.Array, sums: dict[str, jax.Array], state: Any
) -> tuple[jax.Array, dict[str, jax.Array]]:
    """Add one step to the sums over the first episode of each environment.

    Args:
        going: 1 in the environments whose first episode had not ended before the step    (B,).
        sums: so far.
        state: of all environments after the step.

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
    }
    # not a product: what comes after a failure may not be finite
    sums = {name: sums[name] + jnp.where(going > 0, gain, 0.0) for name, gain in gains.items()}
    return going * (1 - state.done), sums


def result_of(env_name: str, sums: Mapping[str, Any], seconds: float) -> EvaluationResult:
    """The result that the sums of all steps make."""
    sums = {name: np.asarray(value) for name, value in sums.items()}
    return EvaluationResult(
        env=env_name,
        returns=sums["return"],
        forces=sums["force"] / np.maximum(sums["length"], 1),
        successes=sums["success"] > 0.5,
        nan=sums["nan"] > 0,
        overflow=int(sums["overflow"].sum()),
        seconds=seconds,
    )
