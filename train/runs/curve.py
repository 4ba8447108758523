"""Rows of the learning curve, made from device totals, and the checks that stop a bad run."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from agym_jax.errors import BufferOverflowError

from ..errors import DivergedError
from ..evaluation.statistics import bootstrap_interval, iqm
from ..learning.constraint import SHARED

Row = dict[str, Any]
SCORES = ("return", "success", "gentle", "force", "return_per_step")
"""Columns that are combined over seeds by their interquartile mean."""
PLAIN = tuple(f"loss/{name}" for name in SHARED)
"""What learning under a limit tells, which is no loss."""


def make_rows(
    totals: Mapping[str, Any], updates: int, samples: int, episode_length: int
) -> list[Row]:
    """``make_row`` of every seed, from totals () or (seeds,)."""
    count = np.size(next(iter(totals.values())))
    split = {name: np.reshape(total, count) for name, total in totals.items()}
    return [
        make_row({name: x[i] for name, x in split.items()}, updates, samples, episode_length)
        for i in range(count)
    ]


def combine_rows(rows: Sequence[Row]) -> Row:
    """One row for several seeds.

    Args:
        rows: of the seeds that still learn, at the same step.

    Returns:
        The columns that a row has, as means over the seeds, counts as sums, ``SCORES`` as interquartile means;
        and of each score ``<name>_min, <name>_max`` and the 95 % bootstrap interval of the interquartile mean,
        ``<name>_low, <name>_high``. ``num_seeds`` is how many there are.
    """
    combined: Row = {"num_seeds": len(rows)}
    for name in rows[0]:
        values = np.array([row[name] for row in rows if row[name] is not None], float)
        if not len(values):
            combined[name] = None
        elif name in ("episodes", "nan", "overflow"):
            combined[name] = int(values.sum())
        elif name in ("env_steps", "nan_total"):  # the same in all rows
            combined[name] = int(values[0])
        elif name in SCORES:
            low, high = bootstrap_interval(values[:, None])
            combined |= {name: iqm(values), f"{name}_low": low, f"{name}_high": high}
            combined |= {f"{name}_min": float(values.min()), f"{name}_max": float(values.max())}
        else:
            combined[name] = float(values.mean())
    return combined


def make_row(totals: Mapping[str, Any], updates: int, samples: int, episode_length: int) -> Row:
    """Means from the totals of some updates.

    Args:
        totals: sums from ``train.learning.update.make_updates``.
        updates: updates they were summed over.
        samples: environment steps they were summed over.
        episode_length: steps of a full episode.

    Returns:
        ``episodes, return, return_std, success, force, length`` of the episodes that ended (None where none did),
        where the environment measures it ``gentle`` (share of successes without a step above the comfort limit) and
        ``peak`` (mean of the episodes' largest forces [N]), ``return_per_step`` (mean reward of a step times the episode length),
        with a cost limit ``cost`` (mean of an episode) and ``multiplier``, environment steps of ``nan`` and ``overflow``, means of the environment's named metrics, losses.
    """
    value = {name: float(total) for name, total in totals.items()}
    episodes = value["episode/episodes"]
    row: Row = {"episodes": int(episodes)}
    for name in ("return", "success", "force", "length"):
        row[name] = value[f"episode/{name}"] / episodes if episodes else None
    for name in ("gentle", "peak"):
        if f"episode/{name}" in value:
            row[name] = value[f"episode/{name}"] / episodes if episodes else None
    row["return_std"] = None
    if episodes:
        variance = value["episode/return_squared"] / episodes - row["return"] ** 2
        row["return_std"] = math.sqrt(variance) if variance > 0 else 0.0
    row["return_per_step"] = value["step/reward"] / samples * episode_length
    row["nan"], row["overflow"] = value["step/nan"], value["step/overflow"]
    done = ("step/reward", "step/nan", "step/overflow")
    for name, total in value.items():
        if name.startswith("step/") and name not in done:
            row[name.removeprefix("step/")] = total / samples
        if name.startswith("loss/"):
            row[name.removeprefix("loss/") if name in PLAIN else name] = total / updates
    return row


def check_overflow(lost: float, env_name: str, num_envs: int) -> None:
    """Stop a run whose physics cannot be trusted.

    Args:
        lost: environment steps in which contacts were lost.
        env_name: environment id.
        num_envs: environments stepped together.

    Raises:
        BufferOverflowError: there are such steps.
    """
    if lost > 0:
        raise BufferOverflowError(
            f"In {env_name!r} with {num_envs} environments, contacts or constraints were lost in "
            f"{lost:.0f} environment steps because the physics buffers are too small. The "
            f"results cannot be trusted, so training stops. Use fewer environments (--num-envs), "
            f"--impl jax, or larger buffers in agym_jax.make."
        )


def diverged(row: Row) -> str:
    """Which numbers of a row are not finite, in words; empty if learning goes well."""
    bad = [k for k, v in row.items() if k.startswith("loss/") and not math.isfinite(v)]
    bad += [] if math.isfinite(row["return_per_step"]) else ["reward"]
    return f"before step {row['env_steps']:,}: {', '.join(bad)} not finite" if bad else ""


def refuse_diverged(row: Row, env_name: str) -> None:
    """Stop a run that cannot go on.

    Raises:
        DivergedError: something in the row is not finite.
    """
    if why := diverged(row):
        raise DivergedError(
            f"Training in {env_name!r} diverged {why}. Checkpoints from before are intact. Lower --lr, or "
            f"report it if the environment produced NaN (NaN environment steps so far: "
            f"{row['nan_total']:.0f})."
        )
