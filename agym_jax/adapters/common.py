"""Code shared by the ``gymnasium.Env`` and ``gymnasium.vector.VectorEnv`` adapters: checks, spaces, rendering, infos."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import gymnasium
import jax
import mujoco
import numpy as np
from gymnasium import spaces

import agym_jax
from agym_jax.changes import change_task
from agym_jax.errors import ActionError, AgymError, checked_count, did_you_mean
from agym_jax.human.population import Population, checked_population
from agym_jax.memory import Memory, checked_memory
from agym_jax.registry import parse
from agym_jax.rendering.meshes import check_visuals
from agym_jax.rendering.render import Renderer
from agym_jax.sim.physics import choose_impl
from agym_jax.sim.pictures import check_camera
from agym_jax.variation import RobotVariation, checked_variation

RENDER_MODES = ("rgb_array",)


class RenderModeError(AgymError, ValueError):
    """A render mode that the environment does not have, or was not made with."""


class ForkedProcessError(AgymError, RuntimeError):
    """An environment in a process forked from one that already uses JAX, where it would hang."""


class _Process:
    """The process in which environments have been made."""

    pid: int | None = None


def refuse_fork() -> None:
    """Raise in a process that was forked from one that has made an environment.

    Raises:
        ForkedProcessError: if so; the message says what to use instead.
    """
    if _Process.pid not in (None, os.getpid()):
        raise ForkedProcessError(
            "JAX does not work in forked processes, such as those of gymnasium.make_vec(id, vectorization_mode='async'). Use "
            "gymnasium.make_vec(id, num_envs=64), which steps all environments together in threads and is faster; or new "
            "processes: make_vec(id, vectorization_mode='async', vector_kwargs={'context': 'spawn'})."
        )
    _Process.pid = os.getpid()


class Recipe(NamedTuple):
    """Arguments of ``agym_jax.make``; environments made with the same arguments share their compiled programs."""

    env_id: str
    impl: str
    humans: Population
    config: Any = None  # the task's whole record, None if it is as registered
    episode_length: int | None = None
    robot: RobotVariation | None = None
    memory: Memory = ()

    @classmethod
    def checked(
        cls,
        env_id: str,
        impl: str,
        humans: Any,
        config: Any,
        episode_length: int | None,
        robot: Any,
        memory: Any = None,
    ) -> Recipe:
        """Make a recipe from a user's arguments; see ``agym_jax.make``.

        Raises:
            AgymError: if something named does not exist, or an argument is invalid.
        """
        usual = parse(env_id).task
        task = change_task(usual, config, episode_length)
        changed = lambda name: getattr(task, name, None) != getattr(usual, name, None)  # noqa: E731
        return cls(
            env_id,
            choose_impl(impl, traced=False),
            checked_population(humans),
            task.config if changed("config") else None,  # pyrefly: ignore
            task.episode_length if changed("episode_length") else None,
            checked_variation(robot),
            checked_memory(memory, task.control.period),
        )

    def make(self) -> agym_jax.Env:
        """Make the environment."""
        return agym_jax.make(
            self.env_id,
            self.impl,
            self.humans,
            config=self.config,
            episode_length=self.episode_length,
            robot=self.robot,
            memory=self.memory,
        )


def key_of(generator: np.random.Generator) -> np.ndarray:
    """Draw the raw PRNG key of an episode from an environment's generator (2,)."""
    return np.asarray(jax.random.PRNGKey(int(generator.integers(2**31))))


def keys_of(seeds: Sequence[int | None]) -> np.ndarray:
    """Return the raw PRNG keys of episodes with the given seeds; None stands for a random seed (n, 2)."""
    return np.stack([key_of(gymnasium.utils.seeding.np_random(one)[0]) for one in seeds])


