"""What bounds training on a GPU: where the time of an update goes, from a trace of JAX's profiler.

python -m benchmarks.training_profile --env-name ReachingJaco-v0 --num-seeds 8

Needs an NVIDIA GPU. Kernels of MuJoCo Warp and of food, water and cloth are known by their names, the others by the
scope of their operation; a kernel for which there is none counts as most of those that were launched together with it,
or as "other". Tracing slows the update down, so that the GPU idles more than it does otherwise.
"""

from __future__ import annotations

import os
import re
import shutil
import statistics
import sys
import tempfile
from collections import Counter, defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import tyro

from agym_jax.errors import ImplementationError
from agym_jax.flags import Count
from benchmarks.keep import keep

PARTS = ("rigid bodies", "matter", "rest of the step", "acting", "learning", "other")
"""Of the time of an update; what remains is "idle", in which the GPU waits for its next kernel."""
WARP = "cuda_kernel_forward"  # is in the names of Warp's kernels
FFI = "/ffi_call"  # ends the scopes of what Warp has done by others
MATTER = ("cloth", "particles")  # are in the names of our own kernels
ENOUGH = 0.1
"""Share of a group's time from which what is known speaks for the rest."""
AFTER = 6
"""Updates before the one that is traced; the first does not count."""
LARGEST = 15
"""Kernels that the result names."""
INSTRUCTION = re.compile(r"%?([\w.\-]+) = .*?op_name=\"([^\"]*)\"")


@dataclass(frozen=True)
class TrainingProfileConfig:
    """Flags of ``python -m benchmarks.training_profile``."""

    env_name: str = "ReachingJaco-v0"
    """Environment id."""
    num_envs: Count = 1024
    """Environments of each seed."""
    num_seeds: Count = 8
    """Seeds that learn side by side."""
    impl: str = "auto"
    """Physics: "jax", "warp", "auto"."""
    json: Path | None = None
    """File to which the result is added as a JSON line."""


@dataclass(frozen=True)
class Kernel:
    """One run of a kernel on the GPU."""

    name: str
    start: float  # [ns]
    duration: float  # [ns]
    scope: str = ""  # of its operation, if the trace knows it
    group: str = ""  # of kernels that were launched together


class Tracing:
    """Progress that traces one update of a training (see ``train.runs.progress.Progress``)."""

    def __init__(self, folder: Path) -> None:
        self._folder, self._rows = folder, 0

    def start(self, done: int, total: int) -> None:
        """Nothing."""

    def say(self, text: str) -> None:
        """Print a message."""
        print(text, file=sys.stderr, flush=True)

    def update(self, row: Mapping[str, Any]) -> None:
        """Begin the trace after some updates, and end it after one more."""
        import jax

        self.say(f"{row['env_steps']:,} steps  {row['steps_per_second']:,.0f} steps/s")
        self._rows += 1
        if self._rows == AFTER:
            jax.profiler.start_trace(self._folder)
        elif self._rows == AFTER + 1:
            jax.profiler.stop_trace()

    def stop(self) -> None:
        """Nothing."""


def scopes(text: str) -> dict[str, str]:
    """Names of a compiled program's instructions, after which its kernels are called -> scopes of their operations."""
    return {re.sub(r"[.\-]", "_", name): scope for name, scope in INSTRUCTION.findall(text)}


def part_of(kernel: Kernel, scope_of: Mapping[str, str]) -> str | None:
    """The part of an update that a kernel belongs to, one of ``PARTS``; None if neither name nor scope says."""
    from train.learning.rollout import ACT, ENV_STEP
    from train.learning.update import LEARN

    scope = kernel.scope or scope_of.get(re.sub(r"[.\-]", "_", kernel.name), "")
    if WARP in kernel.name or scope.endswith(FFI):
        return "rigid bodies"
    if any(name in kernel.name for name in MATTER):
        return "matter"
    within = scope.split("/")
    named = {LEARN: "learning", ACT: "acting", ENV_STEP: "rest of the step"}
    return next((part for name, part in named.items() if name in within), None)


def parts_of(kernels: Sequence[Kernel], scope_of: Mapping[str, str]) -> list[str]:
    """The part of each kernel.

    One that does not say counts as most of its group does, by time, if ``ENOUGH`` of the group's time is known; else as "other".
    """
    known = [part_of(kernel, scope_of) for kernel in kernels]
    spent: dict[str, Counter[str | None]] = defaultdict(Counter)
    for kernel, part in zip(kernels, known, strict=True):
        spent[kernel.group][part] += round(kernel.duration)
    most = {}
    for group, times in spent.items():
        total, _ = times.total(), times.pop(None, 0)
        if group and times.total() > ENOUGH * total:
            most[group] = times.most_common(1)[0][0]
    return [
        part or most.get(kernel.group) or "other"
        for kernel, part in zip(kernels, known, strict=True)
    ]


