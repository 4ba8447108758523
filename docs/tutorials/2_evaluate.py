# %% [markdown]
# # Evaluate a policy
#
# This tutorial measures how often a policy succeeds, how gently, and with which groups of people. The equivalent command is
# `agym-jax evaluate --env-name ReachingSawyer-v0`.

# %%
import agym_jax
from agym_jax.__main__ import trainer

trainer()
from agym_jax.train.evaluate import evaluate

env = agym_jax.make("ReachingSawyer-v0", impl="native", episode_length=60)
policy = agym_jax.load_policy("ReachingSawyer-v0")  # one that ships
result = evaluate(env, policy, num_episodes=32)
print(result.table())

# %% [markdown]
# Baselines such as `"zero"` are selected by name. With few episodes, the confidence interval of a success rate is wide; the tables on this site
# use 1,000 episodes.

# %%
zero = evaluate(env, "zero", num_episodes=32)
print(f"policy {result.success:.0%}, doing nothing {zero.success:.0%}")
assert result.success > zero.success
