"""Random actions, or a policy's, in many environments at once: what throughput and the NaN search run."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp

import agym_jax
from agym_jax.wrappers import vectorize

CHUNK = 50  # control steps in one compiled call, if nobody wants fewer
Totals = dict[str, jax.Array]
Extra = Callable[[Totals, Any], Totals]
Act = Callable[[jax.Array], jax.Array]


def make_batch(env_name: str, impl: str, num_envs: int, memory: Sequence[float] = ()) -> Any:
    """The vectorised, auto-resetting environment; ``memory`` as in ``agym_jax.make``."""
    return vectorize(agym_jax.make(env_name, impl=impl, memory=memory), num_envs)


def first_state(venv: Any, key: jax.Array) -> Any:
    """Environments at random steps of their first episode, so that some reset in every step."""
    key_reset, key_stagger = jax.random.split(key)
    return strong(venv.stagger(venv.reset(key_reset), key_stagger, interval=1))


def strong(tree: Any) -> Any:
    """The tree without weak types, so that nothing compiles twice."""
    return jax.tree.map(lambda x: jax.lax.convert_element_type(x, x.dtype), tree)


def zero_totals() -> Totals:
    """Counts of nothing."""
    names = ("nan", "overflow", "episodes")
    return dict.fromkeys(names, jnp.zeros((), jnp.int32)) | {"reward": jnp.zeros(())}


def run_steps(
    venv: Any, extra: Extra | None = None, steps: int = CHUNK, act: Act | None = None
) -> Callable[..., tuple[Any, Totals]]:
    """The function to compile: ``run(state, key, totals)``, some steps of every environment.

    Args:
        venv: from ``make_batch``.
        extra: adds to totals of its own after each step, given the state of the batch.
        steps: of a call.
        act: actions (num_envs, action) of a batch of observations; None draws them uniformly from [-1, 1].

    Returns:
        ``run``, which returns the state and the totals: environment steps that went non-finite
        (``nan``) or lost contacts (``overflow``), ``episodes`` ended, sum of ``reward``.
    """

    def run(state: Any, key: jax.Array, totals: Totals) -> tuple[Any, Totals]:
        def step(carry: tuple, key: jax.Array) -> tuple[tuple, None]:
            state, totals = carry
            shape = (venv.num_envs, venv.action_size)
            action = act(state.obs) if act else jax.random.uniform(key, shape, minval=-1, maxval=1)
            state = strong(venv.step(state, action))
            counts = {
                "nan": state.metrics["nan"],
                "overflow": state.metrics["overflow"],
                "episodes": state.done,
            }
            gains = {k: jnp.sum(v > 0, dtype=jnp.int32) for k, v in counts.items()}
            gains["reward"] = jnp.sum(state.reward)
            totals = totals | {k: totals[k] + v for k, v in gains.items()}
            return (state, extra(totals, state) if extra else totals), None

        return jax.lax.scan(step, (state, totals), jax.random.split(key, steps))[0]

    return run


def peak_memory_mb() -> float | None:
    """Most device memory that this process has used [MB]; None where JAX cannot tell."""
    stats = jax.local_devices()[0].memory_stats() or {}
    peak = stats.get("peak_bytes_in_use")
    return None if peak is None else round(peak / 1e6, 1)
