# %% [markdown]
# # Robots of your own
#
# Vary one that there is, or add one. `RobotVariation` draws friction, strength, latency and sensor noise anew in every episode.

# %%
import jax
import numpy as np

import agym_jax

robot = agym_jax.RobotVariation(strength=(0.6, 1.0), latency=(0, 2), angle_noise=(0.0, 0.01))
env = agym_jax.make("ReachingSawyer-v0", impl="native", robot=robot)
for seed in range(3):
    drawn = env.reset(jax.random.key(seed)).episode.robot
    print(f"strength {float(drawn.strength):.2f}, latency {int(drawn.latency)} control steps")

# %% [markdown]
# How a policy that never met such robots does with them is a question for `agym-jax evaluate --robot.latency 0 2 --any-env`; a policy that
# was trained with them is another one, and says so.

# %%
state = env.reset(jax.random.key(0))
policy = agym_jax.load_policy("ReachingSawyer-v0")
for _ in range(20):
    state = env.step(state, policy(state.obs))
print("distance", round(float(state.task.distance), 3), "m;", env.changes)

# %% [markdown]
# A new robot is an MJCF file and a record. [Creating an environment](../create_an_environment.md#add-a-robot) has the rules; this is Jaco's:

# %%
from agym_jax.robots.jaco import JACO

print(JACO.model, JACO.arms["left"].joints, JACO.torso, sep="\n")
assert np.isfinite(state.obs).all()
