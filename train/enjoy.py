"""Watch a policy: ``agym-jax enjoy --env-name ScratchItchJaco-v0 --clip scratch.gif``.

Runs a single environment on the CPU with C MuJoCo; the seed determines the episodes. Writes a video or a contact sheet, or
opens MuJoCo's viewer, and prints each episode's return, force and success. ``--ending failure`` searches for episodes that
fail.
"""

from __future__ import annotations

import itertools
import os
import sys
import time
import warnings
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import jax

from agym_jax.data.npz import check_writable
from agym_jax.errors import checked_count
from agym_jax.flags import Count, PolicyFlags, parse_flags
from agym_jax.policy.agents import AnyPolicy
from agym_jax.policy.check import trained_otherwise
from agym_jax.policy.files import load_policies
from agym_jax.rendering.clips import contact_sheet, evenly, write_clip
from agym_jax.rendering.meshes import check_visuals
from agym_jax.rendering.render import check_backend
from agym_jax.sim.pictures import check_camera

from .envs import env_and_policies, jit_functions, make_env
from .errors import ConfigError, reports_errors
from .learning.rollout import COMFORT_KEY, FORCE_KEY
from .runs.progress import LINE_PERIOD

SHEET_PICTURES = 20
LOOK_THROUGH = 300
"""Number of episodes to search for those with a requested ending."""
QUIET = 3.0  # seconds of drawing without a word
Ending = Literal["any", "success", "failure", "rough"]
SCREENS = ("DISPLAY", "WAYLAND_DISPLAY")
"""Environment variables one of which is set on Linux if there is a display."""


@dataclass(frozen=True)
class EnjoyConfig(PolicyFlags):
    """Flags of ``agym-jax enjoy``."""

    episodes: Count = 1
    """Number of episodes, played one after the other."""
    seed: int = 1001
    """Seed of the first episode; later episodes use the seeds that follow."""
    ending: Ending = "any"
    """Show only episodes that end in success or in failure, or rough ones, in which a force exceeded a comfort limit."""
    impl: str = "native"
    """Physics: "native" (C MuJoCo, quick to start) or "jax" (MJX, as in training)."""
    clip: Path | None = None
    """Video file to write, .gif or .mp4."""
    sheet: Path | None = None
    """Contact sheet to write, .png."""
    viewer: bool = False
    """Open MuJoCo's viewer (requires a display)."""
    camera: str = "front"
    """Camera of the video and the contact sheet."""
    width: Count = 480
    """Image width in pixels."""
    height: Count = 360
    """Image height in pixels."""
    backend: str = "auto"
    """Rendering backend: "gl", "raycast" or "auto"."""
    visuals: str = "primitives"
    """Appearance of the robot: "primitives", or "meshes" from other packages (agym_jax[meshes])."""

    def __post_init__(self) -> None:
        """Reject settings that are invalid or cannot be shown, before anything is built.

        Raises:
            ArgumentError: if there are no episodes, or the image size is not positive.
            RenderBackendError: if there is no such rendering backend.
            UnknownCameraError: if there is no such camera.
            ConfigError: if there is no display for the viewer.
        """
        for name in ("episodes", "width", "height"):
            checked_count(f"--{name}", getattr(self, name))
        check_backend(self.backend)
        check_camera(self.camera)
        if self.viewer and sys.platform == "linux" and not any(map(os.environ.get, SCREENS)):
            raise ConfigError(
                "--viewer needs a screen, and there is none (neither DISPLAY nor WAYLAND_DISPLAY is set). Write a film "
                "instead: --clip out.gif"
            )


@dataclass(frozen=True)
class Frame:
    """One moment of an episode.

    Attributes:
        state: state of the environment.
        step: control steps taken.
        total: return so far.
        force: force on the person in this step [N].
        success: whether the task is done.
        over: whether the episode ends here.
        of_comfort: largest force in this step as a fraction of a comfort limit; above 1, a limit was exceeded.
    """

    state: Any
    step: int
    total: float
    force: float
    success: bool
    over: bool
    of_comfort: float = 0.0


