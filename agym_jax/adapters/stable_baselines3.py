"""A vector environment from ``gymnasium.make_vec`` as Stable-Baselines3's ``VecEnv``.

    from agym_jax.adapters.stable_baselines3 import StableBaselinesVecEnv
    env = StableBaselinesVecEnv(gymnasium.make_vec("ScratchItchJaco-v0", num_envs=64))
    PPO("MlpPolicy", env).learn(100_000)

Requires ``pip install stable-baselines3``.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

from agym_jax.adapters.vector import GymnasiumVectorEnv
from agym_jax.errors import ArgumentError, MissingExtraError

try:
    from stable_baselines3.common.vec_env import VecEnv
except ImportError as error:
    raise MissingExtraError(
        'Stable-Baselines3 is not installed: pip install stable-baselines3, or "agym_jax[rl]"'
    ) from error


class StableBaselinesVecEnv(VecEnv):
    """A vector environment with Stable-Baselines3's interface.

    When an episode ends, its entry of ``infos`` contains ``terminal_observation``, ``TimeLimit.truncated`` and
    ``is_success``.

    Args:
        envs: vector environment from ``gymnasium.make_vec(id, num_envs=...)``.

    Raises:
        ArgumentError: if ``envs`` is something else.
    """

    def __init__(self, envs: Any):
        self.envs = getattr(envs, "unwrapped", envs)
        if not isinstance(self.envs, GymnasiumVectorEnv) or self.envs is not envs:
            raise ArgumentError(
                f"StableBaselinesVecEnv takes what gymnasium.make_vec(id, num_envs=...) returns, got {envs!r}. Wrap it afterwards, "
                "with Stable-Baselines3's own wrappers."
            )
        self._actions: Any = None
        super().__init__(envs.num_envs, envs.single_observation_space, envs.single_action_space)

    def reset(self) -> np.ndarray:
        """Begin an episode in every environment, with the seeds set by ``seed()`` if any."""
        given = [one for one in self._seeds if one is not None]
        obs, _ = self.envs.reset(seed=self._seeds if given else None)
        self._reset_seeds()
        return obs

    def step_async(self, actions: np.ndarray) -> None:
        """Store the actions for ``step_wait`` (num_envs, n_action)."""
        self._actions = actions

    def step_wait(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, list[dict[str, Any]]]:
        """Step all environments; return observations, rewards, dones and infos."""
        obs, rewards, terminated, truncated, info = self.envs.step(self._actions)
        ended = terminated | truncated
        infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        for i in np.flatnonzero(ended):
            infos[i] = {
                "terminal_observation": info["final_obs"][i],
                "TimeLimit.truncated": bool(truncated[i]),
                "is_success": bool(info["final_info"]["task_success"][i]),
            }
        return obs, rewards.astype(np.float32), ended, infos

    def close(self) -> None:
        """Close the vector environment."""
        self.envs.close()

    def get_images(self) -> Sequence[np.ndarray | None]:
        """Return an image of each environment."""
        return self.envs.render() or [None] * self.num_envs

    def get_attr(self, attr_name: str, indices: int | Iterable[int] | None = None) -> list[Any]:
        """Return an attribute of the vector environment, repeated for each environment."""
        return [getattr(self.envs, attr_name)] * len(self._indices(indices))

    def set_attr(
        self, attr_name: str, value: Any, indices: int | Iterable[int] | None = None
    ) -> None:
        """Not supported: the environments of a vector have no attributes of their own.

        Raises:
            AttributeError: always.
        """
        raise AttributeError(
            f"Environments of {self.envs.core.name} are stepped together and have no {attr_name!r} of their own to set."
        )

    def env_method(
        self, method_name: str, *method_args: Any, indices: int | Iterable[int] | None = None, **method_kwargs: Any
    ) -> list[Any]:  # fmt: skip
        """Not supported: the environments of a vector have no methods of their own.

        Raises:
            AttributeError: always.
        """
        raise AttributeError(
            f"Environments of {self.envs.core.name} are stepped together and have no {method_name!r} of their own to call."
        )

    def env_is_wrapped(
        self, wrapper_class: type, indices: int | Iterable[int] | None = None
    ) -> list[bool]:
        """Return False for each environment: wrappers apply to the whole vector only."""
        return [False] * len(self._indices(indices))

    def _indices(self, indices: int | Iterable[int] | None) -> list[int]:
        return [int(i) for i in self._get_indices(indices)]


__all__ = ["StableBaselinesVecEnv"]
