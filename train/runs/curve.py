"""Rows of the learning curve, made from device totals, and the checks that stop a bad run."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from agym_jax.errors import BufferOverflowError

from ..errors import DivergedError

Row = dict[str, Any]


def make_row(totals: Mapping[str, Any], updates: int, samples: int, episode_length: int) -> Row:
    """Means from the totals of some updates.

    Args:
        totals: sums from ``train.learning.update.make_updates``.
        updates: updates they were summed over.
        samples: environment steps they were summed over.
        episode_length: steps of a full episode.

    Returns:
        ``episodes, return, return_std, success, force, length`` of the episodes that ended (None
        where none did), ``return_per_step`` (mean reward of a step times the episode length),
        environment steps of ``nan`` and ``overflow``, means of the environment's named metrics, losses.
    """
    value = {name: float(total) for name, total in totals.items()}
    episodes = value["episode/episodes"]
    row: Row = {"episodes": int(episodes)}
    for name in ("return", "success", "force", "length"):
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
            row[name] = total / updates
    return row


def check_row(row: Row, env_name: str, num_envs: int) -> None:
    """Stop a run whose numbers cannot be trusted.

    Raises:
        BufferOverflowError: the physics lost contacts.
        DivergedError: a loss or the reward is not finite.
    """
    if row["overflow"] > 0:
        raise BufferOverflowError(
            f"In {env_name!r} with {num_envs} environments, contacts or constraints were lost in "
            f"{row['overflow']:.0f} environment steps because the physics buffers are too small. The "
            f"results cannot be trusted, so training stops. Use fewer environments (--num-envs), "
            f"--impl jax, or larger buffers in agym_jax.make."
        )
    bad = [k for k, v in row.items() if k.startswith("loss/") and not math.isfinite(v)]
    bad += [] if math.isfinite(row["return_per_step"]) else ["reward"]
    if bad:
        raise DivergedError(
            f"Training in {env_name!r} diverged before step {row['env_steps']:,}: "
            f"{', '.join(bad)} not finite. Checkpoints from before are intact. Lower --lr, or "
            f"report it if the environment produced NaN (NaN environment steps so far: "
            f"{row['nan_total']:.0f})."
        )
