"""Metrics that every environment reports for a control step, besides the reward terms and the task's own measures."""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp
import numpy as np
from jax import Array

from agym_jax.errors import SpecError
from agym_jax.sense import Sensed
from agym_jax.spec import Measured, Task

TASK_PREFIX = "task/"
METRICS = (
    "force/on_human", "force/tool_on_human", "force/robot_on_human", "force/tool",
    "force/peak_on_human", "force/of_comfort", "force/of_limit", "nan", "overflow",
)  # fmt: skip
"""Names of the metrics. Forces are means over a control step [N]; ``peak_on_human`` is the largest force on one region of
the body in a physics step [N]; ``of_comfort`` and ``of_limit`` are forces as fractions of the limits in ``human.regions``,
above 1 if a limit is exceeded."""


def metrics_of(
    rewards: dict[str, Array],
    sensed: Sensed,
    comfort: np.ndarray,
    progress: dict[str, Array],
    bad: Array,
    overflow: Array,
) -> dict[str, Array]:
    """Return the reward terms as ``reward/<name>``, then ``METRICS``, then ``progress``.

    Args:
        rewards: reward terms of this step.
        sensed: sensed data at the end of the step.
        comfort: comfort limits of the task, see ``human.regions.comfort_limits`` [N].
        progress: result of ``progress_of``.
        bad: whether a value is not finite; measured values are then reported as 0 ().
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
    """Return ``success``, and the task's measures as ``task/<name>``, each float32 ()."""
    found = {"success": task.success(state)}
    if isinstance(task, Measured):
        found |= {f"{TASK_PREFIX}{name}": value for name, value in task.measure(state).items()}
    return {name: jnp.asarray(value).astype(jnp.float32) for name, value in found.items()}


def check_terms(task: Task, rewards: dict[str, Array]) -> None:
    """Check the names of reward terms.

    Raises:
        SpecError: if they are not the task's ``reward_terms``, in that order.
    """
    if tuple(rewards) != tuple(task.reward_terms):
        raise SpecError(
            f"{task.name}.rewards returns {', '.join(rewards)}; its reward_terms are {', '.join(task.reward_terms)}. Name the "
            f"same terms in the same order."
        )


def metric_names(task: Task) -> tuple[str, ...]:
    """Return the names of the entries of ``State.metrics``, in order."""
    measures = task.measures if isinstance(task, Measured) else ()
    return (
        *(f"reward/{term}" for term in task.reward_terms),
        *METRICS,
        "success",
        *(f"{TASK_PREFIX}{measure.name}" for measure in measures),
    )
