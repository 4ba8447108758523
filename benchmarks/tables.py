"""Result tables, generated from ``benchmarks/results``: ``python -m benchmarks.tables [--check]``.

Each table in ``PAGES`` is between ``<!-- table:NAME -->`` and ``<!-- /table:NAME -->``. If a configuration was measured
several times, the last line of the file is used. Results with lost contacts are left out.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from operator import itemgetter
from pathlib import Path

from benchmarks import care_tables, cpu_tables, policy_tables
from benchmarks.markdown import (
    RESULTS,
    Line,
    matrix,
    read_results,
    several,
    table,
)

ROOT = Path(__file__).resolve().parent.parent
PAGES = (
    ROOT / "README.md",
    *(ROOT / "docs" / f"{name}.md" for name in ("benchmarks", "seeds", "care", "torch", "viewer")),
)


BATCH: dict[str, Callable[[Line], str]] = {
    "environment": lambda x: x["env"],
    "physics": lambda x: x["impl"],
    "parallel envs": lambda x: f"{x['num_envs']:,}",
}
"""Columns that say what was stepped."""


class TableError(ValueError):
    """A table that a page names and nobody makes, or a broken marker."""


def throughput(folder: Path = RESULTS) -> str:
    """Steps per second of the whole environment."""
    columns = {
        **BATCH,
        "control steps/s, median (range)": lambda x: (
            f"**{x['steps_per_s']:,}** ({x['steps_per_s_min']:,} to {x['steps_per_s_max']:,})"
        ),
        "start-up": lambda x: (
            ""
            if x.get("compiled_beside_others")
            else f"{x['compile_seconds'] + x['first_call_seconds']:.0f} s"
        ),
        "NaN": lambda x: x["nan"],
    }
    lines = read_results("throughput", ("env", "impl", "num_envs"), folder)
    by = itemgetter("env", "impl", "num_envs")
    return table(lines, columns, by, "Random actions, resets included;")


def compilation(folder: Path = RESULTS) -> str:
    """How long it takes until training begins."""
    columns = {
        "environment": lambda x: x["env"],
        "device": lambda x: x["device"]["kind"],
        "physics": lambda x: x["impl"],
        "parallel envs": lambda x: f"{x['num_envs']:,}",
        "start": lambda x: x["start"],
        "compile time": lambda x: f"{x['compile_s']:.0f} s",
        "startup time": lambda x: f"{x['until_training_s']:.0f} s",
    }
    lines = read_results("compile", ("env", "impl", "start"), folder)
    return table(lines, columns, itemgetter("env", "impl", "start"))


def nan(folder: Path = RESULTS) -> str:
    """The search for NaN."""
    columns = {
        "environment": lambda x: x["env"],
        "physics": lambda x: x["impl"],
        "random steps": lambda x: f"{x['total_steps']:,}",
        "NaN": lambda x: x["nan"],
        "force on the person, 99.99th percentile": lambda x: f"{x['force/on_human/p99.99']:.1f} N",
        "maximum": lambda x: f"{x['force/on_human/max']:.1f} N",
    }
    lines = read_results("nan", ("env", "impl"), folder)
    return table(lines, columns, itemgetter("env", "impl"))


def training_speed(folder: Path = RESULTS) -> str:
    """What a second learner costs, and a second device brings."""
    keys = ("env", "impl", "learners", "devices", "num_envs")
    lines = read_results("training_speed", (*keys, "num_seeds"), folder)
    lines = [x for x in lines if x.get("num_seeds", 1) == 1]
    one = {(x["env"], x["impl"]): x for x in lines if x["learners"] == x["devices"] == 1}

    def relative(x: Line) -> str:
        first = one.get((x["env"], x["impl"]))
        return f"{x['steps_per_s'] / first['steps_per_s']:.2f}" if first else ""

    columns = {
        "environment": lambda x: x["env"],
        "physics": lambda x: x["impl"],
        "learners": lambda x: x["learners"],
        "devices": lambda x: x["devices"],
        "parallel envs": lambda x: f"{x['num_envs']:,}",
        "training steps/s, median (range)": lambda x: (
            f"**{x['steps_per_s']:,}** ({x['steps_per_s_min']:,} to {x['steps_per_s_max']:,})"
        ),
        "relative to one learner on one device": relative,
    }
    return table(lines, columns, itemgetter(*keys))


def seed_speed(folder: Path = RESULTS) -> str:
    """How fast several seeds learn side by side."""
    keys = ("env", "impl", "devices", "num_seeds", "num_envs")
    lines = [x for x in read_results("training_speed", keys, folder) if x.get("num_seeds", 1) > 1]
    columns = {
        "environment": lambda x: x["env"],
        "physics": lambda x: x["impl"],
        "seeds x parallel envs": lambda x: f"{x['num_seeds']} x {x['num_envs']:,}",
        "training steps/s of all together, median (range)": lambda x: (
            f"**{x['steps_per_s']:,}** ({x['steps_per_s_min']:,} to {x['steps_per_s_max']:,})"
        ),
    }
    return table(lines, columns, itemgetter(*keys))


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


def torch_overhead(folder: Path = RESULTS) -> str:
    """What PyTorch's tensors cost."""
    columns = {
        **BATCH,
        "control steps/s": lambda x: f"{x['steps_per_s']:,}",
        "with PyTorch's tensors": lambda x: f"{x['steps_per_s_torch']:,}",
        "overhead, median (range)": lambda x: (
            f"{x['overhead_percent']:.1f} % ({x['overhead_percent_min']:.1f} to {x['overhead_percent_max']:.1f})"
        ),
    }
    by = ("env", "impl", "num_envs")
    return table(read_results("torch_overhead", by, folder), columns, itemgetter(*by))


