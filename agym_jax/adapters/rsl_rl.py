"""Many environments as rsl_rl's ``VecEnv``: what its runners train on.

    from agym_jax.adapters.rsl_rl import RslRlVecEnv
    env = RslRlVecEnv("ScratchItchJaco-v0", num_envs=4096)
    runner = OnPolicyRunner(env, config, log_dir, device=str(env.device))

Observation groups are ``"policy"`` (all that agents observe) and, in tasks that have it, ``"privileged"`` (what value functions may
see besides). Needs ``pip install rsl-rl-lib``.
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
    """``num_envs`` environments of rsl_rl.

    The end of an episode by its length is a time-out (``extras["time_outs"]``), for which rsl_rl adds the value of what would have
    come; the success of episodes that end is logged as ``/success``. For arguments and errors see ``TrainerEnv``.
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
        """Steps done in each episode, int64 (num_envs,); rsl_rl sets them to begin at random times."""
        return self.envs.clocks.long()

    @episode_length_buf.setter
    def episode_length_buf(self, steps: torch.Tensor) -> None:
        self.envs.clocks = steps

    def get_observations(self) -> TensorDict:
        """What is observed now."""
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
        """One control step; see ``TorchVectorEnv.step``.

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
