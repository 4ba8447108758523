# %% [markdown]
# # Evaluate a policy
#
# How often it succeeds, how gently, and with whom. On the command line: `agym-jax evaluate --env-name ReachingSawyer-v0`.

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
# Baselines have names. The interval of a success rate is wide with few episodes: 1,000 are what the tables of this site have.

# %%
zero = evaluate(env, "zero", num_episodes=32)
print(f"policy {result.success:.0%}, doing nothing {zero.success:.0%}")
assert result.success > zero.success
