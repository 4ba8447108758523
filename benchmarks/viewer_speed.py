"""How fluently the viewer plays: frames a second, and whether the episode keeps up with real time.

    taskset -c 0,1 python -m benchmarks.viewer_speed --json benchmarks/results/viewer_speed.jsonl

The page's own loop runs as it does for a user, with the policy that ships, contact forces and plots, at the speed of
real time and at most 25 frames a second. With ``--browser`` a Chromium without a display, which draws in software on the same cores,
has the page open; on a user's machine the graphics processor does that.
"""

from __future__ import annotations

import contextlib
import itertools
import re
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import tyro

from agym_jax.errors import ArgumentError, checked_count
from benchmarks.keep import keep

WARM = 3.0  # of play before anything counts [s]
RIGID = tuple(f"{task}Jaco-v0" for task in ("ScratchItch", "BedBathing", "ArmManipulation", "Reaching"))  # fmt: skip
"""Tasks without matter."""


@dataclass(frozen=True)
class ViewerSpeedConfig:
    """Flags of ``python -m benchmarks.viewer_speed``."""

    env_names: tuple[str, ...] = RIGID
    """Environment ids."""
    seconds: int = 10
    """Of play that count, all in one episode."""
    browser: Path | None = None
    """A Chromium that opens the page, without a display."""
    json: Path | None = None
    """File to which the results are added as JSON lines."""


@contextlib.contextmanager
def opened(browser: Path | None, address: str) -> Iterator[None]:
    """A page that is open while this lasts."""
    if browser is None:
        yield
        return
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
        words = [str(browser), "--headless=new", "--no-sandbox", f"--user-data-dir={folder}", "--window-size=1280,800", "--enable-unsafe-swiftshader", address]  # fmt: skip
        with subprocess.Popen(words, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as run:
            try:
                yield
            finally:
                run.terminate()


def measure(name: str, config: ViewerSpeedConfig) -> dict[str, Any]:
    """Fields of one result line.

    Raises:
        AgymError: viser is missing, there is no such environment, or its episodes are too short.
    """
    from agym_jax.viewer import command

    checked_count("--seconds", config.seconds)
    asked = command.ViewConfig(env_name=name)
    command.check(asked)
    import agym_jax
    from agym_jax.policy.files import load_policies
    from agym_jax.viewer.page import Page
    from agym_jax.viewer.picture import Picture
    from agym_jax.viewer.serve import close_server, open_server

    env = agym_jax.make(name, impl="native")
    warm = WARM * (3 if config.browser else 1)
    if warm + config.seconds > env.episode_length * env.dt:
        raise ArgumentError(
            f"--seconds {config.seconds}: an episode of {name} lasts {env.episode_length * env.dt:.0f} s, of which {warm:.0f} s do not count."
        )
    files = command.policy_files(asked, lambda _: None)
    policy = load_policies(files, env) if files else None
    server = open_server(env.name, asked.host, 0)
    times: list[float] = []
    steps: list[int] = []
    try:
        picture = Picture(server)
        page = Page(command.begin(asked, env, policy, lambda _: None), picture)
        with opened(config.browser, f"http://{asked.host}:{server.get_port()}"):
            began = time.monotonic() + warm

            def enough() -> bool:  # asked once a frame
                now = time.monotonic()
                if now > began:
                    times.append(now)
                    steps.append(int(page.stage.state(0).episode.step))
                return now > began + config.seconds

            page.run(enough)
            watching = len(server.get_clients())
    finally:
        close_server(server)
    spent = times[-1] - times[0]
    return {
        "env": name,
        "policy": bool(policy),
        "browser": _version(config.browser),
        "clients": watching,
        "frames_per_s": round((len(times) - 1) / spent, 1),
        "share_of_real_time": round((steps[-1] - steps[0]) * env.dt / spent, 3),
        "longest_frame_s": round(max(b - a for a, b in itertools.pairwise(times)), 3),
    }


def _version(browser: Path | None) -> str | None:
    if browser is None:
        return None
    told = subprocess.run([str(browser), "--version"], capture_output=True, text=True, check=False)
    found = re.search(r"\d[\d.]*", told.stdout)
    return found[0] if found else "?"


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; returns the exit status."""
    config = tyro.cli(ViewerSpeedConfig, prog="python -m benchmarks.viewer_speed", args=arguments)
    import jax

    jax.config.update("jax_platforms", "cpu")
    kept = [
        keep("viewer_speed", lambda name=name: measure(name, config), config.json)
        for name in config.env_names
    ]
    return 0 if all(kept) else 2


if __name__ == "__main__":
    sys.exit(main())
