"""The page and its loop: what the user asks for, steps at the speed that was asked for, frames."""

from __future__ import annotations

import time
from collections.abc import Callable
from queue import Empty, SimpleQueue
from typing import Any

import numpy as np

from agym_jax.viewer.moments import Moment
from agym_jax.viewer.panels import Panels
from agym_jax.viewer.picture import Picture
from agym_jax.viewer.stage import Stage

FRAME = 1 / 25  # time between frames [s]
SLOWLY = 0.25  # between updates of text, sliders and curves [s]
PAUSE = 1.5  # after an episode [s]
PANEL = 0.2  # by which everything is further left, because of the panel, as a share of the height


class Page:
    """What one browser page, or several, show and control.

    Args:
        stage: whose first episode has begun.
        picture: on the page's server.

    Attributes:
        fps: frames in the last second of play [1/s].
    """

    def __init__(self, stage: Stage, picture: Picture):
        self.server, self.stage, self.picture = picture.server, stage, picture
        self.playing, self.fps = True, 0.0
        self._calls: SimpleQueue[Callable[[], None]] = SimpleQueue()
        self._speed = 1.0
        self._frames: list[float] = []
        self._slow = 0.0
        self.panels = Panels(self)
        self._begun()
        picture.aim("all" if stage.count > 1 else "front", PANEL)

    # -- what the user asks for -------------------------------------------------------------------

    def ask(self, call: Callable[[], None]) -> None:
        """Have the loop do something; from any thread."""
        self._calls.put(call)

    def toggle(self) -> None:
        """Play or pause."""
        self.playing = not self.playing
        if self.playing and self.stage.over:
            self.next()
        self._step_due = time.monotonic()
        self.panels.show_playing(self.playing)
        self._draw(1.0)
        self._slowly(force=True)

    def single_step(self) -> None:
        """Pause, and do one control step."""
        self.playing = False
        self.panels.show_playing(False)
        if self.stage.over:
            self.next()
            return
        self._advance()
        self._draw(1.0)
        self._slowly(force=True)

    def again(self) -> None:
        """Begin the same episode anew."""
        self._begin(self.stage.seed)

    def next(self) -> None:
        """Begin the episodes of the next people."""
        self._begin(self.stage.seed + self.stage.count)

    def set_speed(self, speed: float) -> None:
        """Play faster or slower; 1 is real time."""
        self._speed, self._step_due = speed, time.monotonic()

    def look(self, client: Any, name: str) -> None:
        """Move the camera of one browser."""
        if client is None:
            return
        eye, target = self.picture.view(name, PANEL)
        with client.atomic():
            client.camera.position, client.camera.look_at = eye, target
            client.camera.up_direction = (0.0, 0.0, 1.0)

    def draw_forces(self) -> None:
        """Draw the forces of contacts, or hide them."""
        self.picture.forces(self.stage.forces.forces if self.panels.arrows.value else None)

    # -- episodes ---------------------------------------------------------------------------------

    def _begin(self, seed: int) -> None:
        self.stage.begin(seed)
        self._begun()

    def _begun(self) -> None:
        drawn, self._now = self.stage.drawn, self.stage.moment()
        self._before: Moment = self._now
        self.picture.show(self.stage.places(), self._now, drawn.marks, drawn.surfaces)
        self.panels.joints.begin()
        self.panels.person.show(self.stage.state(0).episode.human)
        self._step_due, self._over_since = time.monotonic(), None
        self._slowly(force=True)

    def _advance(self) -> None:
        self.stage.step()
        self._before, self._now = self._now, self.stage.moment()

    # -- the loop ---------------------------------------------------------------------------------

    def run(self, until: Callable[[], bool] = lambda: False) -> None:
        """Play until ``until`` holds."""
        while not until():
            start = time.monotonic()
            self._answer()
            if self.playing:
                self._play(start)
            self._slowly()
            left = FRAME - (time.monotonic() - start)
            if left > 0.0 and not (self.playing and np.isinf(self._speed)):
                time.sleep(left)

    def _answer(self) -> None:
        while True:
            try:
                call = self._calls.get_nowait()
            except Empty:
                return
            call()

    def _play(self, now: float) -> None:
        """One frame; steps are taken when they are due, and shown between the last two."""
        if self.stage.over:
            self._after_the_end(now)
            return
        period = self.stage.env.dt / self._speed
        if now >= self._step_due:
            self._advance()
            self._step_due = max(self._step_due + period, now - period)
        share = 1.0 if period == 0.0 else 1.0 - (self._step_due - now) / period
        self._draw(float(np.clip(share, 0.0, 1.0)))
        self._frames = [t for t in self._frames if now - t < 1.0] + [now]
        self.fps = len(self._frames)

    def _after_the_end(self, now: float) -> None:
        if self._over_since is None:
            self._over_since = now
            self._draw(1.0)
        elif now - self._over_since > PAUSE:
            if self.panels.onward.value:
                self.next()
            else:
                self.toggle()

    def _draw(self, share: float) -> None:
        self.picture.move(self._before.towards(self._now, share))
        self.draw_forces()

    def _slowly(self, force: bool = False) -> None:
        """What need not be shown at once."""
        now = time.monotonic()
        if not force and (now - self._slow < SLOWLY or not self.playing):
            return
        self._slow = now
        rate = f"\n\n{self.fps:.0f} frames/s" if self.playing else "\n\npaused"
        self.panels.status.content = self.stage.status() + rate
        self.panels.joints.follow()
        self.panels.plots.show(self.stage.history)
