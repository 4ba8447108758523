"""Result lines: what was measured, by which commit, on which device, with which versions."""

from __future__ import annotations

import datetime
import importlib.metadata
import json
import platform
import subprocess
from pathlib import Path
from typing import Any

import jax

import agym_jax
from agym_jax.data.npz import append_line
from agym_jax.wrappers import available_cores

ROOT = Path(__file__).resolve().parents[2]
"""The checkout; in an installed wheel, where this is ``agym_jax.train``, the package's folder."""
PACKAGES = ("jax", "jaxlib", "mujoco", "mujoco-mjx", "warp-lang", "brax", "flax", "optax")


def commit() -> str | None:
    """Git commit of this checkout, with ``+changes`` if files differ from it; None outside of a checkout.

    An installed wheel is in no checkout, even if its environment lies in a repository of the user's.
    """
    if not (ROOT / "pyproject.toml").is_file():
        return None
    try:
        git = ["git", "-C", str(ROOT)]
        head = subprocess.run(
            [*git, "rev-parse", "HEAD"], capture_output=True, text=True, timeout=10
        )
        status = subprocess.run(
            [*git, "status", "--porcelain", "--untracked-files=no"],
            capture_output=True,
            text=True,
            timeout=10,
        )
    except (OSError, subprocess.TimeoutExpired):
        return None
    if head.returncode:
        return None
    return head.stdout.strip() + ("+changes" if status.stdout.strip() else "")


def versions() -> dict[str, str]:
    """Versions of Python, agym_jax and the packages that results depend on, where installed."""
    found = {"python": platform.python_version(), "agym_jax": agym_jax.__version__}
    for name in PACKAGES:
        try:
            found[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            continue
    return found


def device() -> dict[str, Any]:
    """What JAX runs on, in words: platform, kind and number of devices, CPU cores."""
    devices = jax.devices()
    kind = devices[0].device_kind
    if devices[0].platform == "cpu":
        kind = _cpu_name() or kind
    return {
        "platform": devices[0].platform,
        "kind": kind,
        "count": len(devices),
        "cpu_cores": available_cores(),
    }


def _cpu_name() -> str | None:
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return platform.processor() or None
    return next((s.split(":", 1)[1].strip() for s in lines if s.startswith("model name")), None)


def record(kind: str, **fields: Any) -> dict[str, Any]:
    """A result line: ``kind``, the fields, and commit, device, versions and time (UTC)."""
    now = datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds")
    about = {"commit": commit(), "device": device(), "versions": versions(), "time": now}
    return {"kind": kind, **fields, **about}


def append_record(path: Path | str, line: dict[str, Any]) -> None:
    """Add a result line to a file of JSON lines.

    Args:
        path: file.
        line: from ``record``.
    """
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    append_line(path, json.dumps(line, sort_keys=True))
