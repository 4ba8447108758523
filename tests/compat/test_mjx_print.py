# ruff: noqa: D103
"""MJX prints a note when it is imported without warp-lang; imported by us, it does not."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
from paths import PROCESS_SECONDS, ROOT

from agym_jax.compat import mjx_print

WITHOUT_WARP = "import sys; sys.modules['warp'] = None; "


def printed(code: str, folder: Path, compat: str = "") -> str:
    """Standard output of a program on a machine without warp-lang."""
    found = subprocess.run(
        [sys.executable, "-c", WITHOUT_WARP + code], cwd=folder, capture_output=True, text=True, check=False, timeout=PROCESS_SECONDS,
        env={"PYTHONPATH": str(ROOT), "PATH": "", "JAX_PLATFORMS": "cpu", "AGYM_JAX_COMPAT": compat},
    )  # fmt: skip
    assert found.returncode == 0, found.stderr
    return found.stdout


def test_mjx_still_prints_by_itself(tmp_path: Path):
    """When this fails MJX is silent: delete ``compat/mjx_print.py`` and import ``mujoco.mjx`` instead."""
    assert mjx_print.NOTE in printed("from mujoco import mjx", tmp_path)


@pytest.mark.parametrize(
    "module", ["agym_jax.sim.mjx", "agym_jax.policy", "agym_jax.policy.networks", "train.learning.ppo"]
)  # fmt: skip
def test_it_does_not_when_we_import_it(tmp_path: Path, module: str):
    assert printed(f"import {module}", tmp_path) == ""


def test_the_repair_can_be_switched_off(tmp_path: Path):
    assert mjx_print.NOTE in printed("import agym_jax.sim.mjx", tmp_path, "-mjx_print")


def test_what_others_print_meanwhile_is_passed_on(monkeypatch, capsys: pytest.CaptureFixture):
    def noisy(name: str) -> None:
        print(f"{mjx_print.NOTE}warp: No module named 'warp'\nsomebody else\n{name}")

    monkeypatch.delitem(sys.modules, "mujoco.mjx")
    monkeypatch.setattr(mjx_print.importlib.util, "find_spec", lambda name: None)
    monkeypatch.setattr(mjx_print.importlib, "import_module", noisy)
    mjx_print.import_mjx()
    assert capsys.readouterr().out == "somebody else\nmujoco.mjx\n"
