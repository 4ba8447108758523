"""What gentleness costs: policies that learned under several cost limits, over the same people.

    agym-jax sweep --env-name FeedingJaco-v0 --grid cost_limit=0.1,0.5,5,1e6 --num-seeds 4
    python -m benchmarks.limits sweeps/FeedingJaco-v0 --json benchmarks/results/limits.jsonl    # a line for each limit
    python -m benchmarks.limits                                                                 # draws docs/images/limits.png

The second command measures the mode of every seed. A limit of ``NONE`` or more is none.
"""

from __future__ import annotations

import hashlib
import io
import json
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from operator import itemgetter
from pathlib import Path
from typing import Annotated, Any

import jax
import numpy as np
import tyro
from PIL import Image

from agym_jax.data.npz import write_file
from agym_jax.errors import AgymError
from agym_jax.flags import Count
from benchmarks.markdown import RESULTS, Line, mark, read_results
from train.envs import make_env
from train.evaluation.evaluator import Evaluator
from train.evaluation.seed_scores import score_seeds
from train.evaluation.statistics import iqm
from train.runs.record import append_record, record
from train.select import load_seeds

OUTPUT = RESULTS.parent.parent / "docs" / "images" / "limits.png"
SHOWN = "shows"
"""Key of the checksum in the picture."""
NONE = 1e6
FOLDER = "cost_limit="
SUCCESS, GENTLE = "#0072b2", "#d55e00"  # of Okabe and Ito: told apart by all eyes


class SweepFolderError(AgymError, ValueError):
    """A folder that no sweep of cost limits has written."""


@dataclass(frozen=True)
class LimitsConfig:
    """Flags of ``python -m benchmarks.limits``."""

    sweep: Annotated[Path | None, tyro.conf.Positional, tyro.conf.arg(metavar="SWEEP")] = None
    """Folder of a sweep, SAVE_DIR/ID; without it, the picture is drawn."""
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
    sweep = Path(config.sweep or "").resolve()
    folders = {float(x.name.removeprefix(FOLDER)): x for x in sweep.glob(f"{FOLDER}*")}
    if not folders:
        raise SweepFolderError(
            f"{sweep} has no folder {FOLDER}...: agym-jax sweep --grid cost_limit=0.1,0.5,5,1e6 makes them."
        )
    trained = json.loads((sweep / "config.json").read_text())["config"]
    evaluator: Any = None
    lines = []
    for limit, folder in sorted(folders.items()):
        # its own name is that of the setting
        env, policies = load_seeds(folder, lambda _, *a, **k: make_env(sweep.name, *a, **k), config.impl)  # fmt: skip
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


def lines_of(folder: Path = RESULTS) -> list[Line]:
    """The newest line of each limit of each environment, with a ``mark`` as in tables."""
    lines = read_results("limits", ("env", "cost_limit"), folder)
    sign = mark(lines)
    return sorted((x | {"mark": sign(x)} for x in lines), key=itemgetter("env", "cost_limit"))


def in_words(limit: float) -> str:
    """A limit, or that there is none."""
    return "none" if limit >= NONE else f"{limit:g}"


def draw(path: Path, lines: Sequence[Line], about: dict[str, str]) -> None:
    """Success and gentle success against the limit, a panel for each environment.

    Lines: interquartile means of the seeds; points: seeds.

    Args:
        path: PNG file to write.
        lines: from ``lines_of``.
        about: text to keep in the file, key -> value.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    names = list(dict.fromkeys(x["env"] for x in lines))
    figure = Figure(figsize=(0.5 + 3.6 * len(names), 3.2), layout="constrained")
    FigureCanvasAgg(figure)
    for panel, name in zip(figure.subplots(1, len(names), squeeze=False, sharey=True)[0], names, strict=True):  # fmt: skip
        shown = [x for x in lines if x["env"] == name][::-1]  # the strictest to the right
        places = np.arange(len(shown))
        for key, label, colour in (
            ("success_of_seeds", "success", SUCCESS),
            ("gentle_success_of_seeds", "gentle success", GENTLE),
        ):
            seeds = [100 * np.asarray(x[key]) for x in shown]
            panel.plot(places, [iqm(x) for x in seeds], color=colour, label=label)
            for place, values in zip(places, seeds, strict=True):
                panel.plot(np.full(len(values), place), values, ".", color=colour, alpha=0.5)
        panel.set_xticks(places, [in_words(x["cost_limit"]) for x in shown])
        panel.set(ylim=(-3, 103), xlabel="cost limit")
        panel.set_title(f"{name.removesuffix('-v0')}{shown[0]['mark']}", fontsize=10)
        panel.grid(alpha=0.3)
        if name == names[0]:
            panel.set_ylabel("share of episodes [%]")
            figure.legend(fontsize=8, loc="outside lower center", ncols=2)
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=120, metadata=about)
    write_file(path, buffer.getvalue())


def main(
    arguments: Sequence[str] | None = None, folder: Path = RESULTS, output: Path = OUTPUT
) -> int:
    """The command line; returns the exit status, 1 if ``--check`` finds the picture out of date."""
    arguments = list(sys.argv[1:] if arguments is None else arguments)
    checks = "--check" in arguments
    config = tyro.cli(LimitsConfig, prog="python -m benchmarks.limits", args=[x for x in arguments if x != "--check"])  # fmt: skip
    if config.sweep:
        try:
            measured = measure(config)
        except AgymError as error:
            print(f"{type(error).__name__}: {error}", file=sys.stderr)
            return 2
        for line in measured if config.json else []:
            append_record(str(config.json), line)
        return 0
    lines = lines_of(folder)
    if not lines and not output.is_file():
        return 0
    checksum = hashlib.sha256(json.dumps(lines, sort_keys=True).encode()).hexdigest()
    if output.is_file():
        with Image.open(output) as picture:
            if picture.info.get(SHOWN) == checksum:
                return 0
    if checks:
        print(f"{output.name} is out of date: python -m benchmarks.limits", file=sys.stderr)
        return 1
    draw(output, lines, {SHOWN: checksum})
    print(output)
    return 0


if __name__ == "__main__":
    sys.exit(main())
