"""What every environment measures in a control step, besides the terms of the reward and the task's own measures."""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp
import numpy as np
from jax import Array

from agym_jax.sense import Sensed
from agym_jax.spec import Measured, Task

TASK_PREFIX = "task/"
METRICS = (
    "force/on_human", "force/tool_on_human", "force/robot_on_human", "force/tool",
    "force/peak_on_human", "force/of_comfort", "force/of_limit", "nan", "overflow",
)  # fmt: skip
"""Names. Forces are means over a control step [N]; ``peak_on_human`` is the largest on one region of the body in a
physics step [N], ``of_comfort`` and ``of_limit`` are the shares of limits of ``human.regions`` that are reached, above 1
where one is exceeded."""


def metrics_of(
    rewards: dict[str, Array],
    sensed: Sensed,
    comfort: np.ndarray,
    progress: dict[str, Array],
    bad: Array,
    overflow: Array,
) -> dict[str, Array]:
    """Terms of the reward as ``reward/<name>``, then ``METRICS``, then ``progress``.

    Args:
        rewards: terms of this step.
        sensed: at its end.
        comfort: limits of the task, see ``human.regions.comfort_limits`` [N].
        progress: from ``progress_of``.
        bad: whether something is not finite; what is measured is then 0 ().
        overflow: whether contacts were lost ().
    """
    clean = lambda x: jnp.where(bad, 0.0, x).astype(jnp.float32)  # noqa: E731
    values = (
        clean(sensed.force_on_human),
        clean(sensed.tool_on_human),
        clean(sensed.robot_on_human),
        clean(sum(t.force for t in sensed.tools)),
        clean(jnp.max(sensed.regions.peak)),
        clean(sensed.regions.of_comfort(comfort)),
        clean(sensed.regions.of_limit()),
        bad.astype(jnp.float32),
        overflow,
    )
    terms = {f"reward/{name}": value for name, value in rewards.items()}
    known = {name: clean(value) for name, value in progress.items()}
    return terms | dict(zip(METRICS, values, strict=True)) | known


def progress_of(task: Task, state: Any) -> dict[str, Array]:
    """``success``, and the task's measures as ``task/<name>``, each float32 ()."""
    found = {"success": task.success(state)}
    if isinstance(task, Measured):
        found |= {f"{TASK_PREFIX}{name}": value for name, value in task.measure(state).items()}
    return {name: jnp.asarray(value).astype(jnp.float32) for name, value in found.items()}


def metric_names(task: Task) -> tuple[str, ...]:
    """Names of ``State.metrics``, in order."""
    measures = task.measures if isinstance(task, Measured) else ()
    return (
        *(f"reward/{term}" for term in task.reward_terms),
        *METRICS,
        "success",
        *(f"{TASK_PREFIX}{measure.name}" for measure in measures),
    )
