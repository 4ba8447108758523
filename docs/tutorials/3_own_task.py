# %% [markdown]
# # A task of your own
#
# Change weights and thresholds of a task that there is, or write one. A change is an argument of `make`; `agym-jax settings ID` lists
# what there is.

# %%
import dataclasses

import jax
import jax.numpy as jnp

import agym_jax

env = agym_jax.make("ReachingSawyer-v0", impl="native", config={"distance": 2.0, "reached": 0.05})
print(env.changes)

# %% [markdown]
# A new task is a frozen dataclass with the functions of [creating an environment](../create_an_environment.md). The quickest way to one is to
# inherit from one that there is: here the hand stays 10 cm before the mouth. It starts as Reaching does, so Reaching's placements fit.

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
