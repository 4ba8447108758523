"""Choose the best seed of a run: ``agym-jax select trained_models/ScratchItchJaco-v0``.

Evaluates the policy of every seed of a run with several seeds (``--num-seeds``), chooses the best one on one set of
people, and evaluates it again on another set, because results on the people used for the choice would be biased upwards.
The chosen policy is copied into the run's folder, where ``evaluate``, ``enjoy`` and ``agym_jax.load_policy`` find it.
"""

from __future__ import annotations

import dataclasses
import json
import re
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import jax
import tyro

from agym_jax.changes import Changes, arguments_of
from agym_jax.data.npz import check_appendable, write_file
from agym_jax.errors import (
    PolicyEnvironmentError,
    PolicyLayoutError,
    PolicyNotFoundError,
    UnknownNameError,
)
from agym_jax.flags import Count, plain
from agym_jax.memory import MEMORY
from agym_jax.policy.agents import AnyPolicy
from agym_jax.policy.files import FILE_NAMES, find_policies, load_policies, load_policy
from agym_jax.policy.policy import read_policy, save_policy

from .entries import AT_LEAST, numbers
from .envs import changed, make_env
from .errors import ConfigError, reports_errors
from .evaluation.evaluator import Evaluator
from .evaluation.score import EvaluationResult
from .evaluation.seed_scores import SeedScores, score_seeds
from .runs.candidates import score
from .runs.overview import SELECTION, read_rows
from .runs.record import append_record, record

CHOSEN = (
    "success", "success_low", "success_high", "return_mean", "return_std", "force_mean",
    "gentle_success", "peak_median", "peak_99",
)  # fmt: skip
"""Entries of the chosen policy's summary that are printed; the last ones only if the environment measures them."""
Training = dict[str, Any]
"""What identifies one: ``TRAINING``."""
TRAINING = "env", "commit", "seed"
GAP = 0.1
"""From which difference on it is said that a seed succeeds more often with the noise of its training than without."""


@dataclass(frozen=True)
class SelectConfig:
    """Flags of ``agym-jax select``."""

    run: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="RUN")]
    """Folder of a run with several seeds, such as trained_models/ScratchItchJaco-v0."""
    num_episodes: Count = 1000
    """Number of episodes per policy, all run in parallel."""
    seed: int = 2001
    """Seed of the episodes used to choose among the run's seeds."""
    report_seed: int = 1001
    """Seed of the episodes used to report the results of the chosen seed."""
    by: Literal["auto", "success", "gentle", "both"] = "auto"
    """What the best seed has most of: successes, gentle successes, or the sum of both; "auto": gentle successes if the run had a
    --cost-limit, else successes."""
    at_least: Annotated[tuple[str, ...], tyro.conf.arg(metavar="NAME=VALUE ...")] = ()
    """What the task's own measures have to reach in the mean, such as held=0.9 in Dressing: seeds that do not are chosen only if
    none does."""
    default_settings: bool = False
    """Evaluate in the environment with its default settings, regardless of those of the training except its memory, and mark the
    chosen policy as meant for it. For runs that were trained with more varied people or robots than the environment has."""
    shipped: bool = True
    """Also evaluate the policy that ships with agym_jax, if there is one, on the same people as the chosen one."""
    impl: str = "auto"
    """Physics: "jax", "warp", "native" or "auto"."""
    json: str | None = None
    """File to which the result is appended as a JSON line, besides selection.jsonl in the folder of the run."""


def seed_folders(run: Path) -> dict[int, Path]:
    """Map the seeds of a run to their folders, in order.

    Raises:
        PolicyNotFoundError: if there are none; the message explains what a run with several seeds looks like.
    """
    found = {
        int(path.name.removeprefix("seed_")): path
        for path in run.glob("seed_*")
        if re.fullmatch(r"seed_\d+", path.name) and (path / FILE_NAMES["robot"]).is_file()
    }
    if not found:
        raise PolicyNotFoundError(
            f"{run} has no policies of several seeds (looked for {run / 'seed_1' / 'policy.npz'} "
            f"etc.). agym-jax train --num-seeds 8 creates them; the folder is <save-dir>/<environment>."
        )
    return dict(sorted(found.items()))


