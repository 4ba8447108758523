"""Measuring in a fresh process."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from typing import Any

from agym_jax.errors import AgymError


class ChildError(AgymError, RuntimeError):
    """A measuring process that failed."""


def run_child(code: str, *arguments: str, **environment: str) -> Any:
    """What a fresh Python process prints as JSON in its last line.

    Args:
        code: what it runs.
        arguments: its ``sys.argv[1:]``.
        environment: variables that it gets besides those of this process.

    Raises:
        ChildError: it failed; with the end of what it said.
    """
    done = subprocess.run(
        [sys.executable, "-c", code, *arguments],
        capture_output=True,
        text=True,
        env={**os.environ, **environment},
    )
    if done.returncode:
        raise ChildError(f"A measuring process failed:\n{done.stderr[-2000:]}")
    return json.loads(done.stdout.strip().splitlines()[-1])
