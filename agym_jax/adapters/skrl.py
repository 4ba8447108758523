"""Batches of environments as skrl's ``Wrapper``, for its trainers; use it instead of ``wrap_env(...)``.

    from agym_jax.adapters.skrl import SkrlEnv
    env = SkrlEnv("ScratchItchJaco-v0", num_envs=4096)
    trainer = SequentialTrainer(env=env, agents=agent, cfg={"timesteps": 1000, "headless": True})

Requires ``pip install skrl``.
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
    """``num_envs`` environments with skrl's interface.

    As in skrl's own wrappers for vectorised environments, the first ``reset`` begins the episodes and later calls return
    the current observations. The success of finished episodes is logged as ``Info / success``. For arguments and errors
    see ``TrainerEnv``.
    """

    def _prepare(self, seed: int | None) -> None:
        Wrapper.__init__(self, self.envs)
        self._seed, self._begun = seed, False
        size = self.envs.core.privileged_obs_size
        whole = (self.envs.observation_space.shape[0] + size,)
        self._state_space = spaces.Box(-np.inf, np.inf, whole, np.float32) if size else None

    @property
    def state_space(self) -> spaces.Box | None:
        """Space of the value functions' input, observations and privileged observations; None if the task has no latter."""
        return self._state_space

    def reset(self) -> tuple[torch.Tensor, dict[str, Any]]:
        """Return the current observations; the first call begins the episodes."""
        if not self._begun:
            self.envs.reset(self._seed)
            self._begun = True
        return self.envs.observations, {}

    def step(
        self, actions: torch.Tensor
    ) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor, dict[str, Any]]:
        """Advance all environments by one control step; see ``TorchVectorEnv.step``.

        Rewards and termination flags have the shape (num_envs, 1).

        Args:
            actions: (num_envs, n_action).
        """
        obs, rewards, terminated, truncated, info = self.envs.step(actions)
        success = success_of_ended(info, terminated, truncated)
        if success is not None:
            info["episode"] = {"success": success}
        return obs, rewards[:, None], terminated[:, None], truncated[:, None], info

    def state(self) -> torch.Tensor | None:
        """Return the value functions' input (num_envs, n); None if it is the same as the observation."""
        privileged = self.envs.privileged
        return None if privileged is None else torch.cat([self.envs.observations, privileged], 1)

    def render(self, *args: Any, **kwargs: Any) -> None:
        """Do nothing; use ``agym-jax enjoy`` or ``gymnasium.make(id, render_mode="rgb_array")`` for images."""


__all__ = ["SkrlEnv"]