def viewer_speed(folder: Path = RESULTS) -> str:
    """How fluently the viewer plays."""
    columns = {
        "environment": lambda x: x["env"],
        "drawn by": lambda x: "Chromium, in software" if x["browser"] else "another machine",
        "frames/s": lambda x: f"{x['frames_per_s']:.1f}",
        "share of real time": lambda x: f"{100 * x['share_of_real_time']:.0f} %",
        "longest frame": lambda x: f"{x['longest_frame_s']:.2f} s",
    }
    by = lambda x: (x["env"], str(x["browser"]))  # noqa: E731
    return table(read_results("viewer_speed", ("env", "browser"), folder), columns, by)


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


def reach(folder: Path = RESULTS) -> str:
    """How many itches a robot can touch at all."""
    columns = {
        "environment": lambda x: x["env"],
        "reachable itches": lambda x: f"{x['reachable']:.0%}",
        "reachable itches on the quarter of the limb facing the trunk": lambda x: (
            f"{x['reachable_inner']:.0%}"
        ),
    }
    lines = read_results("reach", ("env",), folder)
    return table(lines, columns, itemgetter("env"))


def pulls(folder: Path = RESULTS) -> str:
    """What scripted pulls of the gown over a person's arm come to."""
    columns = {
        "edge length": lambda x: f"{1000 * x['edge_m']:.1f} mm",
        "vertices": lambda x: f"{x['vertices']:,}",
        "pulls": lambda x: f"{x['pulls']:,}",
        "limb penetrations": lambda x: f"{x['through']}",
        "pulled 0.4 m up the arm": lambda x: f"{x['beyond_0_4_m']:.1%}",
        "covers over 80 % of the arm": lambda x: f"{x['progress_above_0_8']:.1%}",
        "peak force, median (99th percentile)": lambda x: (
            f"{x['force_median_n']:.2f} N ({x['force_99_n']:.2f} N)"
        ),
        "hanging length": lambda x: f"{x['hang_m']:.3f} m",
    }
    lines = read_results("pulls", ("edge_m", "pulls"), folder)
    return table(lines, columns, lambda x: (-x["edge_m"], x["pulls"]))


