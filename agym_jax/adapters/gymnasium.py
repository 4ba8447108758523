"""Every environment as a ``gymnasium.Env``: a single world, NumPy in and out, a new person in each episode.

    import agym_jax, gymnasium
    env = gymnasium.make("ScratchItchJaco-v0", render_mode="rgb_array")

For training, use ``agym_jax.wrappers.vectorize``, which steps thousands of environments at once; this interface is for
visualisation, scripts, and code that supports only Gymnasium. On a CPU the physics is C MuJoCo, so that the first step
takes only seconds; ``impl="jax"`` selects the physics used in training, for a single world.

DEVIATION(gymnasium-bounds): the observation space is unbounded; AG declares [-1, 1], which its
observations exceed.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cache
from typing import Any, NamedTuple

import gymnasium
import jax
import numpy as np

import agym_jax
from agym_jax.adapters.common import (
    RENDER_MODES,
    ForkedProcessError,
    Recipe,
    RenderModeError,
    View,
    begun,
    checked_actions,
    info_of,
    key_of,
    lengths_of,
    refuse_fork,
    refuse_options,
    spaces_of,
)
from agym_jax.human.population import Population
from agym_jax.rendering.render import Renderer
from agym_jax.variation import RobotVariation


class _Programs(NamedTuple):
    """An environment and its functions, compiled where possible; shared by all instances with the same arguments."""

    env: agym_jax.Env
    reset: Any
    step: Any


@cache
def _programs(recipe: Recipe) -> _Programs:
    env = recipe.make()
    return _Programs(env, *env.jit_functions())


class GymnasiumEnv(gymnasium.Env):
    """A single environment with Gymnasium's interface.

    Episodes are truncated after 200 steps (``episode_length``), like all of Assistive Gym's, or when the simulation
    diverges; they never terminate. ``info`` has Assistive Gym's keys and the reward terms.

    ``copy.deepcopy`` and ``pickle`` preserve the state of the episode and the generator of future episodes: a copy
    continues as the original would, and neither affects the other, so a planner can try out actions in copies. Copies
    share the compiled programs.

    Args:
        env_id: environment id, see ``agym_jax.list_envs()``.
        render_mode: ``"rgb_array"``, or None for no rendering.
        impl: physics implementation, see ``agym_jax.make``; ``"auto"`` means ``"native"`` on a CPU.
        humans: population, see ``agym_jax.make``.
        width: image width [pixels].
        height: image height [pixels].
        camera: name or number of the camera.
        visuals: appearance of the robot, ``"primitives"`` or ``"meshes"``, see ``agym_jax.rendering.meshes``.
        config: weights and thresholds of the task, see ``agym_jax.make``.
        episode_length: control steps per episode, see ``agym_jax.make``.
        robot: variation of the robot, see ``agym_jax.make``.
        memory: averages in the observation, see ``agym_jax.make``.

    Raises:
        UnknownNameError: if there is no such id or setting, or there are no such visuals.
        MissingExtraError: if the meshes' package is not installed: ``pip install "agym_jax[meshes]"``.
        MeshError: if this robot has no meshes, or they do not fit it.
        RenderModeError: if there is no such render mode.
        ImplementationError: if there is no such physics, or it is not installed.
        ForkedProcessError: if this process was forked from one that has already made an environment.
        ArgumentError: if ``humans`` is not a population, a setting or the length is invalid, or the image size is not
            positive.
        UnknownCameraError: if there is no such camera.
    """

    metadata = {"render_modes": list(RENDER_MODES), "render_fps": 10}  # noqa: RUF012

    def __init__(
        self,
        env_id: str,
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
        self._view = View.checked(env_id, render_mode, width, height, camera, visuals)
        self._made_of = Recipe.checked(env_id, impl, humans, config, episode_length, robot, memory)
        refuse_fork()
        self._programs = _programs(self._made_of)
        self.render_mode = render_mode
        env = self._programs.env
        self.action_space, self.observation_space = spaces_of(env)
        self._lengths = lengths_of(env)
        self._state: Any = None
        self._over = True
        self._pictures: tuple[Renderer, Any, Any] | None = None

    def __getstate__(self) -> dict[str, Any]:
        """Return everything except the programs, which are looked up or compiled again, and the renderer's contexts."""
        kept = {name: x for name, x in vars(self).items() if name not in ("_programs", "_pictures")}
        return kept | {"_state": jax.device_get(self._state)}

    def __setstate__(self, kept: dict[str, Any]) -> None:
        refuse_fork()
        vars(self).update(kept)
        self._programs, self._pictures = _programs(self._made_of), None

    @property
    def core(self) -> agym_jax.Env:
        """The underlying pure environment."""
        return self._programs.env

    @property
    def state(self) -> agym_jax.State:
        """The current state of the environment.

        Raises:
            gymnasium.error.ResetNeeded: if ``reset`` has not been called yet.
        """
        return begun(self.core, self._state)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Begin an episode with a new person, goal and start.

        Args:
            seed: seed of this episode and, through the generator, of those that follow.
            options: not supported.
        """
        super().reset(seed=seed)
        refuse_options(self.core, options)
        self._state = self._programs.reset(key_of(self.np_random))
        self._over = False
        self._forget_pictures()  # they show the person before
        return np.array(self._state.obs), self._info(jax.device_get(self._state.metrics))

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        """Advance the environment by one control step of 0.1 s.

        Args:
            action: in [-1, 1]: the robot's joints, then those of the person if active.

        Raises:
            ActionError: if the action has a different shape, or NaN or infinite entries.
            gymnasium.error.ResetNeeded: if the episode has not begun, or is over.
        """
        action = checked_actions(self.core, action, self.action_space.shape)
        if self._over:
            raise gymnasium.error.ResetNeeded(
                f"{self.core.name}: call reset() to begin an episode."
            )
        s = self._state = self._programs.step(self._state, action)
        obs, reward, done, metrics = jax.device_get((s.obs, s.reward, s.done, s.metrics))
        self._over = bool(done > 0)
        return np.array(obs), float(reward), False, self._over, self._info(metrics)

    def render(self) -> np.ndarray | None:
        """Return an image, uint8 (height, width, 3), or None if made without a render mode."""
        if self.render_mode is None:
            spec_id = self.spec.id if self.spec else self.core.name
            gymnasium.logger.warn(
                f'{spec_id}.render() needs gymnasium.make("{spec_id}", render_mode="rgb_array").'
            )
            return None
        state = jax.device_get(self.state)
        if self._pictures is None:
            self._pictures = self._view.renderer(self.core, state)
        renderer, model, data = self._pictures
        self.core.write_mujoco(state, data, model)
        return renderer.render(data, self.core.markers(state))

    def close(self) -> None:
        """Free the renderer; compiled programs are kept for other instances."""
        self._forget_pictures()

    def _forget_pictures(self) -> None:
        if self._pictures is not None:
            self._pictures[0].close()
            self._pictures = None

    def _info(self, metrics: dict[str, np.ndarray]) -> dict[str, Any]:
        return info_of(metrics, self._lengths, float, int)


def register_envs() -> None:
    """Register every id with Gymnasium; may be called again after tasks or robots were added."""
    agym_jax.register_envs()


__all__ = ["ForkedProcessError", "GymnasiumEnv", "RenderModeError", "register_envs"]
