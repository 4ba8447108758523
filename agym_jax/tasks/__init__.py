"""The tasks: one file each."""

from agym_jax.spec import Task
from agym_jax.tasks.scratch_itch import SCRATCH_ITCH

TASKS: dict[str, Task] = {task.name: task for task in (SCRATCH_ITCH,)}
