# %% [markdown]
# # Train a policy
#
# This tutorial trains a policy with PPO on C MuJoCo. The Sawyer robot learns to bring its hand to the person's mouth. No GPU is needed.
# The equivalent command is `agym-jax train --env-name ReachingSawyer-v0 --num-env-steps 2e5`.

# %%
import dataclasses

import agym_jax
from agym_jax.__main__ import trainer

train = trainer()  # the trainer of the package: agym_jax.train
from agym_jax.train import ppo
from agym_jax.train.configs import config_for

# %% [markdown]
# `config_for` returns the settings that were tuned for the task. A few thousand steps are enough here to see that training works. With
# 200,000 steps, which take about a minute on two cores, the hand reaches the mouth.

# %%
env = agym_jax.make("ReachingSawyer-v0", impl="native", episode_length=50)
config = dataclasses.replace(
    config_for("ReachingSawyer-v0"),
    num_env_steps=12_800,
    num_envs=64,
    save_dir=None,
    log_interval=2,
)
result = ppo.train(env, config)
for row in result.curve:
    print(f"{row['env_steps']:6,} steps   reward of a step {row['return_per_step'] / 50:6.3f}")

# %% [markdown]
# The result contains the policy, which is a function of the observation. `agym_jax.policy.save_policy(path, policy)` saves it to a file. If
# `save_dir` is set, training writes checkpoints, the learning curve and the policy automatically.

# %%
import jax

policy = result.policy
state = env.reset(jax.random.key(0))
for _ in range(10):
    state = env.step(state, policy(state.obs))
print("distance from hand to mouth:", round(float(state.task.distance), 3), "m")
assert (
    result.env_steps == 12_800
    and result.curve[-1]["return_per_step"] > result.curve[0]["return_per_step"]
)