def busy(kernels: Sequence[Kernel]) -> float:
    """Time in which at least one kernel runs [ns]."""
    total, until = 0.0, float("-inf")
    for kernel in sorted(kernels, key=lambda k: k.start):
        end = kernel.start + kernel.duration
        total += max(0.0, end - max(until, kernel.start))
        until = max(until, end)
    return total


def summary(kernels: Sequence[Kernel], scope_of: Mapping[str, str]) -> dict[str, Any]:
    """Shares of the traced time by part, and the kernels that take most of it.

    Args:
        kernels: of the trace; the time from the beginning of the first to the end of the last is 1.
        scope_of: see ``scopes``.

    Returns:
        ``seconds``; ``kernels``, how many ran; ``share/*`` of ``PARTS`` and "idle", which add up to 1 (where kernels overlap,
        their parts share the time in proportion); ``largest``: [name, part, share, runs].
    """
    window = max(k.start + k.duration for k in kernels) - min(k.start for k in kernels)
    covered = busy(kernels)
    scale = covered / sum(k.duration for k in kernels) / window
    shares = dict.fromkeys(PARTS, 0.0)
    spent: dict[tuple[str, str], float] = defaultdict(float)
    runs: Counter[tuple[str, str]] = Counter()
    for kernel, part in zip(kernels, parts_of(kernels, scope_of), strict=True):
        shares[part] += kernel.duration * scale
        spent[kernel.name, part] += kernel.duration * scale
        runs[kernel.name, part] += 1
    largest = sorted(spent, key=lambda x: -spent[x])[:LARGEST]
    return {
        "seconds": round(window / 1e9, 4),
        "kernels": len(kernels),
        **{f"share/{name}": round(share, 4) for name, share in shares.items()},
        "share/idle": round(1 - covered / window, 4),
        "largest": [[x[0][:80], x[1], round(spent[x], 4), runs[x]] for x in largest],
    }


def read_kernels(folder: Path) -> list[Kernel]:
    """All that ran on the streams of GPUs, from a trace of ``jax.profiler``."""
    from jax.profiler import ProfileData

    (path,) = folder.rglob("*.xplane.pb")
    lines = [
        line
        for plane in ProfileData.from_file(str(path)).planes
        if plane.name.startswith("/device:GPU")
        for line in plane.lines
        if line.name.startswith("Stream")
    ]
    kernels = []
    for event in (event for line in lines for event in line.events):
        about = dict(event.stats)
        scope, group = (str(about.get(name, "")) for name in ("name", "hlo_op"))
        kernels.append(Kernel(event.name, event.start_ns, event.duration_ns, scope, group))
    return kernels


def measure(config: TrainingProfileConfig) -> dict[str, Any]:
    """Train for a few updates; returns the fields of the result line.

    Raises:
        AgymError: there is no such environment, or no GPU.
    """
    missing = ImplementationError(
        "benchmarks.training_profile needs an NVIDIA GPU, and JAX for it."
    )
    if not shutil.which("nvidia-smi"):
        raise missing
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        # texts of the compiled programs say which operation a kernel belongs to; a cached program has none
        flags = f"--xla_dump_to={folder / 'hlo'} --xla_dump_hlo_as_text"
        os.environ["XLA_FLAGS"] = f"{os.environ.get('XLA_FLAGS', '')} {flags}"
        import jax

        from train import ppo
        from train.configs import PPOConfig, config_for
        from train.envs import make_env
        from train.task_changes import NO_SEARCH

        if jax.default_backend() != "gpu":
            raise missing
        jax.config.update("jax_enable_compilation_cache", False)
        env = make_env(config.env_name, config.impl)
        settings = config_for(env.name, PPOConfig, "gpu")
        per_call = config.num_envs * settings.num_steps
        settings = replace(
            settings, num_envs=config.num_envs, num_seeds=config.num_seeds, log_interval=1, save_dir=None,
            num_env_steps=(AFTER + 2) * per_call, **NO_SEARCH,
        )  # fmt: skip
        result = ppo.train(env, settings, Tracing(folder / "trace"))
        programs = folder.rglob("*after_optimizations.txt")
        training = max(programs, key=lambda file: file.stat().st_size)
        fields = summary(read_kernels(folder / "trace"), scopes(training.read_text()))
    speeds = [row["steps_per_second"] for row in result.curve[1:AFTER]]
    return {
        "env": env.name,
        "impl": env.impl,
        "num_envs": config.num_envs,
        "num_seeds": config.num_seeds,
        "steps": per_call * config.num_seeds,
        "steps_per_s": round(statistics.median(speeds)),  # before the trace
        **fields,
    }


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; returns the exit status."""
    config = tyro.cli(
        TrainingProfileConfig, prog="python -m benchmarks.training_profile", args=arguments
    )
    return 2 if keep("training-profile", lambda: measure(config), config.json) is None else 0


if __name__ == "__main__":
    sys.exit(main())
