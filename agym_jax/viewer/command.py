"""``agym-jax view ID``: watch an episode in the browser, or save it as a web page (``--export``)."""

from __future__ import annotations

import contextlib
import importlib.util
import socket
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from agym_jax.errors import (
    AgymError,
    ArgumentError,
    MissingExtraError,
    PolicyNotFoundError,
    checked_count,
)
from agym_jax.flags import Count, PolicyFlags, parse_flags

if TYPE_CHECKING:
    from agym_jax.policy.agents import AnyPolicy
    from agym_jax.policy.files import PolicyFiles
    from agym_jax.viewer.picture import Picture
    from agym_jax.viewer.stage import Stage

Say = Callable[[str], None]
MOST = 64  # environments side by side


@dataclass(frozen=True)
class ViewConfig(PolicyFlags):
    """Flags of ``agym-jax view``."""

    seed: int = 1001
    """Seed of the first episode; later episodes use the seeds that follow."""
    grid: Count = 1
    """Number of episodes shown side by side."""
    visuals: str = "primitives"
    """Appearance of the robot: "primitives", or "meshes" from other packages (agym_jax[meshes])."""
    host: str = "127.0.0.1"
    """Address on which to serve."""
    port: int = 8080
    """Port on which to serve; 0 = any free port."""
    export: Path | None = None
    """Instead of serving, write an episode to this .html page, which opens without a server."""
    steps: Count | None = None
    """With --export: number of control steps; by default, the whole episode."""


def check(config: ViewConfig) -> None:
    """Reject settings that cannot be shown, before anything is built.

    Raises:
        MissingExtraError: if viser is not installed.
        UnknownNameError: if there is no such environment, or there are no such visuals.
        ArgumentError: if a number or a file name is invalid, or the port is in use.
        SaveFolderError: if the page's folder cannot be written to.
    """
    from agym_jax.data.npz import check_writable
    from agym_jax.registry import parse
    from agym_jax.rendering.meshes import check_visuals

    if not importlib.util.find_spec("viser"):
        raise MissingExtraError('The viewer needs viser: pip install "agym_jax[view]"')
    recipe = parse(config.env_name)
    check_visuals(config.visuals, recipe.robot)
    checked_count("--grid", config.grid)
    if config.grid > MOST:
        raise ArgumentError(
            f"--grid {config.grid} is more than a browser can draw; use at most {MOST}."
        )
    if not 0 <= config.seed < 2**31:
        raise ArgumentError(f"--seed must be from 0 to 2147483647, got {config.seed}.")
    if config.steps is not None:
        checked_count("--steps", config.steps)
        if config.export is None:
            raise ArgumentError("--steps requires --export PAGE.")
    if config.export is None:
        check_port(config.host, config.port)
        return
    if config.export.suffix.lower() != ".html" or config.export.is_dir():
        raise ArgumentError(f"Cannot write {str(config.export)!r}: the name must end in .html.")
    check_writable(config.export.absolute().parent, "Choose another file.")


def check_port(host: str, port: int) -> None:
    """Reject a port on which the page cannot be served.

    Raises:
        ArgumentError: if it is in use, or there is no such port or address.
    """
    if not 0 <= port < 2**16:
        raise ArgumentError(f"--port must be from 0 to 65535 (0: any free port), got {port}.")
    with socket.socket() as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((host, port))
        except OSError as error:
            raise ArgumentError(
                f"Cannot serve at {host}:{port} ({error.strerror}). Another viewer may run there: choose another port, "
                f"such as --port {port + 1}, or --port 0 for any free port."
            ) from error


def main(argv: Sequence[str] | None = None, prog: str = "agym-jax view") -> int:
    """Run the command line, with the id as ``--env-name`` or as first argument, and return the exit status."""
    does = f"Watch an episode in the browser, control it by hand, or save it as a web page: {prog} ID ..."
    config = parse_flags(ViewConfig, argv, prog, does)
    try:
        check(config)
        config = parse_flags(ViewConfig, argv, prog, does, policy_settings(config))
        run(config)
    except AgymError as error:
        print(f"{type(error).__name__}: {error}", file=sys.stderr)
        return 2
    return 0


