"""The command line: ``agym-jax COMMAND ...``, or the same with ``python -m agym_jax``.

Each command is a function ``main(argv, prog=...)`` in a module that is imported only when the command is
used, so that listing the commands does not require JAX.
"""

from __future__ import annotations

import argparse
import importlib
import importlib.util
import os
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING

import agym_jax
from agym_jax.errors import AgymError, MissingAssetError, UnknownNameError
from agym_jax.interrupts import INTERRUPTED, leave_quietly, raise_again

if TYPE_CHECKING:
    from agym_jax.registry import Recipe

TRAINER = "agym_jax.train"


COMMANDS = {
    "list": ("", "print the environment ids"),
    "observe": ("", "print an environment's observations, column by column"),
    "settings": ("", "print an environment's settings: weights, people, robot, length"),
    "demo": (f"{TRAINER}.demo", "run a demonstration on a CPU, in a few minutes"),
    "train": (f"{TRAINER}.ppo", "train a robot policy with PPO"),
    "coop": (f"{TRAINER}.coop", "train a robot policy and a person policy together"),
    "evaluate": (f"{TRAINER}.evaluate", "evaluate a policy over many episodes"),
    "enjoy": (f"{TRAINER}.enjoy", "watch a policy: as a video, as pictures, or in MuJoCo's viewer"),
    "view": ("agym_jax.viewer.command", "watch and control an episode in the browser"),
    "crossplay": (f"{TRAINER}.crossplay", "evaluate every robot policy with every person policy"),
    "select": (f"{TRAINER}.select", "choose the best seed of a run and evaluate it on other people"),
    "compare": (f"{TRAINER}.compare", "test whether one setting is better than another, over seeds"),
    "export": ("agym_jax.policy.export", "export a policy to ONNX, to run it anywhere"),
    "sweep": (f"{TRAINER}.sweep", "compare hyperparameters, several seeds each, in one program"),
    "suite": (f"{TRAINER}.suite", "train many environments and choose a policy for each"),
    "placements": ("agym_jax.offline.placements", "build or report on the robots' start placements"),
    "postures": ("agym_jax.offline.bed_postures", "build or report on the postures of people in bed"),
    "particles": ("agym_jax.offline.particle_fill", "build the particle fillings of the spoon and the cup"),
    "gown": ("agym_jax.offline.gown", "build the hospital gown"),
    "arm-limits": ("agym_jax.offline.fit_limits", "fit the network of the arm's joint limits to samples"),
}  # fmt: skip
"""Command -> module with its ``main`` (empty if it is in this module), and its description."""
ALIASES = {"ppo": "train"}
PIPE_CLOSED = 141
"""Exit status of a program whose output nobody reads any more, as a shell has it."""


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line and return the exit status.

    Args:
        argv: command-line arguments; None for those of this process.
    """
    words = sys.argv[1:] if argv is None else list(argv)
    prog = program_name(sys.argv[0])
    name = words[0] if words else "--help"
    if name in ("-h", "--help"):
        print(usage(prog))
        return 0 if words else 2
    if name == "--version":
        print(agym_jax.__version__)
        return 0
    if "" not in sys.path:  # an id may name a module in the current folder; last: it hides no other
        sys.path.append("")
    if argv is None:  # we are the program; importing takes seconds
        leave_quietly()
    try:
        run = find(name)
    except AgymError as error:
        print(f"{type(error).__name__}: {error}", file=sys.stderr)
        return 2
    if not run.__module__.startswith(TRAINER):
        raise_again()  # the trainer does when it begins
    try:
        status = run(words[1:], prog=f"{prog} {name}")
        sys.stdout.flush()
        return status
    except KeyboardInterrupt:
        return INTERRUPTED
    except BrokenPipeError:  # of `agym-jax ... | head`
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return PIPE_CLOSED


def program_name(path: str) -> str:
    """Return the name by which the user started the program whose file is ``sys.argv[0]``."""
    name = Path(path).name
    return "python -m agym_jax" if name == "__main__.py" else name.removesuffix(".exe")


def usage(prog: str) -> str:
    """List all commands, one per line."""
    width = max(map(len, COMMANDS))
    lines = [f"usage: {prog} COMMAND ...", "", agym_jax.__doc__.splitlines()[0], "", "commands:"]
    lines += [f"  {name:<{width}}  {does}" for name, (_, does) in COMMANDS.items()]
    return "\n".join([*lines, "", f"Run {prog} COMMAND --help for details."])


def find(name: str) -> Callable[..., int]:
    """Return the function of a command: ``main(argv, prog=...)``.

    Raises:
        UnknownNameError: if there is no such command; the message suggests the closest match.
        MissingExtraError: if the trainer needs packages that are not installed.
    """
    name = ALIASES.get(name, name)
    if name not in COMMANDS:
        raise UnknownNameError("command", name, COMMANDS)
    module = COMMANDS[name][0]
    if not module:
        return {"list": list_ids, "observe": show_observations, "settings": show_settings}[name]
    from agym_jax.jax_settings import enable_compilation_cache

    enable_compilation_cache()
    if module.startswith(TRAINER):
        trainer()
    return importlib.import_module(module).main


def trainer() -> ModuleType:
    """Import the trainer as ``agym_jax.train``.

    In a wheel it is a folder of the package. In a checkout it is the folder ``train`` beside the package, and is
    loaded by its path, so that it cannot be confused with a ``train.py`` in the user's current folder.

    Raises:
        MissingAssetError: if the trainer is missing.
        MissingExtraError: if it needs packages that are not installed.
    """
    if TRAINER in sys.modules or importlib.util.find_spec(TRAINER):
        return importlib.import_module(TRAINER)
    folder = Path(__file__).resolve().parent.parent / "train"
    spec = importlib.util.spec_from_file_location(
        TRAINER, folder / "__init__.py", submodule_search_locations=[str(folder)]
    )
    if spec is None or spec.loader is None or not (folder / "ppo.py").is_file():
        raise MissingAssetError(
            f"agym_jax is installed without its trainer (looked for {folder}). Reinstall it."
        )
    module = importlib.util.module_from_spec(spec)
    sys.modules[TRAINER] = module
    try:
        spec.loader.exec_module(module)
    except BaseException:
        del sys.modules[TRAINER]
        raise
    setattr(agym_jax, TRAINER.rpartition(".")[2], module)  # as importing a part of a package does
    return module


def list_ids(argv: Sequence[str] | None = None, prog: str = "agym-jax list") -> int:
    """Print every environment id and return the exit status."""
    parser = argparse.ArgumentParser(prog=prog, description="Print the environment ids.")
    parser.add_argument("part", nargs="?", default="", help="print only ids that contain this text")
    part = parser.parse_args(argv).part
    ids = [name for name in agym_jax.list_envs() if part.lower() in name.lower()]
    if not ids:
        print(f"No environment id contains {part!r}; {prog} lists them all.", file=sys.stderr)
        return 1
    print("\n".join(ids))
    return 0


def show_observations(argv: Sequence[str] | None = None, prog: str = "agym-jax observe") -> int:
    """Print an environment's observation tables and its actions, and return the exit status."""
    parser = _parser(prog, "Print an environment's observations and actions.")
    parser.add_argument(
        "--memory", type=float, nargs="+", metavar="T", help="time constants of averages in the observation [s]"
    )  # fmt: skip
    args = parser.parse_args(argv)
    recipe = _recipe(args.id)
    if recipe is None:
        return 2
    from agym_jax import observe
    from agym_jax.memory import checked_memory, observation_records
    from agym_jax.policy.contract import acting_joints, action_meaning

    task = recipe.task
    try:
        memory = checked_memory(args.memory, task.control.period)
    except AgymError as error:
        print(f"{type(error).__name__}: {error}", file=sys.stderr)
        return 2
    for agent, record in observation_records(task, recipe.active, memory).items():
        joints = acting_joints(recipe.robot, task, agent)
        print(f"{agent.title()}: {observe.size(record)} columns\n\n{observe.table(record)}\n")
        print(
            f"{agent.title()}: {len(joints)} actions in [-1, 1], of {', '.join(joints)}. "
            f"{action_meaning(task, agent)}\n"
        )
    return 0


def show_settings(argv: Sequence[str] | None = None, prog: str = "agym-jax settings") -> int:
    """Print the settings that ``agym_jax.make`` can change and return the exit status."""
    parser = _parser(prog, "Print the settings of an environment that can be changed.")
    recipe = _recipe(parser.parse_args(argv).id)
    if recipe is None:
        return 2
    from agym_jax.changes import settings_table, settings_tables

    for title, settings in settings_tables(recipe.task).items():
        print(f"{title}\n\n{settings_table(settings)}\n")
    return 0


def _parser(prog: str, description: str) -> argparse.ArgumentParser:
    """Make a parser of command-line arguments that name an id."""
    parser = argparse.ArgumentParser(prog=prog, description=description)
    parser.add_argument("id", help="environment id, such as ScratchItchJaco-v0")
    return parser


def _recipe(name: str) -> Recipe | None:
    """Parse an id; print an error and return None if there is none such."""
    from agym_jax.registry import parse

    try:
        return parse(name)
    except AgymError as error:
        print(f"{type(error).__name__}: {error}", file=sys.stderr)
        return None


if __name__ == "__main__":
    sys.exit(main())
