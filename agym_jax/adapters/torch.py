"""Batches of environments with PyTorch tensors in and out, which share memory with JAX's arrays: nothing is copied.

    from agym_jax.adapters.torch import TorchVectorEnv
    envs = TorchVectorEnv("ScratchItchJaco-v0", num_envs=4096)
    obs, info = envs.reset(seed=0)
    obs, reward, terminated, truncated, info = envs.step(actions)

On an NVIDIA GPU the physics is MuJoCo Warp and all tensors stay on the GPU (DLPack); on a CPU it is multi-threaded
C MuJoCo. For rsl_rl, skrl and Stable-Baselines3, see the modules of those names in this package. Requires the extra
``[torch]``.
"""

from __future__ import annotations

import dataclasses
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator, Mapping
from functools import partial
from typing import Any

import gymnasium
import jax
import jax.numpy as jnp

import agym_jax
from agym_jax.adapters.carried import Carried
from agym_jax.adapters.common import begun, keys_of, refuse_fork, spaces_of
from agym_jax.errors import ActionError, ArgumentError, ImplementationError, MissingExtraError
from agym_jax.sim.physics import choose_impl
from agym_jax.wrappers import vectorize

try:
    import torch
except ImportError as error:
    raise MissingExtraError(
        'PyTorch is not installed: pip install "agym_jax[torch]". Without it, use gymnasium.make_vec (NumPy arrays) or '
        "agym_jax.wrappers.vectorize (JAX arrays)."
    ) from error


