"""Code shared by the command lines: counts, and the flags that describe the environment.

``--task.scratch 3 --humans.sizes continuous --robot.latency 0 2 --memory 0.3 4 --episode-length 100`` correspond to the arguments
``config``, ``humans``, ``robot``, ``memory`` and ``episode_length`` of ``agym_jax.make``. The available ``--task`` flags depend on
``--env-name``.
"""

from __future__ import annotations

import dataclasses
import math
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Any, TypeVar

from agym_jax.changes import change_task
from agym_jax.errors import MissingExtraError, UnknownNameError
from agym_jax.human.population import Population
from agym_jax.memory import MEMORY
from agym_jax.registry import parse
from agym_jax.spec import Task
from agym_jax.variation import RobotVariation

try:
    import tyro
except ImportError as error:
    raise MissingExtraError(
        'Command lines need tyro: pip install "agym_jax[train]", or for the viewer "agym_jax[view]"'
    ) from error


def parse_count(text: str) -> int:
    """Parse a whole number, which may be written ``20000``, ``20_000`` or ``2e4``.

    Raises:
        ValueError: if it is not a whole number, or is negative.
    """
    try:
        value = float(text.replace("_", ""))
    except ValueError:
        raise ValueError(f"{text!r} is not a number, such as 20000 or 2e4") from None
    if not math.isfinite(value) or value < 0 or value != int(value):
        raise ValueError(f"{text!r} is not a whole number of at least 0, such as 20000 or 2e4")
    return int(value)


_COUNT = tyro.constructors.PrimitiveConstructorSpec(
    nargs=1,
    metavar="N",
    instance_from_str=lambda words: parse_count(words[0]),
    is_instance=lambda value: isinstance(value, int),
    str_from_instance=lambda value: [str(value)],
)
Count = Annotated[int, _COUNT]


@dataclass(frozen=True, kw_only=True)
class EnvFlags:
    """Flags that describe the environment; base class for the settings of every command that makes one."""

    env_name: str = "ScratchItchJaco-v0"
    """Environment id."""
    episode_length: Count = 0
    """Control steps per episode; 0 = the task's default."""
    humans: Population = Population()  # noqa: RUF009 (it is frozen)
    """The population from which each episode draws its person."""
    robot: RobotVariation = RobotVariation()  # noqa: RUF009 (it is frozen)
    """Variation of the robot between episodes."""
    memory: tuple[float, ...] = ()
    """Time constants [s] of running averages that are appended to each agent's observation, such as 0.3 4; none by default."""
    task: Any = None
    """Weights and thresholds of the task; agym-jax settings ID lists them."""

    def options(self) -> dict[str, Any]:
        """Return the arguments of ``agym_jax.make`` that differ from its defaults, except the id and the physics."""
        found: dict[str, Any] = {}
        if self.humans != Population():
            found["humans"] = self.humans
        if self.robot.varies():
            found["robot"] = self.robot
        if self.memory:
            found[MEMORY] = self.memory
        if self.episode_length:
            found["episode_length"] = self.episode_length
        if self.task is not None and self.task != task_config(self.env_name):
            found["config"] = self.task
        return found


@dataclass(frozen=True)
class PolicyFlags(EnvFlags):
    """Flags that describe the environment and its policies; base class for commands that play or evaluate policies."""

    load_dir: str | None = None
    """--save-dir of the training run whose policy to use; without it and --policy, the policy shipped with agym_jax is used."""
    policy: str | None = None
    """Policy file, "zero" or "random"; the robot's policy if each agent has its own."""
    human_policy: str | None = None
    """The same for an active person; defaults to the policy stored beside the robot's."""
    non_det: bool = False
    """Sample actions instead of using the mode of the policy's distribution."""
    any_env: bool = False
    """Accept a policy trained in another environment with the same observation layout, or with different settings of this
    one. A different population or episode length does not need this flag."""


Flags = TypeVar("Flags", bound=EnvFlags)


def task_config(env_name: str) -> Any:
    """Return the settings of an environment's task; None if it has none, or there is no such environment."""
    try:
        return task_config_of(parse(env_name).task)
    except UnknownNameError:
        return None  # who makes the environment says so


def task_config_of(task: Task) -> Any:
    """Return the settings of a task; None if it has none."""
    config = getattr(task, "config", None)
    return config if dataclasses.is_dataclass(config) else None


def parse_flags(
    kind: type[Flags],
    arguments: Sequence[str] | None,
    prog: str,
    description: str | None = None,
    settings: Mapping[str, Any] | None = None,
) -> Flags:
    """Parse settings from command-line arguments, including the flags of the task that they name.

    Args:
        kind: class of the settings; all of its fields have defaults.
        arguments: command-line arguments; None for those of this process.
        prog: program name shown in the help.
        description: description shown in the help.
        settings: arguments of ``agym_jax.make`` that the flags have by default, such as those of a policy's training.
    """
    words = command_words(arguments)
    usual, others = kind(), dict(settings or {})
    env_name = env_name_in(words, usual.env_name)
    task, changed = task_config(env_name), others.pop("config", None)
    if task is not None and changed:
        task = task_config_of(change_task(parse(env_name).task, changed, None))
    default = dataclasses.replace(usual, task=task, **others)
    return tyro.cli(kind, prog=prog, description=description, args=words, default=default)


def made_of(env: Any) -> dict[str, Any]:
    """Return the fields of ``EnvFlags`` that describe an environment; for one from another package, only its name."""
    found: dict[str, Any] = {"env_name": env.name}
    if hasattr(env, "changes"):
        found |= {"humans": env.humans, "episode_length": env.episode_length}
        found["robot"] = env.variation or RobotVariation()
        found[MEMORY] = env.memory
        found["task"] = getattr(env.task, "config", None)
    return found


def command_words(arguments: Sequence[str] | None) -> list[str]:
    """Return command-line arguments with ``--env-name`` before an id that comes first: ``agym-jax train ScratchItchJaco-v0``.

    Args:
        arguments: command-line arguments; None for those of this process.
    """
    words = sys.argv[1:] if arguments is None else list(arguments)
    return ["--env-name", *words] if words and not words[0].startswith("-") else words


def env_name_in(arguments: Sequence[str], default: str) -> str:
    """Return the value of ``--env-name`` among command-line arguments, or the default environment."""
    name = default
    for i, word in enumerate(arguments):
        flag, equals, value = word.partition("=")
        if flag.replace("_", "-") == "--env-name":
            name = value if equals else (arguments[i + 1] if i + 1 < len(arguments) else name)
    return name


def first_paragraph(doc: str | None) -> str:
    """Return the first paragraph of a module's docstring as the description of a command."""
    return plain(doc).partition("\n\n")[0]


def plain(doc: str | None) -> str:
    """Return a module's docstring as the description of a command, without marks of code."""
    return (doc or "").replace("``", "")
