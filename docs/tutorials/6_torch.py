# %% [markdown]
# # PyTorch
#
# Thousands of environments with tensors in and out, which share memory with JAX's arrays. Needs `pip install "agym_jax[torch]"`; where
# PyTorch is not installed, as on the machine that builds these pages, this tutorial says so and does nothing.

# %%
from agym_jax.errors import MissingExtraError

try:
    from agym_jax.adapters.torch import TorchVectorEnv
except MissingExtraError as error:
    TorchVectorEnv = None
    print(error)

# %% [markdown]
# `reset` and `step` are those of Gymnasium's vectors. An episode that ends begins anew in the same step, as somebody else.

# %%
if TorchVectorEnv:
    import torch

    envs = TorchVectorEnv("ReachingSawyer-v0", num_envs=16)
    obs, info = envs.reset(seed=0)
    for _ in range(5):
        actions = 2 * torch.rand(16, envs.action_space.shape[0], device=envs.device) - 1
        obs, reward, terminated, truncated, info = envs.step(actions)
    print(obs.shape, obs.device, "mean reward", round(float(reward.mean()), 3))
    assert torch.isfinite(obs).all()

# %% [markdown]
# Weights, people and robots are changed as everywhere: `TorchVectorEnv(id, num_envs, config={"distance": 2.0})`. Adapters for rsl_rl, skrl and
# Stable-Baselines3 are modules beside this one.
