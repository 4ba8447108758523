"""Evaluate every shipped policy again, several at a time, beside the figures that the results hold.

    python -m benchmarks.shipped --parallel 8 --num-episodes 1000 --json shipped.jsonl
    python -m benchmarks.shipped --impl native --num-episodes 5 --only ScratchItchJaco FeedingPR2Human

Each evaluation is a process of its own; its line can be added to ``results/evaluation.jsonl``, that of a pair to
``results/crossplay.jsonl``. A figure agrees where the two 95 % intervals of success overlap. With
``--flags="--humans.sizes continuous"``, or other flags of ``agym-jax evaluate``, nothing is compared.
"""

from __future__ import annotations

import shlex
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import tyro

from agym_jax.flags import Count
from agym_jax.policy.policy import shipped
from benchmarks.markdown import Line, read_results
from train.suites.plan import named


@dataclass(frozen=True)
class ShippedConfig:
    """Flags of ``python -m benchmarks.shipped``."""

    only: Annotated[tuple[str, ...], tyro.conf.arg(metavar="NAME ...")] = ()
    """Parts of ids, such as Jaco or ScratchItchPR2-v0; without them, all that ship."""
    num_episodes: Count = 1000
    """Episodes of each policy."""
    parallel: Count = 1
    """Evaluations at the same time."""
    impl: str = "auto"
    """Physics: "jax", "warp", "native" or "auto"."""
    seed: int | None = None
    """Seed of the episodes; without it, that of the recorded evaluation."""
    flags: str = ""
    """Further flags of ``agym-jax evaluate``."""
    json: Path | None = None
    """File to which each result is added as a JSON line."""


def recorded() -> dict[str, Line]:
    """The newest recorded evaluation of each shipped policy, robots alone and pairs."""
    alone = read_results("evaluation", ("env", "policy"))
    pairs = read_results("crossplay", ("env", "human_policy"))
    lines = {x["env"]: x for x in pairs if x["human_policy"] is not None}
    return lines | {x["env"]: x for x in alone if x["policy"] == "mode"}


def evaluate(env_name: str, seed: int, config: ShippedConfig, folder: Path) -> dict[str, Any] | str:
    """The result line of one policy, or why there is none."""
    import json

    file = folder / f"{env_name}.jsonl"
    command = [
        sys.executable, "-m", "train.evaluate", "--env-name", env_name, "--seed", str(seed),
        "--num-episodes", str(config.num_episodes), "--impl", config.impl, "--json", str(file),
        *shlex.split(config.flags),
    ]  # fmt: skip
    done = subprocess.run(command, capture_output=True, text=True)
    if done.returncode != 0:
        return done.stderr[-500:]
    return as_recorded(json.loads(file.read_text()))


def as_recorded(line: Line) -> Line:
    """An evaluation as the files of results have it: names instead of paths, and of a pair as ``crossplay`` tells it."""
    if "human_policy" not in line:
        return line | {"policy": "mode"}
    pair = {"kind": "crossplay", "robot_policy": "robot", "human_policy": "person"}
    return line | {"policy": "mode"} | pair


def run(
    config: ShippedConfig, before: dict[str, Line]
) -> Iterator[tuple[str, dict[str, Any] | str]]:
    """Ids and what came of them, in order."""
    ids = named(config.only, shipped(), "shipped policy")

    def seed_of(name: str) -> int:
        recorded_seed = before.get(name, {}).get("seed", 1001)
        return recorded_seed if config.seed is None else config.seed

    with tempfile.TemporaryDirectory() as folder, ThreadPoolExecutor(config.parallel) as pool:
        results = pool.map(lambda name: evaluate(name, seed_of(name), config, Path(folder)), ids)
        yield from zip(ids, results, strict=True)


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; returns the exit status."""
    from train.runs.record import append_record

    config = tyro.cli(ShippedConfig, prog="python -m benchmarks.shipped", args=arguments)
    before, failed, apart = {} if config.flags else recorded(), 0, 0
    for name, line in run(config, before):
        if isinstance(line, str):
            failed += 1
            print(f"{name:<28} failed: {line}", flush=True)
            continue
        if config.json:
            append_record(config.json, line)
        known = before.get(name)
        text = f"{name:<28} {line['success']:6.1%}  return {line['return_mean']:8.1f}"
        if known:
            agrees = (
                line["success_low"] <= known["success_high"]
                and known["success_low"] <= line["success_high"]
            )
            apart += not agrees
            text += f"   recorded {known['success']:6.1%}  {known['return_mean']:8.1f}"
            text += "" if agrees else "   DIFFERS"
        print(text, flush=True)
    print(f"{failed} failed, {apart} differ from what is recorded")
    return 1 if failed or apart else 0


if __name__ == "__main__":
    sys.exit(main())
