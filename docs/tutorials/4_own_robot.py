# %% [markdown]
# # Vary or add robots
#
# You can vary an existing robot, or add a new one. `RobotVariation` draws friction, strength, latency and sensor noise for every episode.

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
# To evaluate a policy on robot variations it was not trained with, use `agym-jax evaluate --robot.latency 0 2 --any-env`. A policy that was
# trained with variations records them.

# %%
state = env.reset(jax.random.key(0))
policy = agym_jax.load_policy("ReachingSawyer-v0")
for _ in range(20):
    state = env.step(state, policy(state.obs))
print("distance", round(float(state.task.distance), 3), "m;", env.changes)

# %% [markdown]
# A new robot consists of an MJCF file and a record. [Creating an environment](../create_an_environment.md#add-a-robot) lists the rules. This is
# Jaco's record:

# %%
from agym_jax.robots.jaco import JACO

print(JACO.model, JACO.arms["left"].joints, JACO.torso, sep="\n")
assert np.isfinite(state.obs).all()
