"""PPO: rollouts, updates and the agents that learn, on one device or several."""

import agym_jax.compat.mjx_print  # noqa: F401 (before Brax, which imports MJX)
