"""Film strips of episodes in which shipped policies fail: ``python -m benchmarks.failures [ID ...]``.

For each policy, the first episodes that fail, of those with the seeds from ``SEED`` on, on C MuJoCo. Writes
``docs/images/failures/ID.jpg``, and the list of them into ``docs/care.md``. Without ids: the policies of robots alone that fail.
"""

from __future__ import annotations

import itertools
import re
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import jax
import numpy as np
from PIL import Image

from agym_jax.memory import Memory
from agym_jax.policy.files import find_policies, load_policies
from agym_jax.policy.policy import shipped
from agym_jax.registry import static_id
from agym_jax.rendering.clips import contact_sheet
from agym_jax.spec import Measured
from benchmarks.ids import asked_ids
from benchmarks.markdown import read_results
from train.enjoy import LOOK_THROUGH, EnjoyConfig, Frame, Player, film
from train.envs import make_env
from train.errors import reports_errors
from train.evaluation.outcome import in_words
from train.evaluation.people import describe

DOCS = Path(__file__).resolve().parent.parent / "docs"
FAILURES = DOCS / "images" / "failures"
PAGE = DOCS / "care.md"
SEED = 2001
EPISODES = 2
MOMENTS = 6
SIZE = (300, 225)
OFTEN = 0.98
"""Success rate from which on failures are not looked for."""


def strip(env_name: str, folder: Path | None = None, memory: Memory = ()) -> bool:
    """Draw the strip of one policy; False if no episode fails among those that are looked through.

    Args:
        env_name: environment id.
        folder: of the picture; by default that of policies without a memory.
        memory: of the policy.
    """
    env = make_env(env_name, "native", memory=memory)
    policy = load_policies(find_policies(env_name, memory=memory), env, False)
    config = EnjoyConfig(env_name=env_name, width=2 * SIZE[0], height=2 * SIZE[1])
    pictures: list[Any] = []
    labels: list[str] = []
    found = Player(env, policy).episodes(SEED, "failure")
    for seed, frames in itertools.islice(found, EPISODES):
        frames = list(frames)
        shown = [frames[i] for i in np.linspace(0, len(frames) - 1, MOMENTS).round().astype(int)]
        for picture in film(env, shown, config):
            small = Image.fromarray(picture).resize(SIZE, Image.Resampling.LANCZOS)
            pictures.append(np.asarray(small))
        who = f"seed {seed}: {describe(frames[0].state.episode.human)}"
        labels += [who, *(moment(env, frame) for frame in shown[1:])]
    if not pictures:
        return False
    path = (folder or FAILURES) / f"{env_name}.png"
    contact_sheet(pictures, path, columns=MOMENTS, labels=labels)
    with Image.open(path) as image:
        image.convert("RGB").save(path.with_suffix(".jpg"), quality=75)
    path.unlink()
    return True


def moment(env: Any, frame: Frame) -> str:
    """When a frame is, and what the task has come to."""
    words = [f"{frame.step * env.dt:.0f} s"]
    if isinstance(env.task, Measured):
        values = env.task.measure(frame.state.task)
        words += [in_words(x, float(values[x.name])) for x in env.task.measures]
    return ", ".join(words)


def gallery() -> str:
    """The strips, in Markdown."""
    names = sorted(path.stem for path in FAILURES.glob("*.jpg"))
    return "\n\n".join(
        f"**{name}**\n\n![{name} fails](images/failures/{name}.jpg)" for name in names
    )


def fill(page: str) -> str:
    """The page with the present strips."""
    begin, end = "<!-- failures -->", "<!-- /failures -->"
    return re.sub(f"(?s){begin}.*{end}", lambda _: f"{begin}\n{gallery()}\n{end}", page)


def failing() -> list[str]:
    """Robots' policies that fail now and then."""
    lines = read_results("evaluation", ("env", "policy"))
    rates = {x["env"]: x["success"] for x in lines if x["policy"] == "mode"}
    alone = [name for name in shipped() if name == static_id(name)]
    return [name for name in alone if rates.get(name, 0.0) < OFTEN]


@reports_errors
def main(arguments: Sequence[str] | None = None) -> int:
    """The command line: environment ids, if not all whose policies fail now and then."""
    jax.config.update("jax_platforms", "cpu")
    names = asked_ids(arguments, shipped()) or failing()
    FAILURES.mkdir(parents=True, exist_ok=True)
    for i, name in enumerate(names, 1):
        print(f"{i}/{len(names)} {name}", flush=True)
        if not strip(name):
            print(f"{name} does not fail with the seeds {SEED} to {SEED + LOOK_THROUGH - 1}")
    PAGE.write_text(fill(PAGE.read_text()))
    print(PAGE)
    return 0


if __name__ == "__main__":
    sys.exit(main())
