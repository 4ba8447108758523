"""A film of every shipped policy, and a sheet a task: ``python -m benchmarks.clips [ID ...]``.

Plays the episode of one seed with each policy's mode, on C MuJoCo, and draws ``docs/images/clips/ID.webp`` and
``docs/images/clips/TASK.jpg``, which ``docs/clips.md`` shows. Nothing is picked: what fails at that seed is shown
failing.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

import jax
import numpy as np
from PIL import Image, ImageDraw

from agym_jax.errors import did_you_mean
from agym_jax.policy.files import find_policies, load_policies
from agym_jax.registry import active_id
from agym_jax.robots import ROBOTS
from agym_jax.tasks import TASKS
from train.enjoy import EnjoyConfig, Frame, Player, film
from train.envs import make_env

DOCS = Path(__file__).resolve().parent.parent / "docs"
CLIPS = DOCS / "images" / "clips"
POLICIES = DOCS.parent / "assets" / "policies"
SEED = 1001
EVERY = 4  # steps from picture to picture
LAST = 12  # pictures that show the end
SIZE = (320, 240)
MOMENTS = (0, 15, 30, 60, 100, 200)  # steps that a sheet shows


def play(env_name: str) -> tuple[list[Frame], list[np.ndarray]]:
    """The episode of ``SEED``: every ``EVERY``-th frame and its picture (height, width, 3), uint8."""
    env = make_env(env_name, "native")
    policy = load_policies(find_policies(env_name, None, None, None), env, False)
    frames = list(Player(env, policy, deterministic=True).episode(SEED))[::EVERY]
    config = EnjoyConfig(env_name=env_name, width=2 * SIZE[0], height=2 * SIZE[1])
    return frames, film(env, frames, config)


def draw(env_name: str) -> None:
    """The film of one environment."""
    frames, pictures = play(env_name)
    small = [Image.fromarray(x).resize(SIZE, Image.Resampling.LANCZOS) for x in pictures]
    for frame, picture in zip(frames, small, strict=True):
        done = "  success" if frame.success else ""
        ImageDraw.Draw(picture).text((6, 4), f"{frame.step / 10:.1f} s{done}", fill=(20, 20, 20))
    film_of = [*small, *[small[-1]] * LAST]
    film_of[0].save(
        CLIPS / f"{env_name}.webp", save_all=True, append_images=film_of[1:], duration=100, loop=0,
        quality=45, method=5,
    )  # fmt: skip


def films(task: str) -> list[str]:
    """The environments of a task of which there is a film."""
    still = [f"{task}{robot}-v0" for robot in ROBOTS]
    return [
        name for name in (*still, *map(active_id, still)) if (CLIPS / f"{name}.webp").exists()
    ]


def sheet(task: str) -> None:
    """One picture of a task: a few moments of each of its films."""
    names, (width, height) = films(task), SIZE
    whole = Image.new("RGB", (len(MOMENTS) * width, len(names) * height))
    for row, name in enumerate(names):
        with Image.open(CLIPS / f"{name}.webp") as film_of:
            for column, step in enumerate(MOMENTS):
                film_of.seek(step // EVERY)
                whole.paste(film_of.convert("RGB"), (column * width, row * height))
        ImageDraw.Draw(whole).text((6, (row + 1) * height - 16), name, fill=(20, 20, 20))
    if names:
        whole.save(CLIPS / f"{task}.jpg", quality=72)


def page() -> str:
    """``docs/clips.md``: a table of films for each task."""
    lines = [
        "# Every policy that ships, at work",
        "",
        f"Drawn by `python -m benchmarks.clips`: the episode of seed {SEED} with each policy's mode, at four times",
        "the speed of life. Nothing is picked: what fails there is shown failing. How often they succeed is in",
        "[benchmarks](benchmarks.md). In the ids with `Human` the person acts by a policy of its own.",
    ]
    for task in TASKS:
        shown = films(task)
        if not shown:
            continue
        lines += ["", f"## {task}"]
        for row in (shown[i : i + len(ROBOTS)] for i in range(0, len(shown), len(ROBOTS))):
            lines += ["", "| " + " | ".join(row) + " |", "|---" * len(row) + "|"]
            lines += ["| " + " | ".join(f"![{x}](images/clips/{x}.webp)" for x in row) + " |"]
        lines += ["", f"![{task}](images/clips/{task}.jpg)"]
    return "\n".join(lines) + "\n"


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line: environment ids, if not all that have a policy."""
    jax.config.update("jax_platforms", "cpu")
    there = sorted(path.stem for path in POLICIES.glob("*-v0.npz"))
    names = (sys.argv[1:] if arguments is None else list(arguments)) or there
    unknown = next((name for name in names if name not in there), None)
    if unknown:
        print(f"No policy ships for {unknown!r}. {did_you_mean(unknown, there)}", file=sys.stderr)
        return 2
    CLIPS.mkdir(parents=True, exist_ok=True)
    for i, name in enumerate(names):
        print(f"\r{i + 1}/{len(names)} {name:<24}", end="", flush=True)
        draw(name)
    for task in TASKS:
        sheet(task)
    (DOCS / "clips.md").write_text(page())
    print(f"\r{DOCS / 'clips.md'}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