def load_seeds(
    run: Path, make: Callable[..., Any], impl: str, default_settings: bool = False
) -> tuple[Any, dict[int, AnyPolicy]]:
    """Return the environment of a run, with its training settings or the default ones, and the policy of each of its seeds.

    The memory is that of the training in both cases.

    Raises:
        PolicyNotFoundError: if there are no policies.
        PolicyEnvironmentError, PolicyLayoutError: if they do not fit the environment.
    """
    folders = seed_folders(run)
    trained = read_policy(next(iter(folders.values())) / FILE_NAMES["robot"])
    changes = trained.info.get("changes", {})
    if default_settings:  # what the policies observe stays
        changes = {name: x for name, x in changes.items() if name == MEMORY}
    env = make(trained.info["env"], impl, **arguments_of(changes))
    fits = None if default_settings else env  # robots that varied in training are other settings
    return env, {seed: load_policy(folder, fits) for seed, folder in folders.items()}


def had_limit(run: Path) -> bool:
    """Return whether a run, or the sweep of which it is one setting, was trained with ``--cost-limit``."""
    for folder in (run.resolve(), run.resolve().parent):
        if (settings := folder / "config.json").is_file():
            return json.loads(settings.read_text())["config"].get("cost_limit") is not None
    return False


def check(config: SelectConfig) -> None:
    """Reject an invalid choice before anything is built.

    Raises:
        ConfigError: if the choice and the report would use the same episodes, or none.
    """
    if config.seed == config.report_seed:
        raise ConfigError(
            f"--seed and --report-seed are both {config.seed}: a policy must not be reported on the "
            f"episodes used to choose it. Choose another --report-seed."
        )
    if config.num_episodes < 1:
        raise ConfigError(f"num_episodes must be at least 1, got {config.num_episodes}.")


def limits(config: SelectConfig, env: Any) -> dict[str, float]:
    """Return ``--at-least`` as measure -> value.

    Raises:
        ConfigError: if an entry is not of the form NAME=VALUE.
        UnknownNameError: if the task does not have the measure.
    """
    known = [x.name for x in getattr(getattr(env, "task", None), "measures", ())]
    found = numbers("--at-least", config.at_least, AT_LEAST)
    for name in found:
        if name not in known:
            raise UnknownNameError(f"measure of {env.name}", name, known)
    return found


def select(
    evaluator: Evaluator, policies: dict[int, AnyPolicy], config: SelectConfig
) -> tuple[SeedScores, EvaluationResult]:
    """Evaluate all policies, choose the best, and evaluate it again."""
    usual = "gentle" if had_limit(Path(config.run)) else "success"
    by = usual if config.by == "auto" else config.by
    key = jax.random.PRNGKey(config.seed)
    at_least = limits(config, evaluator.env)
    scores = score_seeds(evaluator, policies, key, by=by, report=say, at_least=at_least)
    return scores, evaluator(policies[scores.best], jax.random.PRNGKey(config.report_seed))


def successes_with_noise(run: Path) -> list[float | None]:
    """The success rate of each seed at the end of its training, with sampled actions; None where it has no curve."""
    curves = [read_rows(folder / "curve.jsonl") for folder in seed_folders(run).values()]
    return [score(rows, rows[-1]["env_steps"])[0] if rows else None for rows in curves]


def needs_noise(scores: SeedScores, with_noise: Sequence[float | None]) -> str:
    """Say which seeds succeed clearly more often with noise than by the mode of their distribution; empty if none does."""
    found = [
        f"seed {seed} ({noisy:.1%}, mode {x.success:.1%})"
        for (seed, x), noisy in zip(scores.results.items(), with_noise, strict=True)
        if noisy is not None and noisy > max(x.success + GAP, x.success_interval[1])
    ]
    if not found:
        return ""
    return (
        f'More often successful at the end of the training, with noise: {", ".join(found)}. See docs/rare_success.md, "What seeds do '
        f'that fail"; --noise-ceiling 1 bounds the noise, smaller ceilings let it fall.'
    )


def say(text: str) -> None:
    """Print a line of progress."""
    print(text, file=sys.stderr, flush=True)


