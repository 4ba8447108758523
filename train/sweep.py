"""Compare settings with several seeds each, in one program: ``agym-jax sweep --env-name ID --grid lr=3e-4,1e-3``.

All settings and seeds are trained in parallel, as with ``--num-seeds``. This works for hyperparameters that are arguments
of the compiled update; others need separate runs. ``--grid`` tries all combinations, ``--random``
draws some of them. The table ranks the settings by the success of their seeds at the end of training; confirm the best
ones with new seeds before relying on the ranking.
"""

from __future__ import annotations

import dataclasses
import itertools
import json
import re
import signal
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Any

import jax
import numpy as np
import tyro

from agym_jax.data.npz import write_file
from agym_jax.errors import UnknownNameError, checked_count
from agym_jax.flags import Count, EnvFlags, parse_flags, plain

from .configs import LearnConfig, PPOConfig, config_for
from .entries import entries
from .envs import make_env, refuse_active_human
from .errors import ConfigError, check_save_dir, reports_errors
from .evaluation.statistics import bootstrap_interval, iqm
from .learning.agents import Agents
from .learning.seeds import Lane
from .runs.progress import Progress, for_terminal
from .runs.result import SeedResult, TrainResult, summary, unsaved
from .runs.session import on_terminate, resolve_config, run_session
from .task_changes import NO_SEARCH

SWEPT = (
    "lr", "use_linear_lr_decay", "gamma", "gae_lambda", "clip_param", "value_loss_coef", "entropy_coef",
    "entropy_decay_share", "max_grad_norm", "eps", "reward_scaling", "clip_value_loss", "recompute_advantages",
    "noise_floor", "noise_ceiling", "noise_ceiling_from", "value_warm_up",
    "cost_limit", "cost_multiplier_max", "cost_proportional", "cost_integral", "cost_derivative", "cost_margin", "cost_tighten_from", "cost_tighten_until",
)  # fmt: skip
"""Settings that are arguments of the compiled update. A sweep without ``cost_limit`` has no cost limit."""
Setting = dict[str, float]


@dataclass(frozen=True)
class SweepConfig(EnvFlags):
    """Flags of ``agym-jax sweep``."""

    env_name: str = "ReachingSawyer-v0"
    """Environment id."""
    grid: Annotated[tuple[str, ...], tyro.conf.arg(metavar="NAME=A,B,... ...")] = ()
    """Values to try for each hyperparameter."""
    random: Count = 0
    """Try this many random combinations of the grid's values instead of all of them."""
    num_seeds: Count = 4
    """Number of seeds per setting."""
    num_env_steps: Count = 0
    """Environment steps per seed; 0 = the environment's default."""
    num_envs: Count = 0
    """Number of environments per seed; 0 = the environment's default."""
    seed: int = 1
    """First seed, also used to draw the random combinations."""
    robot_policy: str | None = None
    """Policy from which all trainings start: a file, an id, or "shipped" for the policy included for the environment."""
    impl: str = "auto"
    """Physics: "jax", "warp", "native" or "auto"."""
    save_dir: str | None = "sweeps"
    """Folder for the results. None writes nothing."""

    def __post_init__(self) -> None:
        """Reject invalid settings before anything is built."""
        checked_count("--num-seeds", self.num_seeds)
        check_save_dir(self.save_dir)


def parse_grid(grid: Sequence[str], random: int = 0, seed: int = 0) -> list[Setting]:
    """Return the settings that ``--grid`` and ``--random`` specify.

    Raises:
        UnknownNameError: if a name is not in ``SWEPT``.
        ConfigError: if an entry is not of the form NAME=A,B,..., or there is nothing to compare.
    """
    axes: dict[str, list[float]] = {}
    needed = "NAME=A,B,... with numbers"
    named = [re.sub("^[^=]*", lambda name: name[0].replace("-", "_"), entry) for entry in grid]
    for name, values in entries("--grid", named, needed).items():
        if name not in SWEPT:
            raise UnknownNameError("hyperparameter to sweep", name, SWEPT)
        try:
            axes[name] = [float(x) for x in values.split(",")]
        except ValueError:
            raise ConfigError(f"--grid takes {needed}; got '{name}={values}'.") from None
    settings = [dict(zip(axes, x, strict=True)) for x in itertools.product(*axes.values())]
    if 0 < random < len(settings):
        chosen = np.random.default_rng(seed).permutation(len(settings))[:random]
        settings = [settings[i] for i in sorted(chosen)]
    names = [name_of(setting) for setting in settings]
    if twice := sorted({x for x in names if names.count(x) > 1}):
        raise ConfigError(f"--grid has {twice[0]} twice (a folder's name has six digits).")
    if len(settings) < 2:
        raise ConfigError("A sweep needs at least two settings: --grid lr=3e-4,1e-3.")
    return settings


def name_of(setting: Mapping[str, float]) -> str:
    """Return the name of a setting, which is also the name of its folder."""
    return ",".join(f"{name}={value:g}" for name, value in setting.items())


def setting_of(folder: str) -> Setting:
    """Return the setting that a folder is named after, see ``name_of``."""
    pairs = (entry.partition("=") for entry in folder.split(","))
    return {name: float(value) for name, _, value in pairs}


