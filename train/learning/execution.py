"""How the loops of training and evaluation run: inside one compiled program, or from Python.

A program of many updates, or of whole episodes, contains the environment's step and compiles it anew. Where that
takes a minute, as MJX does on a CPU, the reset and step of a batch are compiled once (``StepwiseEnv``) and called from
Python again and again, which costs nothing where a step takes milliseconds. C MuJoCo is always called so.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from agym_jax.state import strong

from ..envs import is_native
from ..errors import ConfigError

Step = Callable[[Any, Any], tuple[Any, Any]]


@dataclass(frozen=True)
class Execution:
    """The loops that an update or an episode is written with.

    Attributes:
        scan: as ``jax.lax.scan`` with two arguments and a sequence.
        fori_loop: as ``jax.lax.fori_loop``.
        compile: what is done to a function that the loops call at every turn.
        records_later: whether note of steps is taken when all have been made, in one call.
    """

    scan: Callable[[Step, Any, Any], tuple[Any, Any]]
    fori_loop: Callable[[Any, Any, Callable[[Any, Any], Any], Any], Any]
    compile: Callable[[Callable[..., Any]], Callable[..., Any]]
    records_later: bool


def _python_scan(step: Step, carry: Any, xs: Any) -> tuple[Any, Any]:
    outputs, xs = [], jax.device_get(xs)  # JAX takes 0.2 ms to index an array
    for i in range(len(jax.tree.leaves(xs)[0])):
        carry, output = step(carry, jax.tree.map(lambda x, i=i: x[i], xs))
        outputs.append(output)
    # in NumPy: stacking many small arrays takes JAX longer than the steps
    return carry, jax.tree.map(lambda *leaves: np.stack(leaves), *jax.device_get(outputs))


def _python_fori_loop(start: Any, stop: Any, body: Callable[[Any, Any], Any], carry: Any) -> Any:
    for i in range(int(start), int(stop)):
        carry = body(i, carry)
    return carry


ONE_PROGRAM = Execution(jax.lax.scan, jax.lax.fori_loop, lambda function: function, False)
"""For functions that are compiled as a whole."""
STEPWISE = Execution(
    _python_scan, _python_fori_loop, functools.lru_cache(maxsize=32)(jax.jit), True
)
"""For environments whose step is called from Python."""


def execution_of(venv: Any) -> Execution:
    """How loops around vectorised environments run: from Python where their step cannot be compiled in."""
    return STEPWISE if isinstance(venv, StepwiseEnv) or is_native(venv) else ONE_PROGRAM


class StepwiseEnv:
    """A vectorised environment whose ``reset`` and ``step`` are compiled programs.

    Args:
        venv: vectorised, auto-resetting environment.
    """

    def __init__(self, venv: Any) -> None:
        self.venv, self.num_envs = venv, venv.num_envs
        keys = jax.random.split(jax.random.PRNGKey(0), venv.num_envs)
        reset = jax.jit(lambda keys: strong(venv.reset(keys))).lower(keys)
        action = jax.ShapeDtypeStruct((venv.num_envs, venv.action_size), jnp.float32)
        state = jax.tree.map(lambda x: jax.ShapeDtypeStruct(x.shape, x.dtype), reset.out_info)
        step = jax.jit(lambda state, action: strong(venv.step(state, action))).lower(state, action)
        self.step, self._reset = compile_together(step, reset)

    def reset(self, key: jax.Array) -> Any:
        """A batch of fresh episodes, from one key or one for each environment."""
        return self._reset(jax.random.split(key, self.num_envs) if key.ndim == 1 else key)

    def vectorize(self, num_envs: int) -> StepwiseEnv:
        """Itself: the batch size is compiled in.

        Raises:
            ConfigError: another number of environments was asked for.
        """
        if num_envs != self.num_envs:
            raise ConfigError(
                f"This StepwiseEnv is compiled for {self.num_envs} environments, not {num_envs}. Set "
                f"num_envs={self.num_envs}, or make another StepwiseEnv."
            )
        return self

    def __getattr__(self, name: str) -> Any:
        if name == "venv":
            raise AttributeError(name)
        return getattr(self.venv if hasattr(self.venv, name) else self.venv.env, name)


def compile_together(*programs: Any, options: dict[str, Any] | None = None) -> list[Any]:
    """Compile lowered programs at the same time: XLA works outside of Python's lock.

    Args:
        programs: from ``jax.jit(...).lower(...)``.
        options: of the compiler.
    """
    with ThreadPoolExecutor(len(programs)) as pool:
        return list(pool.map(lambda program: program.compile(compiler_options=options), programs))
