"""Many environments with PyTorch's tensors in and out, which share the memory of JAX's arrays: nothing is copied.

    from agym_jax.adapters.torch import TorchVectorEnv
    envs = TorchVectorEnv("ScratchItchJaco-v0", num_envs=4096)
    obs, info = envs.reset(seed=0)
    obs, reward, terminated, truncated, info = envs.step(actions)

On an NVIDIA GPU the physics is MuJoCo Warp's and all tensors stay on the GPU (DLPack); on a CPU it is C MuJoCo's, in threads. For
rsl_rl, skrl and Stable-Baselines3 see the modules of their names beside this one. Needs the extra ``[torch]``.
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
        'PyTorch is not installed: pip install "agym_jax[torch]". Without it, gymnasium.make_vec has NumPy\'s arrays, and '
        "agym_jax.wrappers.vectorize JAX's."
    ) from error


class TorchVectorEnv:
    """``num_envs`` environments, stepped together; what ends begins anew, as somebody else, in the same step.

    The observation of a step in which an episode ended is the first of the next one; ``info["final_observation"]`` has the true
    last one. Seeds mean what they mean to ``gymnasium.make_vec``. Tensors share memory with arrays of JAX or NumPy, and some with each
    other: clone what you want to change in place.

    Args:
        env: id, as in ``agym_jax.list_envs()``, or an environment of ``agym_jax.make``, whose settings then hold. Several
            batches of one such environment share what is compiled.
        num_envs: how many.
        impl: physics, see ``agym_jax.make``; ``"auto"`` is ``"native"`` on a CPU. Only with an id.
        **settings: more of ``agym_jax.make``'s, such as ``humans``. Only with an id.

    Raises:
        UnknownNameError: there is no such id.
        ArgumentError: a number of environments or a setting that makes no sense.
        ImplementationError: there is no such physics, or PyTorch cannot use the device that it runs on.
        ForkedProcessError: this process is a copy of one that has made an environment already.
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
                f"{given}: settings belong to agym_jax.make, which this environment is from."
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
        """The pure environment underneath."""
        return self.envs.env

    @property
    def state(self) -> agym_jax.State:
        """All environments as they are now, in JAX's or NumPy's arrays (num_envs, ...).

        Raises:
            gymnasium.error.ResetNeeded: there is none yet.
        """
        return begun(self.core, self._carried).state(self._arrays)

    @property
    def observations(self) -> torch.Tensor:
        """What is observed now (num_envs, n_obs)."""
        return self.tensor(self.state.obs)

    @property
    def privileged(self) -> torch.Tensor | None:
        """What value functions may see besides (num_envs, n_privileged); None where there is nothing."""
        extra = self.state.privileged_obs
        return None if extra is None else self.tensor(extra)

    @property
    def clocks(self) -> torch.Tensor:
        """Steps done in each episode, int32 (num_envs,)."""
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
            seed: of the first environment, the next ones have the numbers after it. None: random at first, and then what
                follows from the seed before.

        Returns:
            What is observed (num_envs, n_obs), and an info as that of ``step``.
        """
        if seed is not None:
            self._seeds = gymnasium.utils.seeding.np_random(seed)[0]
            seeds = [seed + i for i in range(self.num_envs)]
        else:
            seeds = [int(x) for x in self._seeds.integers(2**31, size=self.num_envs)]
        if self.device.type == "cuda":  # JAX may take over memory that PyTorch's kernels still read
            torch.cuda.synchronize(self.device)
        self._go_on_from(self._reset(keys_of(seeds)))
        return self.observations, self._info(self.tensor(self.state.info["final_observation"]))

    def step(
        self, actions: torch.Tensor
    ) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor, dict[str, Any]]:
        """One control step of 0.1 s of every environment.

        Args:
            actions: in [-1, 1], clipped (num_envs, n_action). On a GPU nobody looks whether they are finite: NaN and infinity
                act as 0.

        Returns:
            Observations (num_envs, n_obs), rewards (num_envs,), and where episodes ended by a failure of the physics
            and by their length, bool (num_envs,). The info has ``final_observation`` (num_envs, n_obs) and ``metrics``,
            which names rewards' terms, forces and ``success`` as ``State.metrics`` does, each (num_envs,).

        Raises:
            ActionError: they are no tensor, have another shape or device, or (on a CPU) NaN or infinite entries.
            gymnasium.error.ResetNeeded: nothing has begun.
        """
        begun(self.core, self._carried)
        action = self.array(self._checked(actions))
        self._arrays, told = self._step(self._arrays, action)
        tensors = map(self.tensor, told) if self._native else self._unpacked(self.tensor(told))
        obs, final, reward, terminated, truncated = tensors
        return obs, reward, terminated, truncated, self._info(final)

    def tensor(self, array: Any) -> torch.Tensor:
        """An array of the state as a tensor on ``device`` that shares its memory."""
        return torch.from_numpy(array) if self._native else torch.from_dlpack(array)

    def array(self, tensor: torch.Tensor) -> Any:
        """A tensor on ``device`` as an array that shares its memory, for ``state``."""
        tensor = tensor.detach()
        return tensor.numpy() if self._native else jnp.from_dlpack(tensor.contiguous())

    def close(self) -> None:
        """Nothing is left to close; what libraries call in the end."""

    def _go_on_from(self, state: Any) -> None:
        self._carried = self._carried or Carried(state)
        self._arrays = self._carried.arrays(state)

    def _stepped(self, arrays: list[Any], action: Any) -> tuple[list[Any], Any]:
        """The arrays of the next state, and what ``step`` tells of it.

        That is observations and final ones (num_envs, n_obs), rewards, and where episodes ended by a failure and by their
        length (num_envs,); but on an accelerator all of it is one array, as every array that becomes a tensor and every
        kernel of PyTorch's takes time of the thread that also starts the physics.
        """
        state = self.envs.step(self._carried.state(arrays), action)
        truncated = state.info["truncation"] > 0
        ends = (state.done > 0) & ~truncated, truncated
        told = (state.obs, state.info["final_observation"], state.reward, *ends)
        return self._carried.arrays(state), told if self._native else packed(told)

    def _unpacked(self, told: torch.Tensor) -> Iterator[torch.Tensor]:
        """What ``_stepped`` tells, as views of what ``packed`` has made of it."""
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
    """``num_envs`` environments behind the interface of a library that trains.

    Args:
        env: see ``TorchVectorEnv``.
        num_envs: how many.
        seed: of the first episodes, and of those that follow.
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
        """What the library expects of an object that is made."""

    def close(self) -> None:
        """See ``TorchVectorEnv``."""
        self.envs.close()


class Tensors(Mapping[str, torch.Tensor]):
    """The metrics of a state, which become tensors when they are read.

    Args:
        tensor: makes a tensor of an array.
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
    """The bits of arrays one after the other, int32 (n,): four entries of a bool array in each, one of another."""

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
    """Share of successes among the episodes that ended in a step (); None if none did."""
    ended = terminated | truncated
    return info["metrics"]["success"][ended].mean() if ended.any() else None


def _device() -> torch.device:
    """Where JAX's arrays are, in PyTorch's words.

    Raises:
        ImplementationError: PyTorch cannot use it.
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