def lanes_of_sweep(config: LearnConfig, settings: Sequence[Setting], num_seeds: int) -> list[Lane]:
    """Return the trainings of a sweep: every setting with the same seeds."""
    kinds = {x.name: type(getattr(config, x.name)) for x in dataclasses.fields(config)}
    kinds["cost_limit"] = kinds["value_warm_up"] = float  # None where there is none
    return [
        Lane(f"{name_of(setting)}/seed_{seed}", seed, changed)
        for setting in settings
        for changed in [
            dataclasses.replace(config, **{name: kinds[name](x) for name, x in setting.items()})
        ]
        for seed in range(config.seed, config.seed + num_seeds)
    ]


def sweep(
    env: Any,
    config: PPOConfig,
    settings: Sequence[Setting],
    num_seeds: int,
    progress: Progress | None = None,
) -> TrainResult:
    """Train all settings with all seeds; the result's ``seeds`` are in this order.

    Raises:
        ConfigError, SaveFolderError, BufferOverflowError: as for ``train.ppo.train``.
        DivergedError: if all of them diverged.
    """
    refuse_active_human(env, config.allow_joint_observation)
    if "cost_limit" in settings[0]:  # the program has a limit, its value is an argument
        config = dataclasses.replace(config, cost_limit=settings[0]["cost_limit"])
    if config.cost_limit is None and (idle := [x for x in settings[0] if x.startswith("cost_")]):
        raise ConfigError(
            f"{', '.join(idle)} has no effect without a limit. Add cost_limit to --grid, such as cost_limit=0.05."
        )
    config, mesh = resolve_config(env, config)
    agents = Agents(config, env, ("robot" if len(env.action_sizes) == 1 else "joint",))
    lanes = lanes_of_sweep(config, settings, num_seeds)
    return run_session(env, config, agents, mesh, progress, lanes=lanes)


def rank(result: TrainResult, settings: Sequence[Setting], num_seeds: int) -> list[dict[str, Any]]:
    """Return the results of every setting at the end of training, best first; a diverged seed has no success."""
    ranked = []
    for i, setting in enumerate(settings):
        seeds = result.seeds[i * num_seeds : (i + 1) * num_seeds]
        ends = [_last(found.curve, "success") if not found.stopped else 0.0 for found in seeds]
        success = np.array(ends)
        low, high = bootstrap_interval(success[:, None])
        returns = [_last(found.curve, "return") for found in seeds if found.curve]
        ranked.append({
            "setting": setting, "success_iqm": iqm(success), "low": low, "high": high,
            "worst": float(success.min()), "success_of_seeds": ends,
            "return_iqm": iqm(returns) if returns else None, **_gentle(seeds),
            "diverged": sum(bool(found.stopped) for found in seeds),
        })  # fmt: skip
    return sorted(
        ranked, key=lambda x: (-x["success_iqm"], -x["worst"], -(x["return_iqm"] or -1e9))
    )


def _gentle(seeds: Sequence[SeedResult]) -> dict[str, float]:
    """Return interquartile means of gentle success and of the mean peak force [N]; nothing if they are not measured."""
    curves = [found.curve for found in seeds if found.curve and "gentle" in found.curve[-1]]
    names = ("gentle", "peak") if curves else ()
    return {f"{name}_iqm": iqm([_last(curve, name) for curve in curves]) for name in names}


def _last(curve: Sequence[Mapping[str, Any]], name: str) -> float:
    """Return the last known value of a column of a curve, 0 if there is none."""
    return next((row[name] for row in reversed(curve) if row.get(name) is not None), 0.0)


def table(ranked: Sequence[Mapping[str, Any]]) -> str:
    """Format the ranking as a table."""
    lines = ["success: interquartile mean (95 % interval), worst seed   return   setting"]
    for x in ranked:
        lost = f"   {x['diverged']} diverged" if x["diverged"] else ""
        returned = "" if x["return_iqm"] is None else f"{x['return_iqm']:9.1f}"
        if "gentle_iqm" in x:
            returned += f"   gentle {x['gentle_iqm']:6.1%}, peak {x['peak_iqm']:5.1f} N"
        lines.append(
            f"{x['success_iqm']:7.1%} ({x['low']:.1%} to {x['high']:.1%}) {x['worst']:7.1%} "
            f"{returned}   {name_of(x['setting'])}{lost}"
        )
    return "\n".join(lines)


@reports_errors
def main(
    arguments: Sequence[str] | None = None,
    make: Callable[..., Any] = make_env,
    prog: str = f"python -m {__package__}.sweep",
) -> int:
    """Run the command line and return the exit status."""
    signal.signal(signal.SIGTERM, on_terminate)
    flags = parse_flags(SweepConfig, arguments, prog, plain(__doc__))
    settings = parse_grid(flags.grid, flags.random, flags.seed)
    continues = flags.robot_policy is not None
    config = config_for(flags.env_name, platform=jax.default_backend(), continues=continues)
    config = dataclasses.replace(
        config, seed=flags.seed, impl=flags.impl, save_dir=flags.save_dir, robot_policy=flags.robot_policy,
        num_envs=flags.num_envs or config.num_envs, num_env_steps=flags.num_env_steps or config.num_env_steps, **NO_SEARCH,
    )  # fmt: skip
    env = make(flags.env_name, flags.impl, **flags.options())
    result = sweep(env, config, settings, flags.num_seeds, for_terminal())
    ranked = rank(result, settings, flags.num_seeds)
    print(summary(result))
    print(table(ranked))
    if result.unsaved:
        print(unsaved(result), file=sys.stderr)
        return 2
    if result.folder:
        write_file(result.folder / "sweep.json", (json.dumps(ranked, indent=2) + "\n").encode())
    return 130 if result.interrupted else 0


if __name__ == "__main__":
    sys.exit(main())