class Notice:
    """Shows progress on standard error: in place in a terminal, otherwise one line every ten seconds.

    Used in a ``with`` statement, whose end removes what is shown in place.

    Args:
        quiet: time before anything is shown [s].
    """

    def __init__(self, quiet: float = 0.0) -> None:
        self._start = time.monotonic()
        self._next = self._start + quiet
        self._width = 0

    def __call__(self, text: str) -> None:
        """Show a text, which replaces the one before."""
        now = time.monotonic()
        if now < self._next:
            return
        if sys.stderr.isatty():
            print(f"\r{text:<{self._width}}", end="", file=sys.stderr, flush=True)
            self._width = len(text)
        else:
            print(text, file=sys.stderr, flush=True)
            self._next = now + LINE_PERIOD

    def count(self, what: str, done: int, total: int) -> None:
        """Show how many of several equal parts are done, and how long the others will take; nothing after the last.

        Args:
            what: text before the numbers.
            done: at least 1.
            total: number of all parts.
        """
        left = (time.monotonic() - self._start) / done * (total - done)
        if done < total:
            self(f"{what}: {done}, about {left:.0f} s left")

    def clear(self) -> None:
        """Remove what is shown in place."""
        if self._width:
            print(f"\r{'':{self._width}}\r", end="", file=sys.stderr, flush=True)
            self._width = 0

    def __enter__(self) -> Notice:
        return self

    def __exit__(self, *_: object) -> None:
        self.clear()


class Player:
    """Plays episodes of one environment; compiles only once."""

    def __init__(self, env: Any, policy: AnyPolicy, deterministic: bool = True) -> None:
        self.env = env
        self._reset, self._step = jit_functions(env)
        self._act = jax.jit(lambda obs, key: policy(obs, key, deterministic))

    def episode(self, seed: int) -> Iterator[Frame]:
        """Yield the frames of the episode with a given seed, including the start."""
        key_reset, key = jax.random.split(jax.random.PRNGKey(seed))
        state = self._reset(key_reset)
        total = 0.0
        yield Frame(state, 0, total, 0.0, False, False)
        keys = jax.random.split(key, self.env.episode_length)
        for step in range(1, self.env.episode_length + 1):
            state = self._step(state, self._act(state.obs, keys[step - 1]))
            total += float(state.reward)
            force = float(state.metrics.get(FORCE_KEY, 0.0))
            success = bool(state.metrics.get("success", 0.0) > 0.5)
            over = bool(state.done > 0)
            of_comfort = float(state.metrics.get(COMFORT_KEY, 0.0))
            yield Frame(state, step, total, force, success, over, of_comfort)
            if over:
                return

    def episodes(self, seed: int, ending: Ending = "any") -> Iterator[tuple[int, Iterator[Frame]]]:
        """Yield the seeds and frames of episodes with a given ending, searching ``LOOK_THROUGH`` seeds unless it is "any".

        Args:
            seed: first seed to try.
            ending: requested ending of the episodes.
        """
        if ending == "any":
            for number in itertools.count(seed):
                yield number, self.episode(number)
        with Notice() as notice:
            for number in range(seed, seed + LOOK_THROUGH):
                notice(f"Looking at seed {number}")
                frames = list(self.episode(number))
                if ends_so(frames, ending):
                    notice.clear()
                    yield number, iter(frames)


def ends_so(frames: Sequence[Frame], ending: Ending) -> bool:
    """Return whether an episode has a given ending, which must not be "any"."""
    if ending == "rough":
        return any(frame.of_comfort > 1 for frame in frames)
    return frames[-1].success == (ending == "success")


def caption(frame: Frame) -> str:
    """Return the caption of a frame."""
    success = "  success" if frame.success else ""
    return f"step {frame.step}  return {frame.total:.1f}  force {frame.force:.1f} N{success}"


def film(
    env: Any, frames: Sequence[Frame], config: EnjoyConfig, notice: Notice | None = None
) -> list[Any]:
    """Render the frames of one episode, uint8 (height, width, 3) each; ``notice`` shows how many are done."""
    from agym_jax.rendering.render import Renderer

    model, data = env.to_mujoco(frames[0].state, config.visuals)
    pictures, size = [], (config.width, config.height)
    with Renderer(model, *size, config.camera, config.backend) as renderer:
        for frame in frames:
            env.write_mujoco(frame.state, data, model)
            pictures.append(renderer.render(data, env.markers(frame.state)))
            if notice:
                notice.count(f"Drawing {len(frames)} pictures", len(pictures), len(frames))
    return pictures


