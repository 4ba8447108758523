# %% [markdown]
# # Train a policy
#
# PPO on C MuJoCo: Sawyer brings its hand to the person's mouth. Nothing here needs a GPU. The same on the command line is
# `agym-jax train --env-name ReachingSawyer-v0 --num-env-steps 2e5`.

# %%
import dataclasses

import agym_jax
from agym_jax.__main__ import trainer

train = trainer()  # the trainer of the package: agym_jax.train
from agym_jax.train import ppo
from agym_jax.train.configs import config_for

# %% [markdown]
# `config_for` has the settings that the task was tuned with. Here a few thousand steps are enough to see that it works; 200,000
# take about a minute on two cores, and then the hand finds the mouth.

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
# The result has the policy, a function of the observation. `agym_jax.policy.save_policy(path, policy)` keeps it in a file, and with a
# `save_dir` training writes checkpoints, the curve and the policy itself.

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
