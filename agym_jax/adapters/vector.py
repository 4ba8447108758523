"""Batches of environments as a ``gymnasium.vector.VectorEnv``: NumPy in and out, with a new person in every episode.

    import agym_jax, gymnasium
    envs = gymnasium.make_vec("ScratchItchJaco-v0", num_envs=64)

On a CPU the physics is multi-threaded C MuJoCo; on an NVIDIA GPU it is MuJoCo Warp. JAX code is faster with
``agym_jax.wrappers.vectorize``, whose arrays stay on the device.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cache
from typing import Any, NamedTuple

import jax
import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

import agym_jax
from agym_jax.adapters.common import (
    RENDER_MODES,
    Recipe,
    View,
    begun,
    checked_actions,
    info_of,
    keys_of,
    lengths_of,
    refuse_fork,
    refuse_options,
    spaces_of,
)
from agym_jax.errors import ArgumentError, checked_count
from agym_jax.human.population import Population
from agym_jax.state import drawable, drawn_of
from agym_jax.variation import RobotVariation
from agym_jax.wrappers import vectorize


class _Programs(NamedTuple):
    """A batch and its functions, compiled where possible; shared by all batches of the same size and arguments."""

    envs: Any
    reset: Any
    step: Any


@cache
def _programs(recipe: Recipe, num_envs: int) -> _Programs:
    envs = vectorize(recipe.make(), num_envs)
    if recipe.impl == "native":
        return _Programs(envs, envs.reset, envs.step)
    return _Programs(envs, jax.jit(envs.reset), jax.jit(envs.step))


class GymnasiumVectorEnv(VectorEnv):
    """``num_envs`` environments stepped together, with Gymnasium's interface.

    A finished episode is followed by a new one in the same step (``AutoresetMode.SAME_STEP``): the observation is then
    the first of the new episode, and ``info["final_obs"]`` and ``info["final_info"]`` have the last of the finished
    one, wherever ``info["_final_obs"]`` is true. The other entries of ``info`` are those of ``GymnasiumEnv`` for this
    step, as arrays. Gymnasium's observation wrappers support only vector environments that reset in the next step.

    The first episode of an environment with seed s is the same as after ``GymnasiumEnv.reset(seed=s)`` and develops
    identically (bit for bit with C MuJoCo, except in Feeding, Drinking and Dressing, where a single environment computes in
    a different order). Later episodes differ from those of ``GymnasiumEnv``, but are determined by the seed as well.

    Args:
        env_id: environment id, see ``agym_jax.list_envs()``.
        num_envs: number of environments.
        render_mode: ``"rgb_array"``, or None for no rendering.
        impl: physics implementation, see ``agym_jax.make``; ``"auto"`` means ``"native"`` on a CPU.
        humans: population, see ``agym_jax.make``.
        width: image width [pixels].
        height: image height [pixels].
        camera: name or number of the camera.
        visuals: appearance of the robot, see ``agym_jax.rendering.meshes``.
        config: weights and thresholds of the task, see ``agym_jax.make``.
        episode_length: control steps per episode, see ``agym_jax.make``.
        robot: variation of the robot, see ``agym_jax.make``.
        memory: averages in the observation, see ``agym_jax.make``.

    Raises:
        UnknownNameError: if there is no such id or setting, or there are no such visuals.
        ArgumentError: if the number of environments, the population, a setting, the length or the image size is invalid.
        RenderModeError: if there is no such render mode.
        ImplementationError: if there is no such physics, or it is not installed.
    """

    metadata = {  # noqa: RUF012
        "render_modes": list(RENDER_MODES),
        "render_fps": 10,
        "autoreset_mode": AutoresetMode.SAME_STEP,
    }

    def __init__(
        self,
        env_id: str,
        num_envs: int = 1,
        render_mode: str | None = None,
        impl: str = "auto",
        humans: Population | None = None,
        width: int = 480,
        height: int = 360,
        camera: str | int = "front",
        visuals: str = "primitives",
        config: Mapping[str, Any] | None = None,
        episode_length: int | None = None,
        robot: RobotVariation | None = None,
        memory: Sequence[float] | None = None,
    ):
        self.num_envs = checked_count("num_envs", num_envs)
        self._view = View.checked(env_id, render_mode, width, height, camera, visuals)
        recipe = Recipe.checked(env_id, impl, humans, config, episode_length, robot, memory)
        refuse_fork()
        self._programs = _programs(recipe, self.num_envs)
        self.render_mode = render_mode
        env = self.core
        self.single_action_space, self.single_observation_space = spaces_of(env)
        self.action_space = batch_space(self.single_action_space, self.num_envs)
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self._lengths = lengths_of(env)
        self._state: Any = None

    @property
    def core(self) -> agym_jax.Env:
        """The underlying pure environment."""
        return self._programs.envs.env

    @property
    def state(self) -> agym_jax.State:
        """The current state of all environments (num_envs, ...).

        Raises:
            gymnasium.error.ResetNeeded: if ``reset`` has not been called yet.
        """
        return begun(self.core, self._state)

    def reset(  # pyrefly: ignore[bad-override]
        self,
        *,
        seed: int | Sequence[int | None] | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Begin an episode in every environment.

        Args:
            seed: seed of the first environment, the others using the numbers after it; or one seed per environment,
                None being a random one; or None: random on the first reset, afterwards determined by the previous seed.
            options: not supported.

        Raises:
            ArgumentError: if the number of seeds is not the number of environments.
            AgymError: if options are given.
        """
        refuse_options(self.core, options)
        if isinstance(seed, (int, np.integer)):
            super().reset(seed=int(seed))
            seeds: list[int | None] = [int(seed) + i for i in range(self.num_envs)]
        elif seed is None:
            seeds = [int(x) for x in self.np_random.integers(2**31, size=self.num_envs)]
        else:
            seeds = [None if one is None else int(one) for one in seed]
            if len(seeds) != self.num_envs:
                raise ArgumentError(
                    f"{self.core.name} in a batch of {self.num_envs} takes one seed or {self.num_envs}, got {len(seeds)}."
                )
            super().reset(seed=next((one for one in seeds if one is not None), None))
        self._state = self._programs.reset(keys_of(seeds))
        return np.array(self._state.obs), self._info(jax.device_get(self._state.metrics))

    def step(
        self, actions: Any
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        """Advance every environment by one control step of 0.1 s; finished episodes are replaced by new ones.

        Args:
            actions: in [-1, 1] (num_envs, action_size).

        Raises:
            ActionError: if they have a different shape, or NaN or infinite entries.
            gymnasium.error.ResetNeeded: if ``reset`` has not been called yet.
        """
        actions = checked_actions(self.core, actions, self.action_space.shape)
        self._state = s = self._programs.step(self.state, actions)
        final = s.info["final_observation"]
        obs, final, reward, done, cut, metrics = jax.device_get(
            (s.obs, final, s.reward, s.done, s.info["truncation"], s.metrics)
        )
        done, truncated = done > 0, cut > 0
        info = self._info(metrics)
        if done.any():
            info = self._after_reset(info, np.asarray(final), done)
        return np.array(obs), reward.astype(np.float64), done & ~truncated, truncated, info

    def render(self) -> tuple[np.ndarray, ...] | None:
        """Return an image of each environment, uint8 (height, width, 3), or None if made without a render mode."""
        if self.render_mode is None:
            return None
        batch = drawable(self.state)
        return tuple(self._picture(drawn_of(batch, i)) for i in range(self.num_envs))

    def _picture(self, state: Any) -> np.ndarray:
        renderer, _, data = self._view.renderer(self.core, state)
        with renderer:
            return renderer.render(data, self.core.markers(state))

    def _info(self, metrics: dict[str, Any]) -> dict[str, Any]:
        """Return the infos of all environments, with Gymnasium's masks of the environments that have them."""
        none = np.zeros(self.num_envs, int)
        real = lambda x: np.asarray(x, float)  # noqa: E731
        info = info_of(metrics, self._lengths, real, lambda x: none + x)
        return _masked(info, np.ones(self.num_envs, bool))

    def _after_reset(
        self, info: dict[str, Any], final: np.ndarray, done: np.ndarray
    ) -> dict[str, Any]:
        """Return the infos of a step in which episodes ended; the infos of those episodes become the final ones."""
        last = np.full(self.num_envs, None, object)
        for i in np.flatnonzero(done):
            last[i] = final[i].copy()
        final_info = _masked(_only(info, done), done)
        return info | {
            "final_obs": last, "_final_obs": done.copy(),
            "final_info": final_info, "_final_info": done.copy(),
        }  # fmt: skip


def _only(info: dict[str, Any], where: np.ndarray) -> dict[str, Any]:
    """Return infos without masks, with 0 where no episode ended."""
    return {
        name: _only(x, where) if isinstance(x, dict) else np.where(where, x, np.zeros_like(x))
        for name, x in info.items()
        if not name.startswith("_")
    }


def _masked(info: dict[str, Any], where: np.ndarray) -> dict[str, Any]:
    """Return infos with a mask ``_name`` beside each, as in Gymnasium's own vector environments."""
    out: dict[str, Any] = {}
    for name, x in info.items():
        out[name] = _masked(x, where) if isinstance(x, dict) else x
        out[f"_{name}"] = where.copy()
    return out


__all__ = ["GymnasiumVectorEnv"]
