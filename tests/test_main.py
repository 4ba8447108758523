# ruff: noqa: D103
"""The command line: what it lists, what it starts, and whose modules it imports."""

from __future__ import annotations

import importlib
import inspect
import os
import re
import subprocess
import sys
from contextlib import nullcontext
from pathlib import Path

import pytest
from paths import PROCESS_SECONDS, ROOT

import agym_jax
from agym_jax import __main__ as cli
from agym_jax.errors import MissingAssetError
from agym_jax.tasks import TASKS

HOSTILE = "raise SystemExit('the train.py of the user was run')\n"


def run(code: str, folder: Path, *words: str, **settings: str) -> subprocess.CompletedProcess:
    """Python in another process: ``-c code``, or ``-m agym_jax`` without one."""
    start = ["-c", code] if code else ["-m", "agym_jax"]
    return subprocess.run(
        [sys.executable, *start, *words], cwd=folder, capture_output=True, text=True, check=False, timeout=PROCESS_SECONDS,
        env={"PYTHONPATH": str(ROOT), "PATH": "", "JAX_PLATFORMS": "cpu", "HOME": str(folder)} | settings,
    )  # fmt: skip


def test_help_lists_every_command_and_needs_no_jax(tmp_path: Path):
    code = (
        "import sys; from agym_jax.__main__ import main; status = main(['--help']); "
        "sys.exit(status or bool({'jax', 'mujoco', 'brax', 'tyro'} & set(sys.modules)))"
    )
    found = run(code, tmp_path)
    assert found.returncode == 0, found.stderr
    for name, (_, does) in cli.COMMANDS.items():
        assert re.search(rf"^  {name} +{re.escape(does)}$", found.stdout, re.M)
    assert max(map(len, found.stdout.splitlines())) <= 80


def test_no_command_is_help_and_a_failure(capsys: pytest.CaptureFixture):
    assert cli.main([]) == 2
    assert "commands:" in capsys.readouterr().out
    assert cli.main(["--version"]) == 0
    assert capsys.readouterr().out.strip() == agym_jax.__version__


def test_list_says_when_no_id_contains_a_text(capsys: pytest.CaptureFixture):
    assert cli.main(["list", "zzz"]) == 1
    assert "No environment id contains 'zzz'" in capsys.readouterr().err


def test_output_that_nobody_reads_any_more_is_no_error(tmp_path: Path):
    code = (
        "import sys; from agym_jax import __main__ as cli; "
        "cli.find = lambda name: (lambda words, prog: [print('x' * 99, flush=True) for _ in range(99999)]); "
        "sys.exit(cli.main(['list']))"
    )
    done = subprocess.run(
        ["bash", "-c", f'"{sys.executable}" -c "$0" | head -1; exit ${{PIPESTATUS[0]}}', code],
        cwd=tmp_path, capture_output=True, text=True, check=False, timeout=PROCESS_SECONDS,
        env={"PYTHONPATH": str(ROOT), "PATH": os.environ["PATH"], "JAX_PLATFORMS": "cpu", "HOME": str(tmp_path)},
    )  # fmt: skip
    assert done.returncode == cli.PIPE_CLOSED and done.stderr == "", done.stderr


def test_an_unknown_command_says_what_is_near(capsys: pytest.CaptureFixture):
    assert cli.main(["evalute"]) == 2
    said = capsys.readouterr().err
    assert "Unknown command 'evalute'. Did you mean 'evaluate'?" in said


@pytest.mark.parametrize(
    ("file", "name"),
    [
        ("/venv/bin/agym-jax", "agym-jax"),
        ("agym-jax.exe", "agym-jax"),
        ("/site/agym_jax/__main__.py", "python -m agym_jax"),
    ],
)
def test_the_help_shows_what_was_typed(file: str, name: str, monkeypatch, capsys):
    assert cli.program_name(file) == name
    monkeypatch.setattr(sys, "argv", [file])
    for words in (["--help"], ["placements", "--help"], ["postures", "build", "--help"]):
        with pytest.raises(SystemExit) if words[1:] else nullcontext():
            cli.main(words)
        assert f"usage: {' '.join([name, *words[:-1]])} " in capsys.readouterr().out


@pytest.mark.parametrize("name", cli.COMMANDS)
def test_every_command_has_a_main_that_is_told_its_name(name: str):
    main = cli.find(name)
    assert next(iter(inspect.signature(main).parameters)) in ("argv", "arguments")
    assert "prog" in inspect.signature(main).parameters


