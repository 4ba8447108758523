"""Run a demonstration on any CPU in a few minutes: ``agym-jax demo``.

1. The policy that ships with agym_jax helps a batch of people in parallel; the results are a table, a video and pictures.
2. A policy is trained from scratch for two to four minutes, its learning curve is plotted, and it is evaluated as well.

Both parts run on C MuJoCo, which starts within seconds.
"""

from __future__ import annotations

import dataclasses
import math
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jax
import numpy as np
import tyro

from agym_jax.data.npz import check_writable
from agym_jax.errors import checked_count
from agym_jax.flags import Count, command_words, first_paragraph
from agym_jax.policy.agents import baseline_policy
from agym_jax.policy.files import PolicyFiles, find_policy, load_policies
from agym_jax.registry import plain_id
from agym_jax.state import drawable, drawn_of

from .configs import config_for
from .enjoy import Frame, caption
from .envs import make_env, refuse_active_human
from .errors import reports_errors
from .evaluate import SAMPLED
from .evaluation.evaluator import Evaluator
from .evaluation.score import EvaluationResult
from .learning.rollout import FORCE_KEY
from .ppo import OnLog, train
from .runs.progress import for_terminal
from .runs.result import summary

FILM_SPEED = 4.0  # times real time
LEAST_TRAINING = 60.0  # s, however late it is


@dataclass(frozen=True)
class DemoConfig:
    """Flags of ``agym-jax demo``."""

    env_name: str = "ScratchItchJaco-v0"
    """Environment id."""
    policy: str | None = None
    """Policy file; by default, the policy shipped with agym_jax."""
    out: Path = Path("demo")
    """Folder for the video, the pictures and the learning curve."""
    humans: Count = 64
    """Number of people helped in parallel."""
    num_env_steps: Count = 1_000_000
    """Number of environment steps to train for."""
    seconds: float = 230.0
    """Maximum training time [s]."""
    budget: float = 280.0
    """Target duration of the whole demonstration [s]; training is shortened if the other parts are slow."""
    film_seconds: float = 25.0
    """Maximum time for rendering the video [s]; determines its number of frames."""
    seed: int = 1
    """Seed of the people and the training."""

    def __post_init__(self) -> None:
        """Reject invalid settings before anything is built."""
        for name in ("humans", "num_env_steps"):
            checked_count(f"--{name.replace('_', '-')}", getattr(self, name))


class Recorder:
    """Records what is needed to render every environment at every step."""

    def __init__(self) -> None:
        self._states: list[tuple[Any, Any]] = []

    def __call__(self, state: Any) -> None:
        """Record the state of all environments."""
        self._states.append((drawable(state), jax.device_get((state.reward, state.metrics))))

    def frames(self, world: int) -> Iterator[Frame]:
        """Yield the first episode of one environment without its last step, after which the next episode has begun."""
        total = 0.0
        for step, (batch, measured) in enumerate(self._states[:-1]):
            reward, metrics = jax.tree.map(lambda leaf: leaf[world], measured)
            total += float(reward)
            force = float(metrics.get(FORCE_KEY, 0.0)) if step else 0.0
            success = bool(metrics.get("success", 0.0) > 0.5) if step else False
            yield Frame(drawn_of(batch, world), step, total, force, success, False)


def make_film(env: Any, frames: Sequence[Frame], out: Path, seconds: float) -> tuple[Path, Path]:
    """Render one episode, with as many frames as the time allows.

    Args:
        env: environment of the episode.
        frames: all frames of the episode.
        out: output folder.
        seconds: time for rendering.

    Returns:
        Paths of the video and the contact sheet.
    """
    from agym_jax.rendering.clips import contact_sheet, write_clip
    from agym_jax.rendering.render import Renderer

    model, data = env.to_mujoco(frames[0].state)
    with Renderer(model, 480, 360) as renderer:
        backend = renderer.backend
    size = (480, 360) if backend == "gl" else (320, 240)
    with Renderer(model, *size, backend=backend) as renderer:
        renderer.render(data, env.markers(frames[0].state))  # the first is slower
        start = time.perf_counter()
        renderer.render(data, env.markers(frames[0].state))
        stride = math.ceil(len(frames) * (time.perf_counter() - start) / seconds)
        chosen, pictures = frames[:: max(2, stride)], []
        for frame in chosen:
            env.write_mujoco(frame.state, data, model)
            pictures.append(renderer.render(data, env.markers(frame.state)))
    film = write_clip(pictures, out / "helping.gif", FILM_SPEED / (env.dt * max(2, stride)))
    labels = [caption(frame) for frame in chosen]
    return film, contact_sheet(pictures, out / "helping.png", columns=4, labels=labels)


