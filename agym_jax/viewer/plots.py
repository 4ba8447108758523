"""Curves of an episode: the reward's terms, and forces on the person."""

from __future__ import annotations

from typing import Any

import numpy as np
import viser
from viser import uplot

from agym_jax.viewer.stage import History

COLOURS = (
    "#1c7ed6", "#e8590c", "#2f9e44", "#c2255c", "#7048e8", "#0c8599", "#f08c00", "#868e96", "#5c940d", "#a61e4d",
)  # fmt: skip
FORCES = {
    "force/on_human": "on the person [N]",
    "force/peak_on_human": "peak on one region [N]",
    "force/tool": "on the tool [N]",
}
HEIGHT = 190  # [pixels]


class Plots:
    """Live curves in the current folder or tab.

    Args:
        gui: of the page.
        terms: names of the reward's terms.
        seconds: length of an episode [s].
    """

    def __init__(self, gui: viser.GuiApi, terms: tuple[str, ...], seconds: float):
        rewards = {
            f"reward/{name}": name.removeprefix("preference_").replace("_", " ") for name in terms
        }
        self._seconds = seconds
        self._charts = [
            self._chart(gui, "Reward by term", {"": "sum", **rewards}),
            self._chart(gui, "Forces [N]", FORCES),
        ]

    def _chart(
        self, gui: viser.GuiApi, title: str, names: dict[str, str]
    ) -> tuple[tuple[str, ...], Any]:
        series: list[uplot.Series] = [{"label": "time [s]"}]
        for i, label in enumerate(names.values()):
            series.append({"label": label, "stroke": COLOURS[i % len(COLOURS)], "width": 1.5})
        none = np.zeros(1)
        handle = gui.add_uplot(
            data=tuple(none for _ in series), series=tuple(series), title=title, height=HEIGHT,
            scales={"x": {"time": False, "range": (0.0, self._seconds)}},
            legend={"show": True}, cursor={"drag": {"x": False, "y": False}},
        )  # fmt: skip
        return tuple(names), handle

    def show(self, history: History) -> None:
        """Draw an episode so far."""
        if not history.times:
            for names, handle in self._charts:
                handle.data = tuple(np.zeros(1) for _ in range(len(names) + 1))
            return
        times = np.array(history.times)
        for names, handle in self._charts:
            rows = (history.metrics[name] if name else history.rewards for name in names)
            handle.data = (times, *(np.array(row) for row in rows))