def lengths_of(env: agym_jax.Env) -> dict[str, int]:
    """Return the length of each agent's part of observation and action, as in Assistive Gym's ``info``."""
    return {
        f"{kind}_{agent}_len": sizes.get(agent, 0)
        for kind, sizes in (("obs", env.observation_sizes), ("action", env.action_sizes))
        for agent in ("robot", "human")
    }


def info_of(
    metrics: dict[str, Any],
    lengths: dict[str, int],
    real: Callable[[Any], Any],
    count: Callable[[Any], Any],
) -> dict[str, Any]:
    """Return Assistive Gym's ``info``, extended by the reward terms.

    Args:
        metrics: metrics of the state of one or several environments.
        lengths: result of ``lengths_of``.
        real: conversion of real numbers.
        count: conversion of whole numbers.
    """
    terms = {
        k.removeprefix("reward/"): real(v) for k, v in metrics.items() if k.startswith("reward/")
    }
    return {
        "total_force_on_human": real(metrics["force/on_human"]),
        "task_success": count(metrics["success"] > 0),
        "reward_terms": terms,
        **{name: count(size) for name, size in lengths.items()},
    }


def spaces_of(env: agym_jax.Env) -> tuple[spaces.Box, spaces.Box]:
    """Return the spaces of one environment's actions and observations."""
    actions = spaces.Box(-1.0, 1.0, (env.action_size,), np.float32)
    return actions, spaces.Box(-np.inf, np.inf, (env.observation_size,), np.float32)


def checked_actions(env: agym_jax.Env, actions: Any, shape: tuple[int, ...] | None) -> np.ndarray:
    """Check actions and return them as float32.

    Raises:
        ActionError: if they have a different shape, or NaN or infinite entries.
    """
    array = np.asarray(actions, np.float32)
    if array.shape != shape:
        raise ActionError(f"{env.name} takes actions of shape {shape}, got {array.shape}.")
    if not np.isfinite(array).all():
        raise ActionError(
            f"{env.name} takes finite actions of shape {shape}, got NaN or infinity: {array}."
        )
    return array


def begun(env: agym_jax.Env, state: Any) -> Any:
    """Return the state if there is one.

    Raises:
        gymnasium.error.ResetNeeded: if ``reset`` has not been called yet.
    """
    if state is None:
        raise gymnasium.error.ResetNeeded(f"{env.name} has no state before reset().")
    return state


def refuse_options(env: agym_jax.Env, options: dict[str, Any] | None) -> None:
    """Raise AgymError if any reset options are given."""
    if options:
        raise AgymError(f"{env.name} has no reset options, got: {', '.join(options)}.")


class View(NamedTuple):
    """Settings for rendering."""

    width: int  # [pixels]
    height: int  # [pixels]
    camera: str | int
    visuals: str  # of the robot, see ``agym_jax.rendering.meshes``

    @classmethod
    def checked(
        cls,
        env_id: str,
        render_mode: str | None,
        width: int,
        height: int,
        camera: str | int,
        visuals: str,
    ) -> View:
        """Check the render settings of an environment.

        Raises:
            RenderModeError: if there is no such render mode; the message suggests the closest match.
            UnknownNameError: if there is no such environment, or there are no such visuals.
            ArgumentError: if the width or height is not positive.
            UnknownCameraError: if there is no such camera.
        """
        if render_mode is not None and render_mode not in RENDER_MODES:
            raise RenderModeError(
                f"{env_id} has no render mode {render_mode!r}. {did_you_mean(render_mode, RENDER_MODES)}"
            )
        check_visuals(visuals, parse(env_id).robot)
        check_camera(camera)
        return cls(checked_count("width", width), checked_count("height", height), camera, visuals)

    def renderer(
        self, env: agym_jax.Env, state: Any
    ) -> tuple[Renderer, mujoco.MjModel, mujoco.MjData]:
        """Return a renderer for the episode of a state, on the host, and the model and data that it draws."""
        model, data = env.to_mujoco(state, self.visuals)
        return Renderer(model, self.width, self.height, self.camera), model, data
