"""What gentleness costs: policies that learned under several cost limits, over the same people.

    agym-jax sweep --env-name FeedingJaco-v0 --grid cost_limit=0.1,0.5,5,1e6 --num-seeds 4
    python -m benchmarks.limits sweeps/FeedingJaco-v0 --json benchmarks/results/limits.jsonl

Writes a line for each limit, of the mode of every seed.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import jax
import tyro

from agym_jax.errors import AgymError
from agym_jax.flags import Count
from benchmarks.markdown import Line
from train.envs import make_env
from train.evaluation.evaluator import Evaluator
from train.evaluation.seed_scores import score_seeds
from train.runs.record import append_record, record
from train.select import load_seeds

FOLDER = "cost_limit="


class SweepFolderError(AgymError, ValueError):
    """A folder that no sweep of cost limits has written."""


@dataclass(frozen=True)
class LimitsConfig:
    """Flags of ``python -m benchmarks.limits``."""

    sweep: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="SWEEP")]
    """Folder of a sweep, SAVE_DIR/ID."""
    num_episodes: Count = 300
    """Episodes of each policy."""
    seed: int = 3001
    """Seed of the episodes."""
    impl: str = "auto"
    """Physics: "jax", "warp", "native" or "auto"."""
    json: Path | None = None
    """File to which the results are added as JSON lines."""


def measure(config: LimitsConfig) -> list[Line]:
    """A line for each limit of a sweep, the lowest first.

    Raises:
        SweepFolderError: the folder has none.
        AgymError: see ``load_seeds``.
    """
    sweep = config.sweep.resolve()
    folders = {float(x.name.removeprefix(FOLDER)): x for x in sweep.glob(f"{FOLDER}*")}
    if not folders:
        raise SweepFolderError(
            f"{sweep} has no folder {FOLDER}...: agym-jax sweep --grid cost_limit=0.1,0.5,5,1e6 makes them."
        )
    trained = json.loads((sweep / "config.json").read_text())["config"]
    evaluator: Any = None
    lines = []
    for limit, folder in sorted(folders.items()):
        env, policies = load_seeds(folder, make_env, config.impl)
        evaluator = evaluator or Evaluator(env, config.num_episodes)
        scores = score_seeds(evaluator, policies, jax.random.PRNGKey(config.seed))
        peaks = [x.summary().get("peak_median") for x in scores.results.values()]
        lines.append(
            record(
                "limit",
                **scores.summary(),
                cost_limit=limit,
                peak_median_of_seeds=peaks,
                impl=str(getattr(env, "impl", config.impl)),
                num_env_steps=trained["num_env_steps"],
                num_envs=trained["num_envs"],
            )
        )
        print(f"limit {limit:g}\n{scores.table()}", flush=True)
    return lines


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; returns the exit status."""
    config = tyro.cli(LimitsConfig, prog="python -m benchmarks.limits", args=arguments)
    try:
        lines = measure(config)
    except AgymError as error:
        print(f"{type(error).__name__}: {error}", file=sys.stderr)
        return 2
    for line in lines if config.json else []:
        append_record(str(config.json), line)
    return 0


if __name__ == "__main__":
    sys.exit(main())