def typical(result: EvaluationResult) -> int:
    """Return the environment with the median return."""
    return int(np.argsort(result.returns)[len(result.returns) // 2])


def until(deadline: float) -> OnLog:
    """Return a callback that stops training at a given time of ``time.perf_counter``."""
    return lambda row, policy: time.perf_counter() > deadline


def run(config: DemoConfig, make: Callable[[str, str], Any] = make_env) -> None:
    """Run both parts of the demonstration.

    Raises:
        PolicyNotFoundError: if no policy is shipped for this environment.
        SaveFolderError: if the folder cannot be written to.
    """
    began = time.perf_counter()

    def say(text: str) -> None:
        print(f"[{time.perf_counter() - began:4.0f} s] {text}", flush=True)

    check_writable(config.out, "Choose another with --out.")
    env = make(config.env_name, "native")  # first: it knows which ids there are
    path = find_policy(plain_id(config.env_name), None, config.policy)
    refuse_active_human(env, False)
    policy = load_policies(PolicyFiles(str(path), None), env)
    say(f"The trained policy helps {config.humans} people that it has not seen in training.")
    recorder = Recorder()
    key = jax.random.PRNGKey(config.seed + 1000)
    evaluator = Evaluator(env, config.humans, at_once=config.humans)
    result = evaluator(policy, key, watch=recorder)
    random = evaluator(baseline_policy("random", env.action_size), key)
    print(result.table())
    print(f"  random actions: return {random.returns.mean():.2f}, success {random.success:.1%}")
    world = typical(result)
    say(f"Rendering the episode with the median return ({result.returns[world]:.1f}).")
    film, sheet = make_film(env, list(recorder.frames(world)), config.out, config.film_seconds)

    left = config.budget - (time.perf_counter() - began)
    seconds = min(config.seconds, max(LEAST_TRAINING, left))
    say(f"Training a policy from scratch: {config.num_env_steps:,} steps, {seconds:.0f} s at most.")
    settings = config_for(env.name, platform="cpu")
    changes = {
        "num_env_steps": config.num_env_steps,
        "save_dir": str(config.out),
        "seed": config.seed,
        "log_interval": 4,
        "fresh": True,
    }
    deadline = time.perf_counter() + seconds
    trained = train(
        env, dataclasses.replace(settings, **changes), for_terminal(), on_log=until(deadline)
    )
    print(summary(trained))
    # not by the mode, as evaluate does without --non-det: after so few steps, noise does a part of the task
    result = evaluator(trained.policy, jax.random.PRNGKey(config.seed + 2000), deterministic=False)
    say(f"The newly trained policy helps {config.humans} other people.")
    print(result.table())
    print(SAMPLED)
    print(f"Film:           {film}\nPictures:       {sheet}")
    if trained.folder:
        print(f"Learning curve: {trained.folder / 'curve.png'}")
    say("Done.")


@reports_errors
def main(
    arguments: Sequence[str] | None = None,
    make: Callable[[str, str], Any] = make_env,
    prog: str = f"python -m {__package__}.demo",
) -> int:
    """Run the command line and return the exit status."""
    description = first_paragraph(__doc__)
    config = tyro.cli(DemoConfig, prog=prog, args=command_words(arguments), description=description)
    jax.config.update("jax_platforms", "cpu")
    run(config, make)
    return 0


if __name__ == "__main__":
    sys.exit(main())
