# %% [markdown]
# # Change the people
#
# Each episode has a different person. By default, people are drawn as in Assistive Gym: an average man or woman with no impairment, reduced
# joint limits, weak muscles, or a tremor.

# %%
import jax
import numpy as np

import agym_jax
from agym_jax import Population

humans = Population(
    sizes="continuous",  # every size between and beyond the average man and woman
    stature=(0.9, 1.1),
    impairments=("none", "tremor"),
)
env = agym_jax.make("ReachingSawyer-v0", impl="native", humans=humans)
people = [env.reset(jax.random.key(seed)).episode.human for seed in range(4)]
for human in people:
    shakes = np.degrees(np.abs(human.tremor).max())
    print(
        f"stature {float(human.stature):.2f}, girth {float(human.girth):.2f}, tremor {shakes:.1f} degrees"
    )

# %% [markdown]
# The person is part of the state, so each environment of a batch has its own. `state.episode.human` holds their properties as arrays.

# %%
from agym_jax.wrappers import vectorize

envs = vectorize(env, 16)
states = envs.reset(jax.random.key(1))
print("statures", np.round(states.episode.human.stature, 2))
assert len(np.unique(states.episode.human.stature)) == 16

# %% [markdown]
# The `HumanSpec` of a task describes its person: which joints move, how they sit, and how strong they are.

# %%
print(env.task.human.joints, env.task.human.impairments, env.task.human.passive_mode, sep="\n")
