"""Batches of environments as rsl_rl's ``VecEnv``, for its runners.

    from agym_jax.adapters.rsl_rl import RslRlVecEnv
    env = RslRlVecEnv("ScratchItchJaco-v0", num_envs=4096)
    runner = OnPolicyRunner(env, config, log_dir, device=str(env.device))

The observation groups are ``"policy"`` (everything that the agents observe) and, in tasks that have it, ``"privileged"``
(additional inputs for value functions only). Requires ``pip install rsl-rl-lib``.
"""

from __future__ import annotations

from typing import Any

from agym_jax.adapters.torch import TrainerEnv, success_of_ended, torch
from agym_jax.errors import MissingExtraError

try:
    from rsl_rl.env import VecEnv
    from tensordict import TensorDict
except ImportError as error:
    raise MissingExtraError(
        'rsl_rl is not installed: pip install rsl-rl-lib, or "agym_jax[rl]"'
    ) from error


class RslRlVecEnv(TrainerEnv, VecEnv):
    """``num_envs`` environments with rsl_rl's interface.

    An episode that reaches its length is reported as a time-out (``extras["time_outs"]``), so that rsl_rl bootstraps its
    value; the success of finished episodes is logged as ``/success``. For arguments and errors see ``TrainerEnv``.
    """

    def _prepare(self, seed: int | None) -> None:
        self.num_envs = self.envs.num_envs
        self.num_actions = self.envs.action_space.shape[0]
        self.max_episode_length = self.envs.episode_length
        self.device = self.envs.device
        self.cfg: dict[str, Any] = {"env": self.envs.core.name, "num_envs": self.num_envs, "seed": seed}  # fmt: skip
        self.envs.reset(seed)

    @property
    def episode_length_buf(self) -> torch.Tensor:
        """Steps taken in each episode, int64 (num_envs,); rsl_rl sets them to start episodes at random times."""
        return self.envs.clocks.long()

    @episode_length_buf.setter
    def episode_length_buf(self, steps: torch.Tensor) -> None:
        self.envs.clocks = steps

    def get_observations(self) -> TensorDict:
        """Return the current observations."""
        groups, privileged = {"policy": self.envs.observations}, self.envs.privileged
        if privileged is not None:
            groups["privileged"] = privileged
        return TensorDict(groups, batch_size=[self.num_envs], device=self.device)

    def reset(self) -> tuple[TensorDict, dict[str, Any]]:
        """Begin an episode in every environment."""
        self.envs.reset()
        return self.get_observations(), {}

    def step(
        self, actions: torch.Tensor
    ) -> tuple[TensorDict, torch.Tensor, torch.Tensor, dict[str, Any]]:
        """Advance all environments by one control step; see ``TorchVectorEnv.step``.

        Args:
            actions: (num_envs, n_action).
        """
        _, rewards, terminated, truncated, info = self.envs.step(actions)
        extras: dict[str, Any] = {"time_outs": truncated}
        success = success_of_ended(info, terminated, truncated)
        if success is not None:
            extras["log"] = {"/success": success}
        return self.get_observations(), rewards, terminated | truncated, extras


__all__ = ["RslRlVecEnv"]