def run(config: ViewConfig) -> None:
    """Serve or write the page; returns when it is written, or on KeyboardInterrupt.

    Raises:
        AgymError: if a policy does not exist or does not fit.
    """
    began = time.perf_counter()

    def say(text: str) -> None:
        print(f"[{time.perf_counter() - began:4.1f} s] {text}", flush=True)

    import jax

    jax.config.update("jax_platforms", "cpu")  # one environment: an accelerator would be slower
    import agym_jax
    from agym_jax.policy.check import trained_otherwise
    from agym_jax.policy.files import load_policies
    from agym_jax.viewer.picture import Picture
    from agym_jax.viewer.serve import close_server, open_server

    files = policy_files(config, say)
    env = agym_jax.make(config.env_name, impl="native", **config.options())
    policy = load_policies(files, env, config.any_env, other_people=True) if files else None
    if policy and (otherwise := trained_otherwise(policy, env)):
        say(f"Differs from training: {otherwise}.")
    server = open_server(env.name, config.host, 0 if config.export else config.port)
    try:
        picture = Picture(server)
        if config.export is None:
            serve(config, env, policy, picture, say)
        else:
            export(config, config.export, env, policy, picture, say)
    finally:
        close_server(server)


def begin(config: ViewConfig, env: Any, policy: AnyPolicy | None, say: Say) -> Stage:
    """Make the environments and begin an episode."""
    from agym_jax.viewer.drive import Driver
    from agym_jax.viewer.stage import Stage

    say("Preparing the first episode; anything not shown before is compiled first.")
    driver = Driver(env, policy, deterministic=not config.non_det)
    stage = Stage(env, driver, config.grid, config.visuals)
    stage.begin(config.seed)
    return stage


def export(
    config: ViewConfig, file: Path, env: Any, policy: AnyPolicy | None, picture: Picture, say: Say
) -> None:
    """Write an episode to a page."""
    from agym_jax.viewer.replay import write_replay

    stage = begin(config, env, policy, say)
    say(f"Playing {config.steps or env.episode_length} steps.")
    size = write_replay(stage, picture, config.steps, file)
    say(f"Page: {file} ({size / 1e6:.1f} MB); it opens without a server.")


def serve(
    config: ViewConfig, env: Any, policy: AnyPolicy | None, picture: Picture, say: Say
) -> None:
    """Serve the page until KeyboardInterrupt."""
    from agym_jax.viewer.page import PANEL, Page
    from agym_jax.viewer.stage import preview

    server = picture.server
    place, moment = preview(env, config.visuals)
    picture.show([place], moment)
    picture.aim("front", PANEL)
    note = server.gui.add_markdown("Preparing the first episode ...")
    say(f"Serving at http://{config.host}:{server.get_port()} (Ctrl+C to stop).")
    stage = begin(config, env, policy, say)
    note.remove()
    page = Page(stage, picture)
    say("Ready.")
    page.run()


def policy_settings(config: ViewConfig) -> dict[str, Any]:
    """Return the ``agym_jax.make`` arguments of the environment that the policy is for, which hold where no flag says otherwise.

    Raises:
        AgymError: if a requested policy does not exist.
    """
    from agym_jax.policy.check import settings_for

    files = policy_files(config, lambda _: None)
    return settings_for(files.robot, config.env_name) if files else {}


def policy_files(config: ViewConfig, say: Say) -> PolicyFiles | None:
    """Return the policies that control the episode; None if none is requested and none is shipped.

    A robot policy for a passive person can also be used if the person is active, who then does nothing.

    Raises:
        AgymError: if a requested policy does not exist.
    """
    from agym_jax.policy.agents import BASELINES
    from agym_jax.policy.files import PolicyFiles, find_policies
    from agym_jax.policy.policy import read_policy
    from agym_jax.registry import parse, static_id

    recipe = parse(config.env_name)
    name, still = recipe.name, static_id(recipe.name)
    asked = config.policy or config.load_dir or config.human_policy
    try:
        given = (config.load_dir, config.policy, config.human_policy)
        files = find_policies(name, *given, memory=config.memory)
    except PolicyNotFoundError:
        if asked:
            raise
    else:
        if not recipe.active or files.human or files.robot in BASELINES:
            return files
        alone = read_policy(files.robot).info.get("agent", "robot") == "robot"
        return PolicyFiles(files.robot, "zero") if alone else files
    if recipe.active:
        with contextlib.suppress(PolicyNotFoundError):
            files = PolicyFiles(find_policies(still, memory=config.memory).robot, "zero")
            say(f"No policies are shipped for {name}: the robot uses that of {still}, and the person does nothing.")  # fmt: skip
            return files
    say(f"No policy is shipped for {name}: nobody acts until you choose who drives.")
    return None