class TorchVectorEnv:
    """``num_envs`` environments stepped together; a finished episode is replaced in the same step, with a new person.

    In a step that ends an episode, the observation is the first of the next episode; ``info["final_observation"]`` has
    the last observation of the finished one. Seeds work as in ``gymnasium.make_vec``. Tensors share memory with JAX or
    NumPy arrays, and some of them with each other: clone those that you want to modify in place.

    Args:
        env: environment id, see ``agym_jax.list_envs()``, or an environment from ``agym_jax.make``, whose settings are
            used. Several batches of one such environment share the compiled programs.
        num_envs: number of environments.
        impl: physics implementation, see ``agym_jax.make``; ``"auto"`` means ``"native"`` on a CPU. Only with an id.
        **settings: further arguments of ``agym_jax.make``, such as ``humans``. Only with an id.

    Raises:
        UnknownNameError: if there is no such id.
        ArgumentError: if the number of environments or a setting is invalid.
        ImplementationError: if there is no such physics, or PyTorch cannot use the device that it runs on.
        ForkedProcessError: if this process was forked from one that has already made an environment.
    """

    def __init__(
        self, env: str | agym_jax.Env, num_envs: int = 1, impl: str = "auto", **settings: Any
    ):
        refuse_fork()
        if isinstance(env, str):
            env = agym_jax.make(env, choose_impl(impl, traced=False), **settings)
        elif settings or impl != "auto":
            given = ", ".join([*settings, *(["impl"] if impl != "auto" else [])])
            raise ArgumentError(
                f"{given}: pass settings to agym_jax.make, which made this environment."
            )
        self.envs = vectorize(env, num_envs)
        self.num_envs = self.envs.num_envs
        self.episode_length = self.envs.episode_length
        self._native = getattr(env, "native_rows", None) is not None
        self.device = torch.device("cpu") if self._native else _device()
        self.action_space, self.observation_space = spaces_of(env)
        compiled: Any = (lambda f: f) if self._native else jax.jit
        self._reset, self._step = compiled(self.envs.reset), compiled(self._stepped)
        self._seeds = gymnasium.utils.seeding.np_random(None)[0]
        self._carried: Any = None  # from the first reset on
        self._arrays: list[Any] = []  # of the state

    @property
    def core(self) -> agym_jax.Env:
        """The underlying pure environment."""
        return self.envs.env

    @property
    def state(self) -> agym_jax.State:
        """The current state of all environments, in JAX or NumPy arrays (num_envs, ...).

        Raises:
            gymnasium.error.ResetNeeded: if ``reset`` has not been called yet.
        """
        return begun(self.core, self._carried).state(self._arrays)

    @property
    def observations(self) -> torch.Tensor:
        """Current observations (num_envs, n_obs)."""
        return self.tensor(self.state.obs)

    @property
    def privileged(self) -> torch.Tensor | None:
        """Privileged observations for value functions (num_envs, n_privileged); None if the task has none."""
        extra = self.state.privileged_obs
        return None if extra is None else self.tensor(extra)

    @property
    def clocks(self) -> torch.Tensor:
        """Steps taken in each episode, int32 (num_envs,)."""
        return self.tensor(self.state.episode.step)

    @clocks.setter
    def clocks(self, steps: torch.Tensor) -> None:
        state = self.state
        clock = self.array(steps.to(self.device, torch.int32))
        episode = dataclasses.replace(state.episode, step=clock)
        self._go_on_from(state.replace(episode=episode))

    def reset(self, seed: int | None = None) -> tuple[torch.Tensor, dict[str, Any]]:
        """Begin an episode in every environment.

        Args:
            seed: seed of the first environment; the others use the numbers after it. None: random on the first reset,
                afterwards determined by the previous seed.

        Returns:
            Observations (num_envs, n_obs), and an info as returned by ``step``.
        """
        if seed is not None:
            self._seeds = gymnasium.utils.seeding.np_random(int(seed))[0]
            seeds = [int(seed) + i for i in range(self.num_envs)]
        else:
            seeds = [int(x) for x in self._seeds.integers(2**31, size=self.num_envs)]
        if self.device.type == "cuda":  # JAX may take over memory that PyTorch's kernels still read
            torch.cuda.synchronize(self.device)
        self._go_on_from(self._reset(keys_of(seeds)))
        return self.observations, self._info(self.tensor(self.state.info["final_observation"]))

    def step(
        self, actions: torch.Tensor
    ) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor, dict[str, Any]]:
        """Advance every environment by one control step of 0.1 s.

        Args:
            actions: (num_envs, n_action). Beyond [-1, 1] joints move as at the bound, but the penalty goes on growing. On a GPU actions
                are not checked for finite values: NaN and infinity act as 0.

        Returns:
            Observations (num_envs, n_obs), rewards (num_envs,), whether episodes terminated (none does), and whether they
            were truncated, at their length or because the simulation diverged, bool (num_envs,). The info has ``final_observation``
            (num_envs, n_obs) and ``metrics``, with the reward terms, forces and ``success`` under the names used in
            ``State.metrics``, each (num_envs,).

        Raises:
            ActionError: if they are not a tensor, have a different shape or device, or (on a CPU) NaN or infinite
                entries.
            gymnasium.error.ResetNeeded: if ``reset`` has not been called yet.
        """
        begun(self.core, self._carried)
        action = self.array(self._checked(actions))
        self._arrays, told = self._step(self._arrays, action)
        tensors = map(self.tensor, told) if self._native else self._unpacked(self.tensor(told))
        obs, final, reward, terminated, truncated = tensors
        return obs, reward, terminated, truncated, self._info(final)

    def tensor(self, array: Any) -> torch.Tensor:
        """Return an array of the state as a tensor on ``device`` that shares its memory."""
        return torch.from_numpy(array) if self._native else torch.from_dlpack(array)

    def array(self, tensor: torch.Tensor) -> Any:
        """Return a tensor on ``device`` as an array that shares its memory, for use in ``state``."""
        tensor = tensor.detach()
        return tensor.numpy() if self._native else jnp.from_dlpack(tensor.contiguous())

    def close(self) -> None:
        """Do nothing; provided for libraries that call it."""

    def _go_on_from(self, state: Any) -> None:
        self._carried = self._carried or Carried(state)
        self._arrays = self._carried.arrays(state)

    def _stepped(self, arrays: list[Any], action: Any) -> tuple[list[Any], Any]:
        """Return the arrays of the next state, and the results that ``step`` reports.

        These are observations and final observations (num_envs, n_obs), rewards, and whether episodes terminated or were
        truncated (num_envs,). On an accelerator they are packed into one array, because every array that is converted to a
        tensor and every PyTorch kernel costs time on the thread that also launches the physics.
        """
        state = self.envs.step(self._carried.state(arrays), action)
        truncated = state.info["truncation"] > 0
        ends = (state.done > 0) & ~truncated, truncated
        told = (state.obs, state.info["final_observation"], state.reward, *ends)
        return self._carried.arrays(state), told if self._native else packed(told)

    def _unpacked(self, told: torch.Tensor) -> Iterator[torch.Tensor]:
        """Return the results of ``_stepped`` as views of the array made by ``packed``."""
        n, width = self.num_envs, self.core.observation_size
        words = [n * width, n * width, n, -(-n // 4), -(-n // 4)]
        obs, final, reward, *ends = told.split(words)
        yield obs.view(torch.float32).view(n, width)
        yield final.view(torch.float32).view(n, width)
        yield reward.view(torch.float32)
        for end in ends:
            yield end.view(torch.bool)[:n]

    def _info(self, final: torch.Tensor) -> dict[str, Any]:
        state = partial(self._carried.state, self._arrays)
        return {"final_observation": final, "metrics": Tensors(self.tensor, state)}

    def _checked(self, actions: Any) -> torch.Tensor:
        name, shape = self.core.name, (self.num_envs, self.envs.action_size)
        if not isinstance(actions, torch.Tensor):
            raise ActionError(
                f"{name} in PyTorch takes a tensor of actions, got {type(actions).__name__}: "
                "torch.as_tensor(actions, device=envs.device) makes one."
            )
        if tuple(actions.shape) != shape:
            raise ActionError(
                f"{name} in a batch of {self.num_envs} takes actions of shape {shape}, got {tuple(actions.shape)}."
            )
        if actions.device != self.device:
            raise ActionError(
                f"{name} takes actions on {self.device}, got them on {actions.device}: actions.to(envs.device) moves them."
            )
        actions = actions.to(torch.float32)
        if self.device.type == "cpu" and not torch.isfinite(actions).all():
            raise ActionError(
                f"{name} takes finite actions of shape {shape}, got NaN or infinity: {actions}."
            )
        return actions


class TrainerEnv(ABC):
    """Base class of ``num_envs`` environments with the interface of a training library.

    Args:
        env: see ``TorchVectorEnv``.
        num_envs: number of environments.
        seed: seed of the first episodes, which also determines those that follow.
        **settings: see ``TorchVectorEnv``.

    Raises:
        AgymError: see ``TorchVectorEnv``.

    Attributes:
        envs: the environments.
    """

    def __init__(
        self,
        env: str | agym_jax.Env,
        num_envs: int = 1,
        seed: int | None = None,
        **settings: Any,
    ):
        self.envs = TorchVectorEnv(env, num_envs, **settings)
        self._prepare(seed)

    @abstractmethod
    def _prepare(self, seed: int | None) -> None:
        """Set up what the library expects of a new object."""

    def close(self) -> None:
        """See ``TorchVectorEnv``."""
        self.envs.close()


class Tensors(Mapping[str, torch.Tensor]):
    """The metrics of a state, converted to tensors when they are read.

    Args:
        tensor: converts an array to a tensor.
        state: returns the state.
    """

    def __init__(self, tensor: Callable[[Any], torch.Tensor], state: Callable[[], Any]):
        self._tensor, self._state = tensor, state

    def __getitem__(self, name: str) -> torch.Tensor:
        return self._tensor(self._state().metrics[name])

    def __iter__(self) -> Iterator[str]:
        return iter(self._state().metrics)

    def __len__(self) -> int:
        return len(self._state().metrics)


def packed(arrays: Iterable[jax.Array]) -> jax.Array:
    """Concatenate the bits of arrays, int32 (n,): each holds four entries of a bool array, or one of any other array."""

    def words(array: jax.Array) -> jax.Array:
        array = jnp.ravel(array)
        if array.dtype != bool:
            return jax.lax.bitcast_convert_type(array.astype(jnp.float32), jnp.int32)
        whole = jnp.pad(array.astype(jnp.uint8), (0, -len(array) % 4))
        return jax.lax.bitcast_convert_type(whole.reshape(-1, 4), jnp.int32)

    return jnp.concatenate([words(x) for x in arrays])


def success_of_ended(
    info: Mapping[str, Any], terminated: torch.Tensor, truncated: torch.Tensor
) -> torch.Tensor | None:
    """Return the success rate of the episodes that ended in a step (); None if none did."""
    ended = terminated | truncated
    return info["metrics"]["success"][ended].mean() if ended.any() else None


def _device() -> torch.device:
    """Return the device of JAX's arrays as a PyTorch device.

    Raises:
        ImplementationError: if PyTorch cannot use it.
    """
    platform = jax.default_backend()
    if platform == "cpu":
        return torch.device("cpu")
    if platform == "gpu" and torch.cuda.is_available():
        return torch.device("cuda", jax.local_devices()[0].local_hardware_id or 0)
    raise ImplementationError(
        f"JAX runs on {platform!r} here, which PyTorch {torch.__version__} cannot use. Install a PyTorch with CUDA, or run "
        'everything on the CPU: JAX_PLATFORMS=cpu, or impl="native".'
    )


__all__ = ["Tensors", "TorchVectorEnv", "TrainerEnv", "packed", "success_of_ended"]
