"""How far a suite is, and how long it may still take."""

from __future__ import annotations

import json
import math
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from agym_jax.flags import parse_count

from ..configs import config_for
from ..runs.overview import CANDIDATES, read_rows, selection_of
from ..runs.progress import duration
from .plan import SuiteConfig, steps_for

TRAINING = 0.9  # share of training in the work on an environment; the rest is measuring


@dataclass
class Whole:
    """How far all environments together are.

    Attributes:
        config: flags.
        ids: environments.
        first: share that was done when this session began.
        start: when that was.
    """

    config: SuiteConfig
    ids: Sequence[str]

    def __post_init__(self) -> None:
        """Look at what is there."""
        self._known: dict[str, float] = {}
        self.start, self.first = time.perf_counter(), self.share()

    def of(self, env_name: str) -> float:
        """Share of an environment's training and measuring that is done."""
        run = Path(self.config.save_dir) / env_name
        if self._known.get(env_name) == 1.0 or selection_of(run):
            return 1.0
        for folder in (run, run / CANDIDATES):
            if rows := read_rows(folder / "curve.jsonl"):
                total = json.loads((folder / "config.json").read_text())["config"]["num_env_steps"]
                whole = TRAINING if self.config.num_seeds > 1 else 1.0  # one seed is not measured
                return whole * min(1.0, rows[-1]["env_steps"] / total)
        return 0.0

    def share(self) -> float:
        """Share of the whole that is done, where every environment counts by the steps it needs."""
        weights = {name: self._steps(name) for name in self.ids}
        self._known = {name: self.of(name) for name in self.ids}
        done = math.fsum(weights[name] * self._known[name] for name in self.ids)
        return done / math.fsum(weights.values())

    def _steps(self, env_name: str) -> float:
        steps = steps_for(self.config, env_name)
        return float(parse_count(steps) if steps else config_for(env_name).num_env_steps)

    def words(self) -> str:
        """A line about the whole: what is done, what runs, and how long it may still take."""
        now = self.share()
        gone, gained = time.perf_counter() - self.start, now - self.first
        left = f", about {duration(gone * (1 - now) / gained)} left" if gained > 1e-3 else ""
        going = [f"{name} {x:.0%}" for name, x in self._known.items() if 0 < x < 1]
        finished = sum(x == 1 for x in self._known.values())
        return (
            f"    {now:4.0%} of the whole, {finished} of {len(self.ids)} finished after {duration(gone)}{left}"
            + (f"   ({', '.join(going)})" if going else "")
        )
