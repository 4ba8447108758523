"""Environments with an active person as a ``pettingzoo.ParallelEnv`` with the agents robot and human.

    from agym_jax.adapters.pettingzoo import PettingZooEnv
    env = PettingZooEnv("ScratchItchJacoHuman-v0", render_mode="rgb_array")

A single world, NumPy in and out; each agent receives its own columns of the observation, and both receive the same
reward. Requires the extra ``[pettingzoo]``.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from gymnasium import spaces
from gymnasium.error import ResetNeeded
from pettingzoo import ParallelEnv

import agym_jax
from agym_jax.adapters.common import RENDER_MODES
from agym_jax.adapters.gymnasium import GymnasiumEnv
from agym_jax.errors import ActionError, SpecError
from agym_jax.registry import parse


class PettingZooEnv(ParallelEnv):
    """A single environment in which both robot and person act, with PettingZoo's interface.

    Episodes are truncated for both agents after 200 steps (``episode_length``), or when the simulation diverges; they
    never terminate.

    Args:
        env_id: environment id with ``Human`` in it, see ``agym_jax.list_envs()``.
        **options: see ``GymnasiumEnv``.

    Raises:
        UnknownNameError: if there is no such id.
        SpecError: if the person of that id does not act.
        RenderModeError: if there is no such render mode.
    """

    # PettingZoo reads both from the class
    metadata = {  # noqa: RUF012
        "name": "agym_jax",
        "render_modes": list(RENDER_MODES),
        "render_fps": 10,
        "is_parallelizable": True,
    }

    def __init__(self, env_id: str, **options: Any):
        recipe = parse(env_id)
        if not recipe.active:
            active = f"{recipe.task.name}{recipe.robot.name}Human-v0"
            raise SpecError(
                f"In {env_id!r} only the robot acts: use gymnasium.make({env_id!r}). A robot and a "
                f"person act in {active!r}."
            )
        self._world = GymnasiumEnv(env_id, **options)
        core = self._world.core
        self.metadata = {**type(self).metadata, "name": core.name}
        self.render_mode = self._world.render_mode
        self.possible_agents = list(core.action_sizes)
        self.agents: list[str] = []
        self.observation_spaces = {
            agent: spaces.Box(-np.inf, np.inf, (size,), np.float32)
            for agent, size in core.observation_sizes.items()
        }
        self.action_spaces = {
            agent: spaces.Box(-1.0, 1.0, (size,), np.float32)
            for agent, size in core.action_sizes.items()
        }
        self._columns = np.cumsum(list(core.observation_sizes.values()))[:-1]

    @property
    def core(self) -> agym_jax.Env:
        """The underlying pure environment."""
        return self._world.core

    def observation_space(self, agent: str) -> spaces.Space:
        """Return the observation space of an agent."""
        return self.observation_spaces[agent]

    def action_space(self, agent: str) -> spaces.Space:
        """Return the action space of an agent."""
        return self.action_spaces[agent]

    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, np.ndarray], dict[str, dict[str, Any]]]:
        """Begin an episode with a new person, goal and start.

        Args:
            seed: seed of this episode and, through the generator, of those that follow.
            options: ignored; accepted because PettingZoo's own test passes some.
        """
        obs, info = self._world.reset(seed=seed)
        self.agents = list(self.possible_agents)
        return self._split(obs), self._each(info)

    def step(
        self, actions: Mapping[str, np.ndarray]
    ) -> tuple[
        dict[str, np.ndarray],
        dict[str, float],
        dict[str, bool],
        dict[str, bool],
        dict[str, dict[str, Any]],
    ]:
        """Advance the environment by one control step of 0.1 s.

        Args:
            actions: actions of both agents, in [-1, 1].

        Raises:
            ActionError: if an agent is missing or unknown, or its action has a different shape, or NaN or infinite
                entries.
            gymnasium.error.ResetNeeded: if the episode has not begun, or is over.
        """
        if not self.agents:
            raise ResetNeeded(f"{self.core.name}: call reset() to begin an episode.")
        if set(actions) != set(self.agents):
            raise ActionError(
                f"{self.core.name} takes an action from each of {', '.join(self.agents)}, got "
                f"actions from: {', '.join(map(str, actions)) or 'nobody'}."
            )
        for agent, space in self.action_spaces.items():
            if np.shape(actions[agent]) != space.shape:
                raise ActionError(
                    f"The {agent} of {self.core.name} takes actions of shape {space.shape}, got "
                    f"{np.shape(actions[agent])}."
                )
        action = np.concatenate([actions[agent] for agent in self.agents])
        obs, reward, terminated, truncated, info = self._world.step(action)
        result = (
            self._split(obs),
            self._each(reward),
            self._each(terminated),
            self._each(truncated),
            self._each(info),
        )
        if terminated or truncated:
            self.agents = []
        return result

    def state(self) -> np.ndarray:
        """Return the concatenated observations of both agents, for centralised critics.

        Raises:
            gymnasium.error.ResetNeeded: if no episode has begun yet.
        """
        return np.array(self._world.state.obs)

    def render(self) -> np.ndarray | None:
        """Return an image, uint8 (height, width, 3), or None if made without a render mode."""
        return self._world.render()

    def close(self) -> None:
        """Free the renderer."""
        self._world.close()

    def _split(self, obs: np.ndarray) -> dict[str, np.ndarray]:
        return dict(zip(self.possible_agents, np.split(obs, self._columns), strict=True))

    def _each(self, value: Any) -> dict[str, Any]:
        copies = (dict(value) if isinstance(value, dict) else value for _ in self.possible_agents)
        return dict(zip(self.possible_agents, copies, strict=True))


__all__ = ["PettingZooEnv"]
