"""The command line: ``agym-jax COMMAND ...``, or the same with ``python -m agym_jax``.

Each command is a function ``main(argv, prog=...)`` of a module that is imported when the command is
given, so that the list of commands needs no JAX.
"""

from __future__ import annotations

import argparse
import importlib
import importlib.util
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
    "observe": ("", "print the observations of an id, column by column"),
    "settings": ("", "print what can be changed of an id: weights, thresholds, people"),
    "demo": (f"{TRAINER}.demo", "see it work on a CPU, in a few minutes"),
    "train": (f"{TRAINER}.ppo", "train a robot's policy with PPO"),
    "coop": (f"{TRAINER}.coop", "train robot and person side by side"),
    "evaluate": (f"{TRAINER}.evaluate", "measure a policy over many episodes"),
    "enjoy": (f"{TRAINER}.enjoy", "watch a policy: a film, pictures, or MuJoCo's viewer"),
    "view": ("agym_jax.viewer.command", "see and drive an episode in the browser"),
    "crossplay": (f"{TRAINER}.crossplay", "measure every robot's policy with every person's"),
    "select": (f"{TRAINER}.select", "choose the seed of a run to use, over people of its own"),
    "compare": (f"{TRAINER}.compare", "tell whether one setting is better than another, over seeds"),
    "export": ("agym_jax.policy.export", "write a policy as ONNX, to run it anywhere"),
    "sweep": (f"{TRAINER}.sweep", "compare hyper-parameters, several seeds each, in one program"),
    "suite": (f"{TRAINER}.suite", "train and choose policies of many environments"),
    "placements": ("agym_jax.offline.placements", "build start placements of ids, or report on them"),
    "postures": ("agym_jax.offline.bed_postures", "build postures of people in bed, or report on them"),
    "particles": ("agym_jax.offline.particle_fill", "build the fillings of spoon and cup"),
    "gown": ("agym_jax.offline.gown", "build the hospital gown"),
    "arm-limits": ("agym_jax.offline.fit_limits", "fit the network of the arms' limits to samples"),
}  # fmt: skip
"""Name -> module with its ``main`` (none: it is here), and what it does."""
ALIASES = {"ppo": "train"}


def main(argv: Sequence[str] | None = None) -> int:
    """The command line; returns the exit status.

    Args:
        argv: words; None for those of the program.
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
        return run(words[1:], prog=f"{prog} {name}")
    except KeyboardInterrupt:
        return INTERRUPTED


def program_name(path: str) -> str:
    """How the user calls the program whose file is ``sys.argv[0]``."""
    name = Path(path).name
    return "python -m agym_jax" if name == "__main__.py" else name.removesuffix(".exe")


def usage(prog: str) -> str:
    """All commands, one a line."""
    width = max(map(len, COMMANDS))
    lines = [f"usage: {prog} COMMAND ...", "", agym_jax.__doc__.splitlines()[0], "", "commands:"]
    lines += [f"  {name:<{width}}  {does}" for name, (_, does) in COMMANDS.items()]
    return "\n".join([*lines, "", f"{prog} COMMAND --help says more."])


def find(name: str) -> Callable[..., int]:
    """The function of a command: ``main(argv, prog=...)``.

    Raises:
        UnknownNameError: there is no such command; the message has the nearest.
        MissingExtraError: the trainer needs packages that are not installed.
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
    """The trainer as ``agym_jax.train``.

    A wheel has it as a folder of the package. In a checkout it is the folder ``train`` beside the package, which
    is loaded from there by its path: a ``train.py`` of the user's in the current folder is another module.

    Raises:
        MissingAssetError: it is not there.
        MissingExtraError: it needs packages that are not installed.
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
    """Print every environment id; returns the exit status."""
    parser = argparse.ArgumentParser(prog=prog, description="Print the environment ids.")
    parser.add_argument("part", nargs="?", default="", help="only those with this in their name")
    part = parser.parse_args(argv).part
    print("\n".join(name for name in agym_jax.list_envs() if part.lower() in name.lower()))
    return 0


def show_observations(argv: Sequence[str] | None = None, prog: str = "agym-jax observe") -> int:
    """Print an environment's observation tables; returns the exit status."""
    recipe = _recipe(argv, prog, "Print an environment's observations.")
    if recipe is None:
        return 2
    from agym_jax import observe

    records = {"Robot": recipe.task.robot_obs}
    if recipe.active:
        records["Human"] = recipe.task.human_obs
    for title, record in records.items():
        print(f"{title}: {observe.size(record)} columns\n\n{observe.table(record)}\n")
    return 0


def show_settings(argv: Sequence[str] | None = None, prog: str = "agym-jax settings") -> int:
    """Print what ``config`` and ``humans`` of ``agym_jax.make`` can change; returns the exit status."""
    recipe = _recipe(argv, prog, "Print what can be changed of an id.")
    if recipe is None:
        return 2
    from agym_jax.changes import settings_table, settings_tables

    for title, settings in settings_tables(recipe.task).items():
        print(f"{title}\n\n{settings_table(settings)}\n")
    return 0


def _recipe(argv: Sequence[str] | None, prog: str, description: str) -> Recipe | None:
    """What the id among command-line words stands for; None if there is no such, which is said."""
    parser = argparse.ArgumentParser(prog=prog, description=description)
    parser.add_argument("id", help="environment id, such as ScratchItchJaco-v0")
    name = parser.parse_args(argv).id
    from agym_jax.registry import parse

    try:
        return parse(name)
    except AgymError as error:
        print(f"{type(error).__name__}: {error}", file=sys.stderr)
        return None


if __name__ == "__main__":
    sys.exit(main())
