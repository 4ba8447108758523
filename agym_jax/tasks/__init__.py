"""The tasks: one file each."""

from agym_jax.spec import Task
from agym_jax.tasks.arm_manipulation import ARM_MANIPULATION
from agym_jax.tasks.bed_bathing import BED_BATHING
from agym_jax.tasks.drinking import DRINKING
from agym_jax.tasks.feeding import FEEDING
from agym_jax.tasks.reaching import REACHING
from agym_jax.tasks.scratch_itch import SCRATCH_ITCH

TASKS: dict[str, Task] = {
    task.name: task
    for task in (SCRATCH_ITCH, BED_BATHING, FEEDING, DRINKING, ARM_MANIPULATION, REACHING)
}
