"""The tasks: one file each."""

from agym_jax.tasks.scratch_itch import SCRATCH_ITCH

TASKS = {task.name: task for task in (SCRATCH_ITCH,)}
