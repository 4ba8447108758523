# ruff: noqa: D103
"""Ids: what exists, what users add, and what is said about what does not exist."""

from __future__ import annotations

import dataclasses
import re
import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

import gymnasium
import pytest

import agym_jax
from agym_jax.errors import AgymError, MissingPlacementError, SpecError, UnknownNameError
from agym_jax.policy.files import find_policies
from agym_jax.registry import list_envs, parse, plain_id, register_robot, register_task
from agym_jax.robots import ROBOTS
from agym_jax.tasks import TASKS
from train.configs import config_for


def test_every_listed_id_parses_into_itself():
    ids = list_envs()
    assert len(ids) == len(set(ids)) == 2 * len(TASKS) * len(ROBOTS)
    assert agym_jax.list_envs() == ids
    assert {"ReachingPR2-v0", "BedBathingSawyer-v0", "ArmManipulationBaxterHuman-v0"} <= set(ids)
    for name in ids:
        recipe = parse(name)
        assert recipe.name == name
        assert recipe.active == ("Human" in name)
        assert name.startswith(recipe.task.name + recipe.robot.name)


@pytest.mark.parametrize("prefix", ["agym_jax:", "agym_jax/"])
def test_prefix_of_the_package_is_dropped(prefix: str):
    assert parse(f"{prefix}ScratchItchJaco-v0") == parse("ScratchItchJaco-v0")
    assert plain_id(f"{prefix}ScratchItchJaco-v0") == plain_id("ScratchItchJaco-v0")
    assert find_policies(f"{prefix}ScratchItchJaco-v0") == find_policies("ScratchItchJaco-v0")
    settings = config_for("DressingJaco-v0")
    prefixed = config_for(f"{prefix}DressingJaco-v0")
    assert dataclasses.replace(prefixed, env_name=settings.env_name) == settings


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("ScratchItchJako-v0", r"Did you mean 'ScratchItchJaco-v0'.*robot 'Jako' does not.*'Jaco'"),
        ("ScratchItchjaco-v0", r"Did you mean 'ScratchItchJaco-v0'"),
        ("ScratchItchPR3-v0", r"The task ScratchItch exists, the robot 'PR3' does not"),
        ("ScrachItchJacoHuman-v0", r"Did you mean 'ScratchItchJacoHuman-v0'.*task \+ robot"),
        ("ScratchItchJaco-v7", r"Unknown environment 'ScratchItchJaco-v7'.*-v0"),
        ("nonsense", r"There are: "),
    ],
)
def test_unknown_id_says_what_is_wrong_and_what_is_near(name: str, message: str):
    with pytest.raises(UnknownNameError, match=message) as caught:
        agym_jax.make(name)
    assert isinstance(caught.value, AgymError) and isinstance(caught.value, KeyError)


@pytest.fixture
def outside(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A folder on the Python path with a module that registers a task, and broken ones."""
    (tmp_path / "my_waving.py").write_text(
        "import dataclasses\n"
        "from agym_jax.registry import register_task\n"
        "from agym_jax.tasks import TASKS\n"
        "register_task(dataclasses.replace(TASKS['Reaching'], name='Waving'))\n"
    )
    (tmp_path / "my_broken.py").write_text("import a_package_that_is_not_there\n")
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    yield tmp_path
    TASKS.pop("Waving", None)
    for name in ("my_waving", "my_broken"):
        sys.modules.pop(name, None)


def test_the_module_before_the_colon_is_imported_once(outside: Path):
    with pytest.raises(UnknownNameError, match=r"own is my_module:WavingJaco-v0"):
        parse("WavingJaco-v0")
    recipe = parse("my_waving:WavingJacoHuman-v0")
    assert recipe.name == "WavingJacoHuman-v0" and recipe.active
    assert recipe.task is TASKS["Waving"] is parse("my_waving:WavingPR2-v0").task
    assert parse("my_waving:ReachingJaco-v0") == parse("ReachingJaco-v0")
    with pytest.raises(UnknownNameError, match=r"'WavingJaco-v0'\?.*my_waving was imported"):
        parse("my_waving:WavngJaco-v0")


@pytest.mark.parametrize("module", ["my_wavin", "my_wavin.tasks", "my-waving", ".my_waving", "a b"])
def test_a_module_that_is_not_there_is_named(outside: Path, module: str):
    wanted = rf"Unknown module '{re.escape(module)}'\. (Did you mean 'my_waving'|There are: ).*PYTHONPATH"
    with pytest.raises(UnknownNameError, match=wanted):
        parse(f"{module}:WavingJaco-v0")


def test_what_a_module_itself_lacks_is_not_hidden(outside: Path):
    with pytest.raises(ModuleNotFoundError, match="a_package_that_is_not_there"):
        parse("my_broken:WavingJaco-v0")


def test_the_program_that_runs_is_not_imported_again(outside: Path, monkeypatch):
    program = ModuleType("__main__")
    program.__file__ = str(outside / "my_broken.py")
    monkeypatch.setitem(sys.modules, "__main__", program)
    assert parse("my_broken:ReachingJaco-v0").name == "ReachingJaco-v0"


def test_task_from_outside_gets_ids_and_says_what_it_lacks():
    toy = dataclasses.replace(TASKS["ScratchItch"], name="ToyItch")
    register_task(toy)
    try:
        assert "ToyItchJaco-v0" in list_envs() and "ToyItchJacoHuman-v0" in list_envs()
        assert parse("ToyItchJaco-v0").task is toy
        with pytest.raises(
            MissingPlacementError, match=r"agym-jax placements build ToyItchJaco-v0"
        ):
            agym_jax.make("ToyItchJaco-v0")
        with pytest.raises(SpecError, match="'ToyItch' already"):
            register_task(toy)
        agym_jax.register_envs()
        assert "ToyItchJaco-v0" in gymnasium.registry
    finally:
        del TASKS["ToyItch"]
        for name in [n for n in gymnasium.registry if n.startswith("ToyItch")]:
            del gymnasium.registry[name]
    assert "ToyItchJaco-v0" not in list_envs()


def test_robot_from_outside_gets_ids():
    robot = dataclasses.replace(ROBOTS["Jaco"], name="Toybot")
    register_robot(robot)
    try:
        assert parse("ScratchItchToybotHuman-v0").robot is robot
        with pytest.raises(SpecError, match="'Toybot' already"):
            register_robot(robot)
    finally:
        del ROBOTS["Toybot"]
