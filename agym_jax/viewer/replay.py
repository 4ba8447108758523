"""An episode as one page that opens without a server: the picture of every step, and viser's player."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from agym_jax.viewer.people import described
from agym_jax.viewer.picture import Picture
from agym_jax.viewer.stage import History, Stage

CAPTION = """<div style="position:fixed;left:14px;top:10px;font:14px sans-serif;color:#333;pointer-events:none">{}</div>"""
BETWEEN = 2
"""Frames of a control step; gowns and many people are large, and have one."""
END = 1.0  # how long the last frame stays [s]


def write_replay(
    stage: Stage,
    picture: Picture,
    steps: int | None,
    file: Path,
) -> int:
    """Play an episode that has begun and write it; returns the size of the file in bytes.

    Args:
        stage: with the environments.
        picture: that is recorded.
        steps: how many; None for all.
        file: to write.
    """
    now, drawn = stage.moment(), stage.drawn
    picture.show(stage.places(), now, drawn.marks, drawn.surfaces)
    picture.aim("all" if stage.count > 1 else "front")
    record = picture.server.get_scene_serializer()
    frames = 1 if drawn.surfaces or stage.count > 1 else BETWEEN
    for _ in range(steps or stage.env.episode_length):
        stage.step()
        before, now = now, stage.moment()
        for i in range(frames):
            picture.move(before.towards(now, (i + 1) / frames))
            record.insert_sleep(stage.env.dt / frames)
        picture.forces(stage.forces.forces)
        if stage.over:
            break
    record.insert_sleep(END)
    page = record.as_html().replace("</body>", f"{caption(stage)}</body>", 1)
    page = re.sub("<title>.*?</title>", f"<title>{stage.env.name}</title>", page, count=1)
    file.write_text(page, encoding="utf-8")
    return len(page.encode())


def caption(stage: Stage) -> str:
    """What is seen and how it ended, as HTML."""
    if stage.count == 1:
        who, end = described(stage.state(0).episode.human), ending(stage.history)
    else:
        won = int((np.asarray(stage.states.metrics["success"]) > 0.5).sum())
        who = f"{stage.count} people"
        end = f"{won} of {stage.count} succeed by the end ({stage.history.times[-1]:.1f} s)"
    return CAPTION.format(f"<b>{stage.env.name}</b>, seed {stage.seed}<br>{who}; {end}")


def ending(history: History) -> str:
    """Whether the episode of a single environment ended in success, and from when on success held until the end."""
    failing = np.flatnonzero(np.array(history.metrics["success"]) <= 0.5)
    first = int(failing[-1]) + 1 if failing.size else 0
    if first == len(history.times):
        return f"no success in {history.times[-1]:.1f} s"
    return f"success from {history.times[first]:.1f} s on"
