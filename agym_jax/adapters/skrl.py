"""Many environments as skrl's ``Wrapper``: what its trainers take in place of ``wrap_env(...)``.

    from agym_jax.adapters.skrl import SkrlEnv
    env = SkrlEnv("ScratchItchJaco-v0", num_envs=4096)
    trainer = SequentialTrainer(env=env, agents=agent, cfg={"timesteps": 1000, "headless": True})

Needs ``pip install skrl``.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from gymnasium import spaces

from agym_jax.adapters.torch import TrainerEnv, success_of_ended, torch
from agym_jax.errors import MissingExtraError

try:
    from skrl.envs.wrappers.torch import Wrapper
except ImportError as error:
    raise MissingExtraError('skrl is not installed: pip install skrl, or "agym_jax[rl]"') from error


class SkrlEnv(TrainerEnv, Wrapper):
    """``num_envs`` environments of skrl.

    As in skrl's own wrappers of vectors, ``reset`` begins episodes once and then gives what is observed now. The success of
    episodes that end is logged as ``Info / success``. For arguments and errors see ``TrainerEnv``.
    """

    def _prepare(self, seed: int | None) -> None:
        Wrapper.__init__(self, self.envs)
        self._seed, self._begun = seed, False
        size = self.envs.core.privileged_obs_size
        whole = (self.envs.observation_space.shape[0] + size,)
        self._state_space = spaces.Box(-np.inf, np.inf, whole, np.float32) if size else None

    @property
    def state_space(self) -> spaces.Box | None:
        """Of what value functions may see: the observation and what nobody observes; None if there is nothing."""
        return self._state_space

    def reset(self) -> tuple[torch.Tensor, dict[str, Any]]:
        """What is observed now; at first, in new episodes."""
        if not self._begun:
            self.envs.reset(self._seed)
            self._begun = True
        return self.envs.observations, {}

    def step(
        self, actions: torch.Tensor
    ) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor, dict[str, Any]]:
        """One control step; see ``TorchVectorEnv.step``. Rewards and ends have the shape (num_envs, 1).

        Args:
            actions: (num_envs, n_action).
        """
        obs, rewards, terminated, truncated, info = self.envs.step(actions)
        success = success_of_ended(info, terminated, truncated)
        if success is not None:
            info["episode"] = {"success": success}
        return obs, rewards[:, None], terminated[:, None], truncated[:, None], info

    def state(self) -> torch.Tensor | None:
        """What value functions may see (num_envs, n); None if that is the observation."""
        privileged = self.envs.privileged
        return None if privileged is None else torch.cat([self.envs.observations, privileged], 1)

    def render(self, *args: Any, **kwargs: Any) -> None:
        """Nothing: ``agym-jax enjoy`` and ``gymnasium.make(id, render_mode="rgb_array")`` make pictures."""


__all__ = ["SkrlEnv"]