def watch(env: Any, frames: Iterator[Frame], visuals: str) -> list[Frame]:
    """Show an episode in MuJoCo's viewer in real time and return its frames.

    Raises:
        ConfigError: if the viewer cannot be opened, for example on a machine without a display.
    """
    try:
        import mujoco.viewer

        from agym_jax.rendering.render import add_markers

        first = next(frames)
        model, data = env.to_mujoco(first.state, visuals)
        handle = mujoco.viewer.launch_passive(model, data)
    except Exception as error:  # GLFW and X fail in many ways
        raise ConfigError(
            f"The viewer did not open ({type(error).__name__}: {error}). It needs a screen, and "
            f"mjpython on macOS. Without one, write a film: --clip out.gif"
        ) from error
    seen = [first]
    with handle as viewer:
        for frame in frames:
            due = time.monotonic() + env.dt
            with viewer.lock():
                env.write_mujoco(frame.state, data, model)
                viewer.user_scn.ngeom = 0
                add_markers(viewer.user_scn, env.markers(frame.state))
            viewer.sync()
            seen.append(frame)
            if not viewer.is_running():
                break
            time.sleep(max(0.0, due - time.monotonic()))
    return seen


def _check_outputs(config: EnjoyConfig) -> None:
    """Reject invalid file names before spending a minute on compilation."""
    for path, endings in ((config.clip, (".gif", ".mp4")), (config.sheet, (".png",))):
        if path is None:
            continue
        if path.suffix.lower() not in endings:
            raise ConfigError(
                f"Cannot write {str(path)!r}: the name must end in {' or '.join(endings)}."
            )
        check_writable(path.parent, "Choose another file.")


def play(config: EnjoyConfig, env: Any, policy: AnyPolicy) -> list[Frame]:
    """Play, print and record the requested episodes and return the last frame of each.

    Raises:
        ConfigError: if no episode has the requested ending.
    """
    player = Player(env, policy, deterministic=not config.non_det)
    pictures, labels, lasts = [], [], []
    found = player.episodes(config.seed, config.ending)
    for number, (seed, frames) in enumerate(itertools.islice(found, config.episodes), 1):
        frames = watch(env, frames, config.visuals) if config.viewer else list(frames)
        last = frames[-1]
        force = sum(frame.force for frame in frames) / max(1, last.step)
        done = "success" if last.success else "no success"
        cut = "" if last.over else ", stopped early"
        print(
            f"{env.name} episode {number}, seed {seed}: {last.step} steps, "
            f"return {last.total:.1f}, mean force {force:.2f} N, {done}{cut}",
            flush=True,  # before what is said of the drawing
        )
        lasts.append(last)
        if config.clip or config.sheet:
            if not config.clip:  # a sheet shows twenty of them
                frames = [frames[i] for i in evenly(len(frames), SHEET_PICTURES)]
            with Notice(QUIET) as notice:
                pictures += film(env, frames, config, notice)
            labels += [caption(frame) for frame in frames]
    if len(lasts) < config.episodes:
        words = "rough" if config.ending == "rough" else f"a {config.ending}"
        seeds = f"seeds {config.seed} to {config.seed + LOOK_THROUGH - 1} is {words}."
        if not lasts:
            raise ConfigError(
                f"None of the {LOOK_THROUGH} episodes with {seeds} Try another --seed, or --ending any."
            )
        print(
            f"{len(lasts)} of {config.episodes} found: no other of the {LOOK_THROUGH} episodes with {seeds}"
        )
    if config.clip:
        print(f"Video: {write_clip(pictures, config.clip, fps=round(1 / env.dt))}")
    if config.sheet:
        print(f"Pictures: {contact_sheet(pictures, config.sheet, labels=labels)}")
    return lasts


@reports_errors
def main(
    arguments: Sequence[str] | None = None,
    make: Callable[..., Any] = make_env,
    prog: str = f"python -m {__package__}.enjoy",
) -> int:
    """Run the command line and return the exit status."""
    config = parse_flags(EnjoyConfig, arguments, prog)
    jax.config.update(
        "jax_platforms", "cpu"
    )  # one environment: the accelerator would only be slower
    warnings.simplefilter("default")
    _check_outputs(config)
    env, files = env_and_policies(config, config.impl, make)
    if config.visuals != "primitives":  # before anything is compiled
        check_visuals(config.visuals, env.robot)
    policy = load_policies(files, env, config.any_env, other_people=True)
    if otherwise := trained_otherwise(policy, env):
        print(f"Differs from training: {otherwise}.")
    play(config, env, policy)
    return 0


if __name__ == "__main__":
    sys.exit(main())
