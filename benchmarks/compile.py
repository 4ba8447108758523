"""How long it takes until training begins, cold and warm.

    python -m benchmarks.compile --env-name ScratchItchJaco-v0 --json benchmarks/results/compile.jsonl

"Cold" is a fresh process with empty caches, of XLA's programs and of Warp's kernels; "warm" is a
fresh process with what the cold one left in them.
"""

from __future__ import annotations

import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import tyro

from agym_jax.errors import AgymError
from benchmarks.child import run_child
from train.runs.record import append_record, record

STARTS = ("cold", "warm")
TRAINING = """
import dataclasses, json, sys, time
import agym_jax
from train import ppo
from train.configs import config_for
began, name, impl = float(sys.argv[1]), sys.argv[2], sys.argv[3]
env = agym_jax.make(name, impl=impl)
run = ppo.train(env, dataclasses.replace(config_for(name), num_env_steps=1, num_candidates=1, save_dir=None))
print(json.dumps({
    "impl": env.impl, "num_envs": run.config.num_envs, "compile_s": run.compile_seconds,
    "until_training_s": time.time() - began - run.train_seconds,
}))
"""


@dataclass(frozen=True)
class CompileConfig:
    """Flags of ``python -m benchmarks.compile``."""

    env_name: str = "ScratchItchJaco-v0"
    """Environment id."""
    impl: str = "auto"
    """Physics: "jax", "warp", "auto"."""
    json: Path | None = None
    """File to which the results are added as JSON lines."""


def measure(env_name: str, impl: str) -> Iterator[dict[str, Any]]:
    """The fields of two results, cold and then warm.

    ``compile_s`` is what tracing and compiling took, ``until_training_s`` all from the start of
    the process on: Python, imports, the environment and its kernels too.

    Args:
        env_name: environment id.
        impl: physics.

    Raises:
        ChildError: a process failed.
    """
    with tempfile.TemporaryDirectory() as caches:
        for start in STARTS:
            found = run_child(
                TRAINING,
                repr(time.time()),
                env_name,
                impl,
                AGYM_JAX_CACHE=f"{caches}/xla",
                WARP_CACHE_PATH=f"{caches}/warp",
            )
            yield {"env": env_name, "start": start, **found}


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; returns the exit status."""
    config = tyro.cli(CompileConfig, prog="python -m benchmarks.compile", args=arguments)
    try:
        for fields in measure(config.env_name, config.impl):
            print("  ".join(f"{name} {value}" for name, value in fields.items()), flush=True)
            if config.json:
                append_record(config.json, record("compile", **fields))
    except AgymError as error:
        print(f"{type(error).__name__}: {error}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
