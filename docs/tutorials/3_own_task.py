# %% [markdown]
# # Create your own task
#
# You can change the weights and thresholds of an existing task, or write a new task. Changes are passed to `make`; `agym-jax settings ID`
# lists the available settings.

# %%
import dataclasses

import jax
import jax.numpy as jnp

import agym_jax

env = agym_jax.make("ReachingSawyer-v0", impl="native", config={"distance": 2.0, "reached": 0.05})
print(env.changes)

# %% [markdown]
# A new task is a frozen dataclass with the methods described in [creating an environment](../create_an_environment.md). The quickest way is to
# inherit from an existing task. In this example, the hand stays 10 cm in front of the mouth. Episodes start as in Reaching, so Reaching's
# placement bank can be used. It keeps the name Reaching for that: train it in a folder of its own, because policies of the two tasks are not told apart.

# %%
from agym_jax.tasks.reaching import Reaching, ReachState


@dataclasses.dataclass(frozen=True)
class Offering(Reaching):
    """Hold the hand before the mouth."""

    before: float = 0.1  # [m]

    def advance(self, state, sensed):
        """The goal is in front of the mouth, along the head's own axis."""
        forward = -sensed.link_rot_w["head"][:, 1]
        goal = sensed.mouth_pos_w + self.before * forward
        return ReachState(goal, jnp.linalg.norm(sensed.tool.pos_w - goal)), {}

    def init(self, key, sensed):
        """The same at the start."""
        return self.advance(None, sensed)[0]


# %%
from agym_jax.env import AssistiveEnv
from agym_jax.robots import ROBOTS

env = AssistiveEnv(Offering(), ROBOTS["Sawyer"], impl="native")
state = env.reset(jax.random.key(0))
state = env.step(state, jnp.zeros(env.action_size))
print({name: round(float(x), 3) for name, x in state.metrics.items() if name.startswith("reward/")})
assert float(state.task.distance) > 0.05
