"""What a suite is asked to do: its flags, and which environments with how many steps."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import tyro

from agym_jax.errors import UnknownNameError, checked_count
from agym_jax.flags import Count

from ..errors import ConfigError, check_save_dir


@dataclass(frozen=True)
class SuiteConfig:
    """Flags of ``agym-jax suite``."""

    only: Annotated[tuple[str, ...], tyro.conf.arg(metavar="NAME ...")] = ()
    """Parts of ids, such as Jaco or ScratchItchPR2-v0, trained in this order; without them, all environments."""
    num_seeds: Count = 8
    """Seeds of each environment."""
    num_episodes: Count = 1000
    """Episodes over which a seed is chosen, and of others over which it is reported."""
    save_dir: str = "trained_suite"
    """Folder of the runs, the logs and the results."""
    parallel: Count = 1
    """Environments trained at the same time on each GPU."""
    gpus: Count = 0
    """GPUs to spread them over, each training on one; 0 = all there are."""
    steps: tuple[str, ...] = ()
    """Steps of a seed where the trainer's default does not suit: NAME=STEPS, such as Dressing=6e6."""
    flags: str = ""
    """Further flags of train and coop: --flags="--num-envs 2048 --lr 1e-3"."""
    shipped: bool = True
    """Measure the policies that ship with agym_jax too, over the people of the report."""
    clips: bool = True
    """Film an episode of each chosen policy, on the CPU while the next environments train."""

    def __post_init__(self) -> None:
        """Refuse what means nothing, before anything is built."""
        for name in ("num_seeds", "num_episodes", "parallel"):
            checked_count(f"--{name.replace('_', '-')}", getattr(self, name))
        check_save_dir(self.save_dir)


def named(parts: Sequence[str], ids: Sequence[str], kind: str = "environment") -> list[str]:
    """Ids that contain one of the parts, in the order of the parts; all of them if there are no parts.

    Args:
        parts: of ids, such as Jaco.
        ids: which there are.
        kind: what the ids are of, for the error.

    Raises:
        UnknownNameError: a part is in no id.
    """
    for part in parts:
        if not any(part in name for name in ids):
            raise UnknownNameError(kind, part, ids)
    found = [name for part in parts or [""] for name in ids if part in name]
    return list(dict.fromkeys(found))


def steps_of(steps: Sequence[str], env_name: str) -> list[str]:
    """The flag for the steps of an environment, from the longest NAME that its id begins with.

    Raises:
        ConfigError: an entry is not NAME=STEPS.
    """
    found = ("", "")
    for entry in steps:
        name, equals, count = entry.partition("=")
        if not (name and equals and count):
            raise ConfigError(f"--steps takes NAME=STEPS, such as Dressing=6e6, got {entry!r}.")
        if env_name.startswith(name) and len(name) > len(found[0]):
            found = (name, count)
    return ["--num-env-steps", found[1]] if found[1] else []
