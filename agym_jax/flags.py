"""What the command lines have in common: counts, and the flags that say what environment is made.

``--task.scratch 3 --humans.sizes continuous --robot.latency 0 2 --episode-length 100`` are the arguments ``config``,
``humans``, ``robot`` and ``episode_length`` of ``agym_jax.make``. Which ``--task`` flags there are depends on ``--env-name``.
"""

from __future__ import annotations

import dataclasses
import math
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Any, TypeVar

from agym_jax.errors import MissingExtraError, UnknownNameError
from agym_jax.human.population import Population
from agym_jax.registry import parse
from agym_jax.variation import RobotVariation

try:
    import tyro
except ImportError as error:
    raise MissingExtraError(
        'Command lines need tyro: pip install "agym_jax[train]", or for the viewer "agym_jax[view]"'
    ) from error


def parse_count(text: str) -> int:
    """A whole number that may be written ``20000``, ``20_000`` or ``2e4``.

    Raises:
        ValueError: it is not a whole number, or negative.
    """
    try:
        value = float(text.replace("_", ""))
    except ValueError:
        raise ValueError(f"{text!r} is not a number; write 10000000 or 1e7") from None
    if not math.isfinite(value) or value < 0 or value != int(value):
        raise ValueError(f"{text!r} is not a whole number >= 0; write 10000000 or 1e7")
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
    """What environment is made; the base of the settings of every command that makes one."""

    env_name: str = "ScratchItchJaco-v0"
    """Environment id."""
    episode_length: Count = 0
    """Control steps of an episode; 0 = the task's own."""
    humans: Population = Population()  # noqa: RUF009 (it is frozen)
    """The people whom episodes draw from."""
    robot: RobotVariation = RobotVariation()  # noqa: RUF009 (it is frozen)
    """How robots differ from episode to episode."""
    task: Any = None
    """Weights and thresholds of the task; agym-jax settings ID prints them."""

    def options(self) -> dict[str, Any]:
        """The arguments of ``agym_jax.make`` besides id and physics, as far as they are not its defaults."""
        found: dict[str, Any] = {}
        if self.humans != Population():
            found["humans"] = self.humans
        if self.robot.varies():
            found["robot"] = self.robot
        if self.episode_length:
            found["episode_length"] = self.episode_length
        if self.task is not None and self.task != task_config(self.env_name):
            found["config"] = self.task
        return found


@dataclass(frozen=True)
class PolicyFlags(EnvFlags):
    """What environment is made and who acts in it; the base of the settings of every command that plays or measures."""

    load_dir: str | None = None
    """--save-dir of a training run, whose policy is meant; without it and --policy, the one shipped with agym_jax."""
    policy: str | None = None
    """A policy file, or "zero" or "random"; the robot's, where there is one for each agent."""
    human_policy: str | None = None
    """The same for a person who acts; without it, the one that lies beside the robot's."""
    non_det: bool = False
    """Sample actions instead of taking the mode."""
    any_env: bool = False
    """Accept a policy of another environment with the same observation layout, or of other settings of this one.
    Other people and episode lengths need no flag."""


Flags = TypeVar("Flags", bound=EnvFlags)


def task_config(env_name: str) -> Any:
    """The settings of an environment's task; None where there are none, or no such environment."""
    try:
        config = getattr(parse(env_name).task, "config", None)
    except UnknownNameError:
        return None  # who makes the environment says so
    return config if dataclasses.is_dataclass(config) else None


def parse_flags(
    kind: type[Flags], arguments: Sequence[str] | None, prog: str, description: str | None = None
) -> Flags:
    """Settings from command-line words, with the flags of the task that they name.

    Args:
        kind: of the settings; all of its fields have defaults.
        arguments: words; None: those of this process.
        prog: what was typed to start it, for the help.
        description: for the help.
    """
    words = sys.argv[1:] if arguments is None else list(arguments)
    usual = kind()
    default = dataclasses.replace(usual, task=task_config(env_name_in(words, usual.env_name)))
    return tyro.cli(kind, prog=prog, description=description, args=words, default=default)


def made_of(env: Any) -> dict[str, Any]:
    """The fields of ``EnvFlags`` that say what an environment is; of one that is not ours, its name only."""
    found: dict[str, Any] = {"env_name": env.name}
    if hasattr(env, "changes"):
        found |= {"humans": env.humans, "episode_length": env.episode_length}
        found["robot"] = env.variation or RobotVariation()
        found["task"] = getattr(env.task, "config", None)
    return found


def env_name_in(arguments: Sequence[str], default: str) -> str:
    """The value of ``--env-name`` among command-line words, or the default environment."""
    name = default
    for i, word in enumerate(arguments):
        flag, equals, value = word.partition("=")
        if flag.replace("_", "-") == "--env-name":
            name = value if equals else (arguments[i + 1] if i + 1 < len(arguments) else name)
    return name
