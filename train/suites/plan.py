"""Flags of a suite, and the environments and numbers of steps that they select."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Literal

import tyro

from agym_jax.errors import UnknownNameError, checked_count
from agym_jax.flags import Count, parse_count
from agym_jax.registry import parse
from agym_jax.spec import Measured

from ..configs import entry_of
from ..entries import AT_LEAST, entries, numbers
from ..errors import ConfigError, check_save_dir


@dataclass(frozen=True)
class SuiteConfig:
    """Flags of ``agym-jax suite``."""

    only: Annotated[tuple[str, ...], tyro.conf.arg(metavar="NAME ...")] = ()
    """Parts of ids, such as Jaco or ScratchItchPR2-v0, trained in this order; by default, all environments."""
    num_seeds: Count = 8
    """Number of seeds per environment."""
    num_episodes: Count = 1000
    """Number of episodes used to choose a seed, and of separate episodes used to report its results."""
    save_dir: str = "trained_suite"
    """Folder for runs, logs and results."""
    parallel: Count = 1
    """Number of environments trained at the same time on each GPU."""
    gpus: Count = 0
    """Number of GPUs to use, with each training on a single GPU; 0 = all available."""
    steps: tuple[str, ...] = ()
    """Environment steps per seed, to override the trainer's default: NAME=STEPS, such as Dressing=6e6. If several NAMEs fit
    an id, the longest counts."""
    flags: str = ""
    """Further flags for train and coop: --flags="--num-envs 2048 --lr 1e-3"."""
    flags_of: tuple[str, ...] = ()
    """Further flags for the environments whose ids begin with NAME: NAME=FLAGS, such as Dressing="--task.settled-gown 0.5". If
    several NAMEs fit an id, the longest counts."""
    default_settings: bool = False
    """Choose and evaluate in the environments with their default settings, even if flags change those of the training."""
    by: Literal["auto", "success", "gentle", "both"] = "auto"
    """What the chosen seed has most of, as in ``agym-jax select``."""
    at_least: Annotated[tuple[str, ...], tyro.conf.arg(metavar="NAME=VALUE ...")] = ()
    """What the mean of a task's own measures has to reach in chosen seeds, such as held=0.9, as in ``agym-jax select``; tasks that do
    not have the measure are chosen without it."""
    shipped: bool = True
    """Also evaluate the policies that ship with agym_jax, on the people used for the report."""
    clips: bool = True
    """Film an episode of each chosen policy, on the CPU while the next environments train."""

    def __post_init__(self) -> None:
        """Reject invalid settings before anything is built."""
        for name in ("num_seeds", "num_episodes", "parallel"):
            checked_count(f"--{name.replace('_', '-')}", getattr(self, name))
        choosing = {"default_settings": self.default_settings, "by": self.by != "auto", "at_least": self.at_least}  # fmt: skip
        asked = [f"--{name.replace('_', '-')}" for name, given in choosing.items() if given]
        if asked and self.num_seeds == 1:
            raise ConfigError(
                f"{asked[0]} is about the choice among seeds, and --num-seeds 1 leaves none. Leave one of them out."
            )
        check_save_dir(self.save_dir)


def named(parts: Sequence[str], ids: Sequence[str], kind: str = "environment") -> list[str]:
    """Return the ids that contain one of the parts, in the order of the parts; all ids if there are no parts.

    Args:
        parts: parts of ids, such as Jaco.
        ids: available ids.
        kind: what the ids identify, for the error message.

    Raises:
        UnknownNameError: if no id contains a part.
    """
    for part in parts:
        if not any(part in name for name in ids):
            raise UnknownNameError(kind, part, ids)
    found = [name for part in parts or [""] for name in ids if part in name]
    return list(dict.fromkeys(found))


def steps_by_name(config: SuiteConfig) -> dict[str, str]:
    """Return ``--steps`` as NAME -> steps. Raises ``ConfigError`` as ``entries`` does."""
    return entries("--steps", config.steps, "NAME=STEPS, such as Dressing=6e6")


def flags_by_name(config: SuiteConfig) -> dict[str, str]:
    """Return ``--flags-of`` as NAME -> flags. Raises ``ConfigError`` as ``entries`` does."""
    example = 'NAME=FLAGS, such as Dressing="--task.settled-gown 0.5"'
    return entries("--flags-of", config.flags_of, example)


def flags_for(config: SuiteConfig, env_name: str) -> list[str]:
    """Return the further flags of an environment: those of all, then those of the longest NAME with which its id begins.

    Raises:
        ConfigError: if an entry of ``flags_of`` is not of the form NAME=FLAGS, or the quotes of one are not closed.
    """
    own = entry_of(flags_by_name(config), env_name, "")
    return _words("--flags", config.flags) + _words("--flags-of", own)


def measures_of(env_name: str) -> set[str]:
    """Return the names of the measures of an environment's task."""
    task = parse(env_name).task
    return {x.name for x in task.measures} if isinstance(task, Measured) else set()


def least_for(config: SuiteConfig, env_name: str) -> list[str]:
    """Return the entries of ``at_least`` whose measure the environment's task has. Raises ``ConfigError`` as ``numbers`` does."""
    known, found = measures_of(env_name), numbers("--at-least", config.at_least, AT_LEAST)
    return [f"{name}={value:g}" for name, value in found.items() if name in known]


def steps_for(config: SuiteConfig, env_name: str) -> str | None:
    """Return the steps of an environment, by the longest NAME with which its id begins; None leaves them to the trainer."""
    return entry_of(steps_by_name(config), env_name, None)


def check_entries(config: SuiteConfig, ids: Sequence[str]) -> None:
    """Reject entries that cannot be read, whose NAME begins no id, or that no task measures, before anything is built.

    Args:
        config: flags.
        ids: all ids, also those that are not trained.

    Raises:
        ConfigError: if an entry is not of its form.
        UnknownNameError: if no id begins with the NAME of an entry.
    """
    flags, steps = flags_by_name(config), steps_by_name(config)
    for name, text in steps.items():
        try:
            count = parse_count(text)
        except ValueError as error:
            raise ConfigError(f"--steps {name}={text}: {error}.") from None
        checked_count(f"--steps {name}", count)
    for start in (*steps, *flags):
        if not any(name.startswith(start) for name in ids):
            raise UnknownNameError("environment", start, ids)
    known = set().union(*map(measures_of, ids))
    for name in numbers("--at-least", config.at_least, AT_LEAST):
        if name not in known:
            raise UnknownNameError("measure", name, sorted(known))
    _words("--flags", config.flags)
    for text in flags.values():
        _words("--flags-of", text)


def _words(option: str, text: str) -> list[str]:
    """Split as a shell does, but keep backslashes: they separate folders on Windows."""
    words = shlex.shlex(text, posix=True)
    words.whitespace_split, words.commenters, words.escape = True, "", ""
    try:
        return list(words)
    except ValueError as error:
        raise ConfigError(f"{option} cannot be read ({error}): {text}") from None
