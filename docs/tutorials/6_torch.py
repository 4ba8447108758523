# %% [markdown]
# # PyTorch
#
# This tutorial steps environments with PyTorch tensors as inputs and outputs. The tensors share memory with JAX arrays, and the same code
# works for thousands of environments. It needs `pip install "agym_jax[torch]"`. If PyTorch is not installed, as on the machine that builds
# these pages, the tutorial prints a message and skips the example.

# %%
from agym_jax.errors import MissingExtraError

try:
    from agym_jax.adapters.torch import TorchVectorEnv
except MissingExtraError as error:
    TorchVectorEnv = None
    print(error)

# %% [markdown]
# `reset` and `step` have the same interface as Gymnasium's vector environments. When an episode ends, the next one starts in the same step,
# with another person.

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
# Weights, people and robots are changed with the same arguments as in `make`: `TorchVectorEnv(id, num_envs, config={"distance": 2.0})`. The
# adapters for rsl_rl, skrl and Stable-Baselines3 are described in the [PyTorch guide](../torch.md).
