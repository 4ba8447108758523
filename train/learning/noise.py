"""The exploration noise over a run: bounds of its deviation, and how long it lasts.

A policy gradient lowers the noise as soon as it costs something, often before a rare success, such as the first
drop of water drunk, was seen: then it never is. A floor keeps the noise up in the first half of the run. Without an
end, the other half: a policy whose noise stays high lets the noise do part of the task (in ScratchItch, the strokes),
and its mode, which has none, does worse than its samples. A ceiling that falls makes the mean learn that part. Both are
for the Gaussian whose deviation is a parameter of its own ("normal").

Noise that is drawn anew at every step cancels itself: a motion that needs a second in one direction is hardly ever
tried. A share of it can be held for a whole rollout (``num_steps``). As in Hollenstein et al. 2024, "Colored noise in
PPO", the probability of an action is taken as if it were drawn alone.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ..configs import LearnConfig

FLOOR_FALLS = (0.5, 1.0)  # shares of the run between which the floor falls to 0
CEILING_FALLS = (0.4, 0.8)  # shares of the run between which the ceiling falls to ``noise_end``
Held = tuple[jax.Array, jax.Array]  # the key of the noise that lasts, and its share of the variance
LEAST = 1e-6  # deviation; below it there is no floor


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Noise:
    """The exploration noise of a run, each float32, () or (seeds,)."""

    floor: Any  # deviation; 0: none
    start: Any  # deviation from which the ceiling falls
    end: Any  # deviation of the ceiling at the end; 0: none
    hold: Any  # share of the variance that lasts for a rollout

    @classmethod
    def of(cls, config: LearnConfig) -> Noise:
        """Those of a configuration."""
        start = max(config.init_noise_std, config.noise_floor, config.noise_end)
        numbers = (config.noise_floor, start, config.noise_end, config.noise_hold)
        return cls(*(np.float32(x) for x in numbers))

    def at(self, progress: jax.Array) -> tuple[jax.Array, jax.Array]:
        """The least and the largest logarithm of the deviation after a share of the run, () each."""
        floor = self.floor * (1 - _between(progress, FLOOR_FALLS))
        low = jnp.log(jnp.maximum(floor, LEAST))
        fallen = _between(progress, CEILING_FALLS)
        falling = (1 - fallen) * jnp.log(self.start) + fallen * jnp.log(
            jnp.maximum(self.end, LEAST)
        )
        high = jnp.where((self.end > 0) & (fallen > 0), falling, jnp.inf)
        return jnp.minimum(low, high), high

    def keep(self, policy: Any, progress: jax.Array) -> Any:
        """A policy's parameters with its deviations within the bounds; those of another distribution as they are.

        Args:
            policy: parameters of the policy network.
            progress: share of the run that is made    ().
        """
        layers = policy["params"]
        if "std_logparam" not in layers:  # Brax's name
            return policy
        kept = {"log_value": jnp.clip(layers["std_logparam"]["log_value"], *self.at(progress))}
        return {**policy, "params": {**layers, "std_logparam": kept}}


def _between(progress: jax.Array, span: tuple[float, float]) -> jax.Array:
    """How much of a span of the run is over, 0 to 1 ()."""
    return jnp.clip((progress - span[0]) / (span[1] - span[0]), 0.0, 1.0)