def speed(folder: Path = RESULTS) -> str:
    """Steps per second on Warp in 4,096 environments, by task and robot."""
    lines = read_results("throughput", ("env", "impl", "num_envs"), folder)
    warp = [x for x in lines if x["impl"] == "warp" and x["num_envs"] == 4096]
    note = "Control steps per second with 4,096 parallel environments, MuJoCo Warp;"
    return matrix(warp, lambda x: f"{x['steps_per_s'] / 1000:,.0f} k", note)


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


def in_assistive_gym(folder: Path = RESULTS) -> str:
    """Success of policies in Assistive Gym itself, beside that here."""
    here = {x["env"]: x["success"] for x in read_results("evaluation", ("env",), folder)}

    def share(x: Line) -> float:
        return x["successes"] / x["episodes"]

    columns = {
        "environment": lambda x: x["env"],
        "success in Assistive Gym": lambda x: f"{x['successes']} of {x['episodes']}",
        "success here": lambda x: f"{here[x['env']]:.0%}",
        "share of it": lambda x: f"{share(x) / here[x['env']]:.0%}",
    }
    lines = read_results("in_assistive_gym", ("env",), folder)
    return table(
        lines, columns, lambda x: -share(x), "Commits are those that trained the policies;"
    )


TABLES: dict[str, Callable[..., str]] = {
    "success": policy_tables.success,
    "speed": speed,
    "training": training,
    "throughput": throughput,
    "compile": compilation,
    "chosen-among": policy_tables.chosen_among,
    "policies": policy_tables.policies,
    "selections": policy_tables.selections,
    "sweeps": policy_tables.sweeps,
    "gentle": policy_tables.gentle,
    "candidates": policy_tables.candidates,
    "together": policy_tables.together,
    "seeds": policy_tables.seeds,
    "training-speed": training_speed,
    "seed-speed": seed_speed,
    "brax-ppo": brax_ppo,
    "resume": resume,
    "kills": kills,
    "torch-overhead": torch_overhead,
    "viewer-speed": viewer_speed,
    "nan": nan,
    "reach": reach,
    "pulls": pulls,
    "cpu": cpu_tables.summary,
    "cpu-speed": cpu_tables.speed,
    "cpu-latency": cpu_tables.latency,
    "laptop": cpu_tables.laptop,
    "in-assistive-gym": in_assistive_gym,
    "everybody": care_tables.everybody,
    "care": care_tables.care,
}


def fill(text: str, folder: Path = RESULTS) -> str:
    """The text with every table made anew.

    Raises:
        TableError: a marker names an unknown table, or is not closed.
    """
    for name in re.findall(r"<!-- table:(\S+) -->", text):
        if name not in TABLES:
            raise TableError(f"Unknown table {name!r}; there are: {', '.join(TABLES)}.")
        begin, end = f"<!-- table:{name} -->", f"<!-- /table:{name} -->"
        before, _, rest = text.partition(begin)
        _, closed, after = rest.partition(end)
        if not closed:
            raise TableError(f"{begin} is not followed by {end}.")
        text = f"{before}{begin}\n{TABLES[name](folder)}\n{end}{after}"
    return text


def page(text: str, commits: bool = True) -> str:
    """A page with every table made anew.

    Args:
        text: of the page.
        commits: whether its tables name the commits with which they were measured.

    Raises:
        TableError: see ``fill``.
    """
    made = fill(text)
    return made if commits else re.sub(r"; commit [0-9a-f]{7,}(, [0-9a-f]{7,})*(?=[;.])", "", made)


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; returns the exit status, 1 if ``--check`` finds a page out of date."""
    arguments = sys.argv[1:] if arguments is None else list(arguments)
    stale = False
    for path in PAGES:
        text = path.read_text()
        wanted = page(text, commits=path.name != "README.md")  # those are in docs/benchmarks.md
        if text != wanted and "--check" in arguments:
            print(f"{path.name} is out of date: python -m benchmarks.tables", file=sys.stderr)
            stale = True
        elif text != wanted:
            path.write_text(wanted)
    if stale:
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
