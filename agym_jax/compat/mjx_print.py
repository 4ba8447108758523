"""One line that MJX 3.17 prints when it is imported: that warp-lang, which is optional, is not installed.

``mujoco/mjx/warp/__init__.py`` writes it to standard output, where it would be taken for a program's result
(``agym-jax list > ids.txt``). Whoever needs MJX, or Brax, which imports it, imports this module first. Only where
warp-lang is missing, and only while MJX itself is imported, is standard output collected; what anybody else
writes meanwhile is passed on. ``tests/compat/test_mjx_print.py`` fails when MJX is silent; delete this file then.
"""

from __future__ import annotations

import contextlib
import importlib
import importlib.util
import io
import sys
from types import ModuleType

from agym_jax.compat import switch

NOTE = "Failed to import "
"""How the lines begin that are left out."""


def import_mjx() -> ModuleType:
    """``mujoco.mjx``, without its note if that can be avoided."""
    if (
        "mujoco.mjx" in sys.modules
        or importlib.util.find_spec("warp")
        or not switch.enabled("mjx_print")
    ):
        return importlib.import_module("mujoco.mjx")
    said = io.StringIO()
    try:
        with contextlib.redirect_stdout(said):
            return importlib.import_module("mujoco.mjx")
    finally:
        lines = said.getvalue().splitlines(keepends=True)
        sys.stdout.write("".join(line for line in lines if not line.startswith(NOTE)))


mjx = import_mjx()
