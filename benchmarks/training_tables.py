"""Tables of ``benchmarks.tables`` about training: its cost, beside Brax's, and what interruptions change."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from operator import itemgetter
from pathlib import Path

import numpy as np

from agym_jax.registry import parse
from agym_jax.tasks import TASKS
from benchmarks.markdown import (
    EARLIER,
    NOTHING,
    RESULTS,
    Line,
    grid,
    is_earlier,
    read_results,
    several,
    table,
)
from benchmarks.speed_tables import BATCH


def _sharing(line: Line) -> str:
    """How many runs shared the GPU, where the result says so."""
    count = line.get("sharing", "").partition(" ")[0]
    return "1" if count == "alone" else count


def training(folder: Path = RESULTS) -> str:
    """What training costs."""
    columns = {
        **BATCH,
        "steps": lambda x: f"{x['steps']:,}",
        "start": lambda x: x["start"],
        "total wall time": lambda x: f"{x['wall_s']:.0f} s",
        "runs on the GPU": _sharing,
        "success at the end": lambda x: f"{x['success']:.0%}",
        "NaN": lambda x: x.get("nan", ""),
    }
    lines = read_results("training", ("env", "impl", "start"), folder)
    return table(lines, columns, itemgetter("env", "impl", "seed"))


TRAINERS = {"brax": "Brax PPO", "same": "`train.ppo`, same settings", "shipped": "`train.ppo`"}


def brax_ppo(folder: Path = RESULTS) -> str:
    """Brax's PPO and ``train.ppo``: success over steps and over time."""

    def at(share: float) -> Callable[[Line], str]:
        def cell(x: Line) -> str:
            wanted, curve = share * x["steps"], x["curve"]
            near = min(
                range(len(curve["success"])), key=lambda i: abs(curve["env_steps"][i] - wanted)
            )
            return f"{curve['success'][near]:.0%}"

        return cell

    def enough(x: Line) -> str:
        reached = x["steps_to_90"] is not None
        return (
            f"{x['steps_to_90'] / 1e6:.1f} M, {x['seconds_to_90']:.0f} s"
            if reached
            else "not reached"
        )

    columns = {
        "environment": lambda x: x["env"],
        "trainer": lambda x: TRAINERS[x["trainer"]],
        "steps": lambda x: f"{x['steps'] / 1e6:.1f} M",
        **{f"success at {share:.0%}": at(share) for share in (0.25, 0.5, 0.75, 1.0)},
        "90 % after": enough,
        "steps/s": lambda x: f"{x['steps_per_s']:,}",
        "compile time": lambda x: f"{x['compile_s']:.0f} s",
        "NaN": lambda x: x["nan"],
    }
    lines = read_results("brax_ppo", ("env", "trainer"), folder)
    order = list(TRAINERS)
    note = "Deterministic policy (mode), {} episodes each; training time without compilation and evaluation;"
    note = note.format(several(x["episodes"] for x in lines)) if lines else ""
    return table(lines, columns, lambda x: (x["env"], order.index(x["trainer"])), note)


def resume(folder: Path = RESULTS) -> str:
    """What killing a run changes."""

    def ends(found: Iterable[Line]) -> str:
        return "; ".join(f"{x['return']:.1f}, {x['success']:.0%}" for x in found)

    columns = {
        "environment": lambda x: x["env"],
        "steps": lambda x: f"{x['steps']:,}",
        "killed at step": lambda x: f"{x['killed_at']:,}",
        "resumed from step": lambda x: f"{x['resumed_from']:,}",
        "return, success at the checkpoint": lambda x: ends([x["before"]]),
        "at the end": lambda x: ends([x["broken"]]),
        "uninterrupted runs, seeds 1, 2, ...": lambda x: ends(x["unbroken"]),
    }
    return table(read_results("resume", ("env",), folder), columns, itemgetter("env"))


def kills(folder: Path = RESULTS) -> str:
    """What runs lose that are killed again and again."""

    def counts(found: Mapping[str, int]) -> str:
        return ", ".join(f"{name} {count}" for name, count in sorted(found.items()))

    columns = {
        "environment": lambda x: x["env"],
        "kills": lambda x: x["kills"],
        "by": lambda x: counts(x["signals"]),
        "while": lambda x: counts(x["phases"]),
        "runs of steps": lambda x: f"{x['runs']} of {x['steps']:,}",
        "steps between checkpoints": lambda x: x["interval"],
        "most steps to train again: killed": lambda x: x["lost_most"],
        "interrupted": lambda x: x["lost_most_interrupted"],
        "runs that end otherwise": lambda x: x["differing_runs"],
    }
    return table(read_results("kills", ("env",), folder), columns, itemgetter("env"))


def best_of(folder: Path = RESULTS) -> str:
    """What choosing among candidates is worth, by task."""
    lines = read_results("best_of", ("env", "time"), folder, changed=True)
    if not lines:
        return NOTHING
    rows = []
    for task in (*TASKS, "all"):
        of = [x for x in lines if task in ("all", parse(x["env"]).task.name)]
        success, returned = (
            np.mean([x[f"by_{rule}"] for x in of], 0) for rule in ("success", "return")
        )
        chosen = (f"{a:.0%} ({b:.0%})" for a, b in zip(success, returned, strict=True))
        rows.append([task, len(of), f"{np.mean([np.mean(x['ends']) for x in of]):.0%}", *chosen])
    shares = lines[0]["shares"]
    heads = ("task", "trainings", "all seeds", *(f"the best after {share:.0%}" for share in shares))
    sizes = several(f"{x['candidates']} of {x['num_seeds']} seeds" for x in lines)
    note = (
        f"Sets of {sizes}, by success (by return alone); success while training, with noise; {EARLIER} {sum(map(is_earlier, lines))} of "
        f"the {len(lines)} trainings;"
    )
    return grid([heads, *rows], lines, note)
