"""Every environment as a ``gymnasium.Env``: one world, NumPy in and out, a fresh human each episode.

    import agym_jax, gymnasium
    env = gymnasium.make("ScratchItchJaco-v0", render_mode="rgb_array")

Training belongs on ``agym_jax.wrappers.vectorize``, which steps thousands of envs at once; this is
for looking, for scripts, and for code that knows only gymnasium. On a CPU the physics is C MuJoCo's, so
that the first step comes within seconds; ``impl="jax"`` is the one that is trained on, in one world.

DEVIATION(gymnasium-bounds): the observation space is unbounded; AG declares [-1, 1], which its
observations exceed.
"""

from __future__ import annotations

from collections.abc import Mapping
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
    """An environment and its functions, compiled where they can be; all that are made of the same share them."""

    env: agym_jax.Env
    reset: Any
    step: Any


@cache
def _programs(recipe: Recipe) -> _Programs:
    env = recipe.make()
    return _Programs(env, *env.jit_functions())


class GymnasiumEnv(gymnasium.Env):
    """One environment of an environment.

    Episodes are truncated after 200 steps (``episode_length``), as all of Assistive Gym's are; they terminate only when
    the physics fails. ``info`` has Assistive Gym's keys and the reward's terms.

    ``copy.deepcopy`` and ``pickle`` keep the state of the episode and the generator of the episodes to come: a copy goes
    on as the original would, and neither changes the other, so a planner can try actions in copies. They share what is compiled.

    Args:
        env_id: as in ``agym_jax.list_envs()``.
        render_mode: ``"rgb_array"``, or None for no pictures.
        impl: physics, see ``agym_jax.make``; ``"auto"`` is ``"native"`` on a CPU.
        humans: the population, see ``agym_jax.make``.
        width: of pictures [pixels].
        height: of pictures [pixels].
        camera: name or number of the camera.
        visuals: of the robot in pictures, ``"primitives"`` or ``"meshes"``, see ``agym_jax.rendering.meshes``.
        config: weights and thresholds of the task, see ``agym_jax.make``.
        episode_length: control steps of an episode, see ``agym_jax.make``.
        robot: how robots vary, see ``agym_jax.make``.

    Raises:
        UnknownNameError: there is no such id or setting, or there are no such looks.
        MissingExtraError: the meshes' package is not installed: ``pip install "agym_jax[meshes]"``.
        MeshError: this robot has no meshes, or they do not fit it.
        RenderModeError: there is no such render mode.
        ImplementationError: there is no such physics, or it is not installed.
        ForkedProcessError: this process is a copy of one that has made an environment already.
        ArgumentError: ``humans`` is no population, a setting or length makes no sense, or pictures have no pixels.
        UnknownCameraError: there is no such camera.
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
    ):
        self._view = View.checked(env_id, render_mode, width, height, camera, visuals)
        self._made_of = Recipe.checked(env_id, impl, humans, config, episode_length, robot)
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
        """All but programs, which are found or compiled again, and windows of the renderer."""
        kept = {name: x for name, x in vars(self).items() if name not in ("_programs", "_pictures")}
        return kept | {"_state": jax.device_get(self._state)}

    def __setstate__(self, kept: dict[str, Any]) -> None:
        vars(self).update(kept)
        self._programs, self._pictures = _programs(self._made_of), None

    @property
    def core(self) -> agym_jax.Env:
        """The pure environment underneath."""
        return self._programs.env

    @property
    def state(self) -> agym_jax.State:
        """The world as it is now.

        Raises:
            gymnasium.error.ResetNeeded: there is none yet.
        """
        return begun(self.core, self._state)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Begin an episode: another person, goal and start.

        Args:
            seed: of this episode and, through the generator, of those that follow.
            options: none are known.
        """
        super().reset(seed=seed)
        refuse_options(self.core, options)
        self._state = self._programs.reset(key_of(self.np_random))
        self._over = False
        self._forget_pictures()  # they show the person before
        return np.array(self._state.obs), self._info(jax.device_get(self._state.metrics))

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        """One control step of 0.1 s.

        Args:
            action: in [-1, 1]: robot's joints, then the active person's.

        Raises:
            ActionError: the action has another shape, or NaN or infinite entries.
            gymnasium.error.ResetNeeded: the episode has not begun, or is over.
        """
        action = checked_actions(self.core, action, self.action_space.shape)
        if self._over:
            raise gymnasium.error.ResetNeeded(
                f"{self.core.name}: call reset() to begin an episode."
            )
        self._state = self._programs.step(self._state, action)
        s = self._state
        obs, reward, done, metrics = jax.device_get((s.obs, s.reward, s.done, s.metrics))
        terminated = bool(metrics["nan"] > 0)
        truncated = bool(done > 0) and not terminated
        self._over = terminated or truncated
        return np.array(obs), float(reward), terminated, truncated, self._info(metrics)

    def render(self) -> np.ndarray | None:
        """A picture, uint8 (height, width, 3), or None if made without a render mode."""
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
        """Free the renderer; the compiled programs stay for other instances."""
        self._forget_pictures()

    def _forget_pictures(self) -> None:
        if self._pictures is not None:
            self._pictures[0].close()
            self._pictures = None

    def _info(self, metrics: dict[str, np.ndarray]) -> dict[str, Any]:
        return info_of(metrics, self._lengths, float, int)


def register_envs() -> None:
    """Make every id known to gymnasium; again after tasks or robots were added, as often as you like."""
    agym_jax.register_envs()


__all__ = ["ForkedProcessError", "GymnasiumEnv", "RenderModeError", "register_envs"]
