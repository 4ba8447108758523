"""Tables of ``benchmarks.tables`` about speed: of environments, of training, of what begins them, of PyTorch and the viewer."""

from __future__ import annotations

from collections.abc import Callable
from operator import itemgetter
from pathlib import Path

from benchmarks.markdown import RESULTS, Line, matrix, percent, read_results, table
from benchmarks.training_profile import PARTS

BATCH: dict[str, Callable[[Line], str]] = {
    "environment": lambda x: x["env"],
    "physics": lambda x: x["impl"],
    "parallel envs": lambda x: f"{x['num_envs']:,}",
}
"""Columns that say what was stepped."""


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


def speed(folder: Path = RESULTS) -> str:
    """Steps per second on Warp in 4,096 environments, by task and robot."""
    lines = read_results("throughput", ("env", "impl", "num_envs"), folder)
    warp = [x for x in lines if x["impl"] == "warp" and x["num_envs"] == 4096]
    note = "Control steps per second with 4,096 parallel environments, MuJoCo Warp;"
    return matrix(warp, lambda x: f"{x['steps_per_s'] / 1000:,.0f} k", note)


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
        "gradients": lambda x: x.get("gradient_precision", "float32"),
        "training steps/s of all together, median (range)": lambda x: (
            f"**{x['steps_per_s']:,}** ({x['steps_per_s_min']:,} to {x['steps_per_s_max']:,})"
        ),
    }
    return table(lines, columns, itemgetter(*keys))


def profile(folder: Path = RESULTS) -> str:
    """Where the time of training goes."""

    def idle(x: Line) -> str:
        untraced = 1 - (1 - x["share/idle"]) * x["seconds"] * x["steps_per_s"] / x["steps"]
        return f"{x['share/idle']:.0%} ({max(untraced, 0.0):.0%})"

    columns = {
        "environment": lambda x: x["env"],
        "training steps/s": lambda x: f"{x['steps_per_s']:,}",
        **{part: percent(f"share/{part}") for part in PARTS},
        "idle (without the trace)": idle,
        "largest kernel": lambda x: (
            f"`{x['largest'][0][0].split('__locals')[0]}`, {x['largest'][0][2]:.0%}"
        ),
    }
    lines = read_results("training_profile", ("env", "impl", "num_envs", "num_seeds"), folder)
    return table(lines, columns, itemgetter("env"))


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