def measure_shipped(
    evaluator: Evaluator, config: SelectConfig
) -> tuple[EvaluationResult | None, str, Mapping[str, Training]]:
    """Evaluate the shipped policy on the people of the report.

    Returns:
        Its result, or None and the reason, empty if none ships; and the trainings that its policies come from.
    """
    try:
        memory = getattr(evaluator.env, MEMORY, ())
        files = find_policies(evaluator.env.name, memory=memory)
    except PolicyNotFoundError:
        return None, "", {}
    try:
        policy = load_policies(files, evaluator.env)
    except (PolicyEnvironmentError, PolicyLayoutError) as error:
        return None, str(error), {}
    result = evaluator(policy, jax.random.PRNGKey(config.report_seed))
    return result, "", trainings_of(files.robot, files.human)


def trainings_of(robot: Path | str | None, human: Path | str | None = None) -> dict[str, Training]:
    """Agent -> environment, commit and seed of the training that its policy comes from.

    Args:
        robot: policy file, if there is one.
        human: policy file of the person, if that acts.
    """
    files = {"robot": robot, "human": human}
    infos = {agent: read_policy(file).info for agent, file in files.items() if file}
    return {agent: {name: info.get(name) for name in TRAINING} for agent, info in infos.items()}


def keep(run: Path, seed: int, env: Any) -> Changes:
    """Copy the policies of a seed into the folder of its run, marked as meant for the environment.

    Returns:
        The settings of the training, if they are not those of the environment; otherwise none.
    """
    differ: Changes = {}
    meant = getattr(env, "changes", {})
    for name in set(FILE_NAMES.values()):
        if not (path := seed_folders(run)[seed] / name).is_file():
            continue
        policy = read_policy(path)
        trained = policy.info.get("changes", {})
        if trained == meant:
            write_file(run / name, path.read_bytes())  # whole, also if this is killed
        else:
            differ = trained
            info = {**policy.info, "meant_for": meant}
            save_policy(run / name, dataclasses.replace(policy, info=info))
    return differ


@reports_errors
def main(
    arguments: Sequence[str] | None = None,
    make: Callable[..., Any] = make_env,
    prog: str = f"python -m {__package__}.select",
) -> int:
    """Run the command line and return the exit status."""
    config = tyro.cli(SelectConfig, prog=prog, args=arguments, description=plain(__doc__))
    run = Path(config.run).resolve()
    check(config)
    if config.json:
        check_appendable(config.json)
    env, policies = load_seeds(run, make, config.impl, config.default_settings)
    own = run / SELECTION
    check_appendable(own, "What is measured is kept in the folder of the run.")
    evaluator = Evaluator(env, config.num_episodes)
    scores, reported = select(evaluator, policies, config)
    print(f"{scores.table()}\nThe best, on other people:\n{reported.table()}")
    ships, unfit, trainings = (
        measure_shipped(evaluator, config) if config.shipped else (None, "", {})
    )
    trained_with = keep(run, scores.best, env)
    with_noise = successes_with_noise(run)
    summary = reported.summary()
    line = record(
        "selection",
        **scores.summary(),
        success_with_noise_of_seeds=with_noise,
        chosen=scores.best,
        chosen_by=scores.by,
        reported=summary,
        shipped=ships.summary() if ships else None,
        shipped_unfit=unfit,
        shipped_trainings=trainings,
        chosen_over=config.seed,
        reported_over=config.report_seed,
        impl=str(getattr(env, "impl", config.impl)),
        **changed(env),
        **({"trained_with": trained_with} if trained_with else {}),
        **{f"chosen_{name}": summary[name] for name in CHOSEN if name in summary},
    )
    append_record(own, line)
    if config.json and Path(config.json).resolve() != own:
        append_record(config.json, line)
    if not trained_with and (needs := needs_noise(scores, with_noise)):  # else other people
        print(needs)
    if not scores.fulfils(scores.best):
        print(f"No seed reaches {', '.join(config.at_least)}; the best of all is chosen.")
    print(f"Chosen: seed {scores.best}, now {run / FILE_NAMES['robot']}.")
    if ships or unfit:
        print(f"The shipped policy, on the same people:\n{ships.table() if ships else unfit}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