def test_ppo_is_another_name_of_train():
    assert cli.find("ppo") is cli.find("train")


def test_ids_are_listed(capsys: pytest.CaptureFixture):
    assert cli.main(["list"]) == 0
    assert capsys.readouterr().out.split() == agym_jax.list_envs()
    assert cli.main(["list", "pr2human"]) == 0
    assert capsys.readouterr().out.split() == [f"{task}PR2Human-v0" for task in TASKS]


def test_observe_prints_every_column(capsys: pytest.CaptureFixture):
    assert cli.main(["observe", "ScratchItchJacoHuman-v0"]) == 0
    out = capsys.readouterr().out
    task = TASKS["ScratchItch"]
    for record in (task.robot_obs, task.human_obs):
        for name in agym_jax.observe.columns(record):
            assert f"`{name}`" in out
    assert "| 29 | `tool_force` | N |" in out and "| 32 | `force_on_human` |" in out
    assert "Robot: 30 columns" in out and "Human: 34 columns" in out
    assert "Robot: 7 actions in [-1, 1], of j2s7s300_joint_1" in out
    assert "Human: 10 actions" in out and "plus 0.25 rad times the action" in out
    assert cli.main(["observe", "ScratchItchJaco-v0"]) == 0
    assert "Human" not in capsys.readouterr().out


def test_observe_refuses_nonsense(capsys: pytest.CaptureFixture):
    with pytest.raises(SystemExit, match="2"):
        cli.main(["observe"])
    assert "usage" in capsys.readouterr().err
    assert cli.main(["observe", "ScratchIchJaco-v0"]) == 2
    assert "Did you mean 'ScratchItchJaco-v0'" in capsys.readouterr().err


def test_an_id_may_name_a_module_in_the_current_folder(tmp_path: Path):
    """Although a console script, unlike ``python -m``, does not look for modules there."""
    (tmp_path / "my_tasks.py").write_text(
        "import dataclasses\n"
        "from agym_jax.registry import register_task\n"
        "from agym_jax.tasks import TASKS\n"
        "register_task(dataclasses.replace(TASKS['Reaching'], name='Waving'))\n"
    )
    found = run("", tmp_path, "observe", "my_tasks:WavingJaco-v0", PYTHONSAFEPATH="1")
    assert found.returncode == 0 and "`hand_pos_mouth`" in found.stdout, found.stderr


# -- the trainer ---------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_train_py_in_the_current_folder_does_no_harm(tmp_path: Path):
    (tmp_path / "train.py").write_text(HOSTILE)
    as_module = run("", tmp_path, "evaluate", "--help")
    assert as_module.returncode == 0, as_module.stderr + as_module.stdout
    assert "usage: python -m agym_jax evaluate" in as_module.stdout
    # a console script, with the current folder on the path besides
    code = (
        "import sys; sys.argv[0] = 'agym-jax'; from agym_jax.__main__ import main; sys.exit(main())"
    )
    as_script = run(code, tmp_path, "evaluate", "--help")
    assert as_script.returncode == 0, as_script.stderr + as_script.stdout
    assert "usage: agym-jax evaluate" in as_script.stdout


@pytest.mark.slow
def test_a_module_train_of_the_users_stays_theirs(tmp_path: Path):
    (tmp_path / "train.py").write_text("mine = True\n")
    code = (
        "import train, agym_jax.__main__ as cli; trainer = cli.trainer(); "
        "import agym_jax.train.ppo as ppo, sys; assert train.mine and sys.modules['train'] is train; "
        "assert trainer is agym_jax.train and ppo.__package__ == 'agym_jax.train'"
    )
    found = run("import agym_jax; " + code, tmp_path)
    assert found.returncode == 0, found.stderr


def test_missing_packages_of_the_trainer_are_named(tmp_path: Path):
    code = "import sys; sys.modules['tyro'] = None; from agym_jax.__main__ import main; sys.exit(main(['evaluate', '--help']))"
    found = run(code, tmp_path)
    assert found.returncode == 2
    assert found.stderr.startswith("MissingExtraError: ") and "tyro" in found.stderr
    assert 'pip install "agym_jax[train]"' in found.stderr


def test_an_installation_without_the_trainer_says_so(tmp_path: Path, monkeypatch):
    monkeypatch.delitem(sys.modules, cli.TRAINER, raising=False)
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    monkeypatch.setattr(cli, "__file__", str(tmp_path / "agym_jax" / "__main__.py"))
    with pytest.raises(MissingAssetError, match=r"without its trainer .*train.*Reinstall"):
        cli.trainer()
