"""Memory: running averages of what an agent observes, appended to its observation. Off by default.

Assistive Gym's observations show the present. In BedBathing, for example, no column tells which part of the arm has been
wiped already, and a policy without memory tends to go on wiping where it is. ``agym_jax.make(id, memory=(0.3, 4.0))``
appends two averages of each column to an agent's observation, over the last 0.3 and 4 s or so: exponential moving averages
that begin with the first observation of the episode. They contain nothing that the agent has not observed itself (also known as memory
traces: Eberhard, Muehlebach and Vernade 2025, "Partially observable reinforcement learning with memory traces").
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from agym_jax import observe
from agym_jax.errors import ArgumentError
from agym_jax.spec import Task

MEMORY = "memory"
"""Name of the setting."""
Memory = tuple[float, ...]
"""Time constants of the averages [s]; empty without memory."""
SHIPPED: Memory = (0.3, 4.0)
"""That of the shipped policies that have one."""
Averages = tuple[jax.Array, ...]
"""Of the observation of each agent, in order    (memory, n_obs) each."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Past:
    """What the next observation depends on besides the simulation."""

    quats: Any  # as last observed, wxyz, see ``sense.quats_of``    (n, 4)
    averages: Averages | None = None  # None without memory


def checked_memory(memory: Any, period: float) -> Memory:
    """Return the time constants [s] in ascending order.

    Args:
        memory: a sequence of them, or None for no memory.
        period: length of a control step [s].

    Raises:
        ArgumentError: if they are not finite numbers that differ by a millisecond or more, each at least as long as two
            control steps.
    """
    given = () if memory is None else memory
    real = isinstance(given, Sequence) and not isinstance(given, str)
    real = real and all(isinstance(x, (int, float)) and not isinstance(x, bool) for x in given)
    long = real and all(2 * period <= x < math.inf for x in given)
    if not long or len({_mean_over(x) for x in given}) < len(given):
        raise ArgumentError(
            f"memory must be a tuple of different time constants in seconds, such as {SHIPPED}, each at least {2 * period:g} s "
            f"(two control steps) and a millisecond apart, got {memory!r}."
        )
    return tuple(sorted(map(float, given)))


@cache
def with_memory(record: type, memory: Memory) -> type:
    """Return the record of an observation with the columns of its averages; they are named ``tool_force_mean_4000ms``.

    Args:
        record: an ``agym_jax.observe.observation``.
        memory: from ``checked_memory``.
    """
    if not memory:
        return record
    fields = {
        name + suffix: observe.column(c.size, c.unit, c.frame + over, c.source)
        for suffix, over in (("", ""), *(_mean_over(x) for x in memory))
        for name, c in observe.columns(record).items()
    }
    types = dict.fromkeys(fields, jax.Array)
    return observe.observation(type(record.__name__, (), {**fields, "__annotations__": types}))


def observation_records(task: Task, active: bool, memory: Memory) -> dict[str, type]:
    """Return the record of each agent's observation, in order, with its averages.

    Args:
        task: the task.
        active: whether the person acts too.
        memory: from ``checked_memory``.
    """
    records = {"robot": task.robot_obs}
    records |= {"human": task.human_obs} if active else {}
    return {agent: with_memory(record, memory) for agent, record in records.items()}


def _mean_over(time: float) -> tuple[str, str]:
    """Return what is added to the name and to the frame of a column whose average is taken over a time [s]."""
    return f"_mean_{1000 * time:.0f}ms", f"; mean over some {round(time, 3):g} s"


def remember(
    seen: Sequence[jax.Array], before: Averages | None, memory: Memory, period: float
) -> tuple[jax.Array, Averages | None]:
    """Append its averages to what each agent observes.

    Args:
        seen: what each agent observes now (n_obs,) each.
        before: averages after the last control step; None at the start of an episode, and without memory.
        memory: time constants [s].
        period: length of a control step [s].

    Returns:
        The observation of all agents, each one's columns followed by its averages (n_all,); and the averages.
    """
    if not memory:
        return jnp.concatenate(seen), None
    if before is None:
        now = tuple(jnp.broadcast_to(x, (len(memory), *x.shape)) for x in seen)
    else:
        share = np.float32(period) / np.asarray(memory, np.float32)[:, None]
        now = tuple(old + share * (x - old) for x, old in zip(seen, before, strict=True))
    parts = [part for x, means in zip(seen, now, strict=True) for part in (x, means.reshape(-1))]
    return jnp.concatenate(parts), now
