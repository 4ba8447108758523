"""The tasks: one file each, imported on first use."""

from __future__ import annotations

from typing import TYPE_CHECKING

from agym_jax.catalogue import Catalogue

if TYPE_CHECKING:
    from agym_jax.spec import Task

TASKS: Catalogue[Task] = Catalogue(
    {
        "ScratchItch": "agym_jax.tasks.scratch_itch:SCRATCH_ITCH",
        "BedBathing": "agym_jax.tasks.bed_bathing:BED_BATHING",
        "Feeding": "agym_jax.tasks.feeding:FEEDING",
        "Drinking": "agym_jax.tasks.drinking:DRINKING",
        "Dressing": "agym_jax.tasks.dressing:DRESSING",
        "ArmManipulation": "agym_jax.tasks.arm_manipulation:ARM_MANIPULATION",
        "Reaching": "agym_jax.tasks.reaching:REACHING",
    }
)
"""Name -> task; the name is ``Task.name``."""
