"""One setting of a sweep as a run of its own, which ``benchmarks.collect`` takes.

    agym-jax sweep --env-name DressingPR2-v0 --grid noise_floor=0,0.35 --num-seeds 4
    agym-jax select sweeps/DressingPR2-v0/noise_floor=0.35
    python -m benchmarks.setting_as_run sweeps/DressingPR2-v0/noise_floor=0.35 runs
    python -m benchmarks.collect runs

Its curve is that of its own seeds. The time of training is that of the whole sweep, in which all settings share the device.
"""

from __future__ import annotations

import json
import shutil
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from agym_jax.errors import AgymError
from train.errors import reports_errors
from train.runs.curve import combine_rows
from train.runs.overview import read_rows
from train.select import seed_folders
from train.sweep import setting_of


class SettingError(AgymError, ValueError):
    """A folder that is no setting of a sweep."""


@dataclass(frozen=True)
class SettingConfig:
    """Flags of ``python -m benchmarks.setting_as_run``."""

    setting: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="SWEEP/SETTING")]
    """Folder of a setting, SAVE_DIR/ID/NAME=VALUE."""
    folder: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="RUNS")]
    """Folder in which the run is made, FOLDER/ID."""


def setting_as_run(setting: Path, folder: Path) -> Path:
    """Copy a setting of a sweep, and return the folder of the run.

    Raises:
        SettingError: it is no setting of a sweep, or the run exists.
        PolicyNotFoundError: it has no policies of seeds.
    """
    path = setting.parent / "config.json"
    if "=" not in setting.name or not path.is_file():
        raise SettingError(
            f"{setting} is no setting of a sweep: expected a folder such as sweeps/DressingPR2-v0/noise_floor=0.35, "
            f"and config.json beside it."
        )
    run = folder / setting.parent.name
    if run.exists():
        raise SettingError(f"{run} exists. Choose another folder.")
    seeds = seed_folders(setting)
    about = json.loads(path.read_text())
    about["config"] |= {"num_seeds": len(seeds), "seed": min(seeds), "save_dir": str(folder)}
    for name, value in setting_of(setting.name).items():
        switch = isinstance(about["config"].get(name), bool)
        about["config"][name] = bool(value) if switch else value
    curves = [read_rows(seed / "curve.jsonl") for seed in seeds.values()]
    by_step: dict[int, list[dict[str, object]]] = {}  # a seed that diverged has fewer rows
    for row in (row for curve in curves for row in curve):
        by_step.setdefault(row["env_steps"], []).append(row)
    shutil.copytree(setting, run)
    (run / "config.json").write_text(json.dumps(about, indent=2) + "\n")
    rows = [combine_rows(rows) for _, rows in sorted(by_step.items())]
    (run / "curve.jsonl").write_text("".join(json.dumps(row) + "\n" for row in rows))
    return run


@reports_errors
def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; returns the exit status."""
    config = tyro.cli(SettingConfig, prog="python -m benchmarks.setting_as_run", args=arguments)
    print(setting_as_run(config.setting, config.folder))
    return 0


if __name__ == "__main__":
    sys.exit(main())
