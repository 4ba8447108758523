"""The picture of every task-robot pair at the start of an episode: ``python -m benchmarks.gallery``.

Draws one row a task and one column a robot into ``docs/images/all_pairs.jpg``: what a user sees after
``reset``, each pair with another person.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

import jax
import numpy as np
from PIL import Image, ImageDraw

import agym_jax
from agym_jax.rendering.render import Renderer
from agym_jax.robots import ROBOTS
from agym_jax.tasks import TASKS

OUTPUT = Path(__file__).resolve().parent.parent / "docs" / "images" / "all_pairs.jpg"
WIDTH, HEIGHT = 400, 300


def draw(env_name: str, seed: int) -> np.ndarray:
    """One environment after its reset: image (HEIGHT, WIDTH, 3), uint8.

    Args:
        env_name: environment id.
        seed: of the person and the start.
    """
    env = agym_jax.make(env_name, impl="native")
    state = env.reset(jax.random.PRNGKey(seed))
    model, data = env.to_mujoco(state)
    with Renderer(model, 2 * WIDTH, 2 * HEIGHT) as renderer:
        large = Image.fromarray(renderer.render(data, env.markers(state)))
    return np.asarray(large.resize((WIDTH, HEIGHT), Image.Resampling.LANCZOS))


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line: an output file, if not the one in ``docs``."""
    arguments = sys.argv[1:] if arguments is None else list(arguments)
    output = Path(arguments[0]) if arguments else OUTPUT
    sheet = Image.new("RGB", (len(ROBOTS) * WIDTH, len(TASKS) * HEIGHT))
    for i, task in enumerate(TASKS):
        for j, robot in enumerate(ROBOTS):
            name, seed = f"{task}{robot}-v0", i * len(ROBOTS) + j
            picture = Image.fromarray(draw(name, seed))
            ImageDraw.Draw(picture).text((8, 6), name, fill=(20, 20, 20))
            sheet.paste(picture, (j * WIDTH, i * HEIGHT))
            print(f"\r{seed + 1}/{len(TASKS) * len(ROBOTS)}", end="", flush=True)
    sheet.save(output, quality=84)
    print(f"\r{output}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
