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
from train.sweep import Setting, setting_of

LIMIT = "cost_limit"


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


def limits_of(sweep: Path) -> tuple[dict[float, Path], Setting]:
    """The folder of each cost limit of a sweep, and the other hyperparameters of its grid, which all limits share.

    Raises:
        SweepFolderError: the folder has no limits, or other hyperparameters vary too.
    """
    folders, others = {}, []
    for folder in sorted(sweep.glob(f"*{LIMIT}=*")):
        setting = setting_of(folder.name)
        folders[setting.pop(LIMIT)] = folder
        others.append(setting)
    if not folders:
        raise SweepFolderError(
            f"{sweep} has no folder {LIMIT}=...: agym-jax sweep --grid cost_limit=0.1,0.5,5,1e6 makes them."
        )
    if varied := {x for other in others for x in other.items() ^ others[0].items()}:
        raise SweepFolderError(
            f"{sweep} varies more than {LIMIT}: {', '.join(f'{name}={value:g}' for name, value in sorted(varied))}. "
            "Limits are compared with everything else alike."
        )
    return folders, others[0]


def measure(config: LimitsConfig) -> list[Line]:
    """A line for each limit of a sweep, the lowest first.

    Raises:
        SweepFolderError: see ``limits_of``.
        AgymError: see ``load_seeds``.
    """
    sweep = config.sweep.resolve()
    folders, others = limits_of(sweep)
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
                setting=others,
                started_from=trained.get("robot_policy"),
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
