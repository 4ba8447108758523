"""What choosing among candidates is worth, from trainings without them: ``python -m benchmarks.best_of RUN ... [--json FILE]``.

RUNs are folders of trainings with several seeds and no candidates, ``<save-dir>/<environment>``. Of all sets of ``--candidates`` of their seeds, the
one that is best after a share of the steps is taken, by the rule of ``train.runs.candidates`` (successes, then return) or by its return
alone. Its success at the end, the mean over all sets, is what ``--num-candidates`` would have given on average. Success is that of
the training, with noise, in the newest part (``train.runs.candidates.NEWEST``) of a curve.
"""

from __future__ import annotations

import itertools
import json
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import tyro

from agym_jax.errors import AgymError, checked_count
from train.errors import reports_errors
from train.runs.candidates import score
from train.runs.curve import Row
from train.runs.overview import read_rows
from train.runs.record import append_record

SHARES = (0.2, 0.3, 0.4, 0.5, 0.6)
"""Of the steps, after which one is chosen."""
RULES: dict[str, Callable[[Sequence[Row], int], Any]] = {
    "success": score,
    "return": lambda curve, total_steps: score(curve, total_steps)[1],
}


class BestOfError(AgymError, ValueError):
    """A folder that is no training with enough seeds."""


@dataclass(frozen=True)
class BestOfConfig:
    """Flags of ``python -m benchmarks.best_of``."""

    runs: Annotated[tuple[Path, ...], tyro.conf.Positional, tyro.conf.arg(metavar="RUN ...")]
    """Folders of runs."""
    candidates: int = 4
    """How many seeds are candidates of one."""
    json: Path | None = None
    """File to which a line for each run is added."""


def read_curves(run: Path) -> list[list[Row]]:
    """The curves of the seeds of a run that were not stopped early."""
    curves = [read_rows(path) for path in sorted(run.glob("seed_*/curve.jsonl"))]
    length = max(map(len, curves), default=0)
    return [curve for curve in curves if len(curve) == length]


def best_of(curves: Sequence[Sequence[Row]], candidates: int) -> dict[str, list[float]]:
    """Success at the end of the one of several seeds that is best after a share of the steps.

    Args:
        curves: of all seeds, with as many rows each.
        candidates: how many are chosen among.

    Returns:
        ``ends`` of all seeds, and for each of ``RULES`` the mean over all sets of candidates after each of ``SHARES``.
    """
    total_steps = curves[0][-1]["env_steps"]
    ends = [score(curve, total_steps)[0] for curve in curves]
    sets = list(itertools.combinations(range(len(curves)), candidates))
    found = {"ends": ends}
    for name, rule in RULES.items():
        found[f"by_{name}"] = []
        for share in SHARES:
            rows = max(1, int(share * len(curves[0])))
            ranks = [rule(curve[:rows], total_steps) for curve in curves]
            chosen = (max(of, key=ranks.__getitem__) for of in sets)
            found[f"by_{name}"].append(float(np.mean([ends[i] for i in chosen])))
    return found


def measure(run: Path, candidates: int) -> dict[str, Any]:
    """The result line of one run.

    Raises:
        BestOfError: it has no curves of so many seeds.
    """
    curves, settings = read_curves(run), run / "config.json"
    if len(curves) < candidates or not curves[0] or not settings.is_file():
        raise BestOfError(
            f"{run} has curves of {len(curves)} seeds that were trained to the end; expected a run with config.json and at least "
            f"{candidates} of them."
        )
    about = json.loads(settings.read_text())
    trained = {name: about[name] for name in ("commit", "device", "versions", "time")}
    config = about["config"]
    if config.get("num_candidates", 1) > 1:
        raise BestOfError(f"{run} was trained with candidates; expected a run without.")
    return {
        "kind": "best-of", "env": run.name, "candidates": candidates, "num_seeds": len(curves), "num_env_steps": curves[0][-1]["env_steps"],
        "memory": config.get("memory"), "shares": SHARES, **best_of(curves, candidates), **trained,
    }  # fmt: skip


@reports_errors
def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; returns the exit status."""
    config = tyro.cli(BestOfConfig, prog="python -m benchmarks.best_of", args=arguments)
    checked_count("--candidates", config.candidates)
    lines = [measure(run, config.candidates) for run in config.runs]
    print(
        f"success of all seeds, and of the best of {config.candidates} after {SHARES} of the steps"
    )
    for line in lines:
        told = "; ".join(f"by {x} {_percent(line[f'by_{x}'])}" for x in RULES)
        print(f"{line['env']:<28} {np.mean(line['ends']):4.0%}   {told}")
        if config.json:
            append_record(config.json, line)
    return 0


def _percent(shares: Sequence[float]) -> str:
    return " ".join(f"{share:4.0%}" for share in shares)


if __name__ == "__main__":
    sys.exit(main())
