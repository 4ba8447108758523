"""Evaluate robot and person policies in all pairings: ``agym-jax crossplay --env-name ScratchItchJacoHuman-v0 --runs a b c``.

Every robot policy is paired with every person policy, on the same episodes; in the last column, the person holds still.
Pairs with the same architecture share a compiled program.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import jax
import tyro

from agym_jax.data.npz import check_appendable
from agym_jax.errors import checked_count
from agym_jax.flags import Count, command_words, first_paragraph
from agym_jax.policy.agents import BASELINES, Baseline, Pair, parts
from agym_jax.policy.check import check_policy, settings_for
from agym_jax.policy.files import find_policy, load_agent, run_file
from agym_jax.policy.policy import Policy
from agym_jax.registry import plain_id, static_id

from .envs import changed, make_env, refuse_static_human
from .errors import ConfigError, reports_errors
from .evaluation.evaluator import Evaluator
from .evaluation.score import EvaluationResult
from .runs.record import append_record, record

STILL = "(holds still)"
Matrix = dict[tuple[str, str], EvaluationResult]
Named = Mapping[str, Policy | Baseline]


@dataclass(frozen=True)
class CrossplayConfig:
    """Flags of ``agym-jax crossplay``."""

    env_name: str = "ScratchItchJacoHuman-v0"
    """Environment id with an active person."""
    runs: Annotated[tuple[str, ...], tyro.conf.arg(metavar="DIR ...")] = ()
    """--save-dir of train.coop runs; the robot policy and the person policy of each run take part."""
    robots: Annotated[tuple[str, ...], tyro.conf.arg(metavar="FILE ...")] = ()
    """Further robot policies, for this id or the one with a passive person; "zero", "random"."""
    humans: Annotated[tuple[str, ...], tyro.conf.arg(metavar="FILE ...")] = ()
    """Further person policies; "zero", "random"."""
    still_human: bool = True
    """Also evaluate every robot policy with a person who holds still."""
    num_episodes: Count = 100
    """Number of episodes per pair, all run in parallel."""
    seed: int = 1001
    """Seed of the episodes, the same for all pairs."""
    impl: str = "auto"
    """Physics: "jax", "warp", "native" or "auto"."""
    json: str | None = None
    """File to which the result of each pair is appended as a JSON line."""

    def __post_init__(self) -> None:
        """Reject invalid settings before anything is built."""
        checked_count("--num-episodes", self.num_episodes)


def find_files(config: CrossplayConfig) -> tuple[list[str], list[str]]:
    """Return the files (or baselines) of the robots and of the people.

    Raises:
        ConfigError: if there is no robot policy, or no person.
        PolicyNotFoundError: if a file does not exist.
    """
    plain = plain_id(config.env_name)
    robots, humans = (
        [str(run_file(Path(run) / plain, agent)) for run in config.runs] + list(more)
        for agent, more in (("robot", config.robots), ("human", config.humans))
    )
    for name in (*robots, *humans):
        if name not in BASELINES:
            find_policy(plain, None, name)
    if not robots or not (humans or config.still_human):
        raise ConfigError(
            "A matrix needs robots and people: --runs DIR ... of train.coop, or --robots FILE ... and "
            "--humans FILE ... (files, zero, random)."
        )
    return list(dict.fromkeys(robots)), list(dict.fromkeys(humans))


def crossplay(
    env: Any,
    robots: Named,
    humans: Named,
    num_episodes: int,
    seed: int,
    still_env: Any = None,
) -> Iterator[tuple[tuple[str, str], EvaluationResult]]:
    """Evaluate every robot policy with every person policy.

    Args:
        env: environment in which both act.
        robots: name -> policy.
        humans: name -> policy.
        num_episodes: number of episodes per pair.
        seed: seed of the episodes.
        still_env: the same environment with a person who holds still; None omits that column.

    Yields:
        (robot, person) and the result of the pair, as soon as it is available.
    """
    key, columns = jax.random.PRNGKey(seed), parts(env)["robot"].observed.stop
    evaluator = Evaluator(env, num_episodes) if humans else None
    for robot, policy in robots.items():
        for human, other in humans.items():
            if evaluator:
                yield (robot, human), evaluator(Pair(policy, other, columns), key)
    if still_env is not None:
        evaluator = Evaluator(still_env, num_episodes)
        for robot, policy in robots.items():
            yield (robot, STILL), evaluator(policy, key)


def table(matrix: Matrix) -> str:
    """Format success, gentle success and mean return of all pairs; rows are robots, columns people."""
    robots, humans = (list(dict.fromkeys(key[i] for key in matrix)) for i in (0, 1))
    lines = [f"  R{i:<3}{name}" for i, name in enumerate(robots, 1)]
    lines += [f"  P{i:<3}{name}" for i, name in enumerate(humans, 1)]
    measured = all(cell.gentle_success is not None for cell in matrix.values())
    told, width = ("success, gentle success,", 25) if measured else ("success,", 18)
    lines.append(f"{told} and return, of a robot (row) with a person (column):")
    lines.append("    " + "".join(f"{f'P{i}':>{width}}" for i in range(1, len(humans) + 1)))
    for i, robot in enumerate(robots, 1):
        cells = [matrix[robot, human] for human in humans]
        shares = [(c.success, c.gentle_success) if measured else (c.success,) for c in cells]
        shown = [" ".join(f"{x:6.1%}" for x in share) for share in shares]
        shown = [f"{x} {c.returns.mean():9.1f}" for x, c in zip(shown, cells, strict=True)]
        lines.append(f"R{i:<3}" + "".join(f"{text:>{width}}" for text in shown))
    return "\n".join(lines)


def run(config: CrossplayConfig, make: Callable[..., Any] = make_env) -> Matrix:
    """Evaluate the requested pairs, with the environment settings of the first trained robot, and print the table.

    Raises:
        PolicyEnvironmentError, PolicyLayoutError: if a policy does not fit; the message says what would.
    """
    if config.json:
        check_appendable(config.json)
    robot_files, humans_files = find_files(config)
    trained = [file for file in robot_files if file not in BASELINES]
    settings = settings_for((trained or robot_files)[0], config.env_name)
    env = make(config.env_name, config.impl, **settings)
    refuse_static_human(env)
    robots = {name: load_agent(name, env, "robot") for name in robot_files}
    humans = {name: load_agent(name, env, "human") for name in humans_files}
    still = None
    if config.still_human:
        still = make(static_id(config.env_name), config.impl, **settings)
    for name, policy in robots.items():
        if still and isinstance(policy, Policy):
            check_policy(policy, still, name)
    matrix: Matrix = {}
    for (robot, human), result in crossplay(
        env, robots, humans, config.num_episodes, config.seed, still
    ):
        matrix[robot, human] = result
        if config.json:
            line = record(
                "crossplay",
                robot_policy=robot,
                human_policy=None if human == STILL else human,
                seed=config.seed,
                impl=str(getattr(env, "impl", config.impl)),
                **changed(env),
                **result.summary(),
            )
            append_record(config.json, line)
    print(f"{env.name}, {config.num_episodes} episodes per pair\n{table(matrix)}")
    return matrix


@reports_errors
def main(
    arguments: Sequence[str] | None = None,
    make: Callable[..., Any] = make_env,
    prog: str = f"python -m {__package__}.crossplay",
) -> int:
    """Run the command line and return the exit status."""
    description = first_paragraph(__doc__)
    config = tyro.cli(
        CrossplayConfig, prog=prog, args=command_words(arguments), description=description
    )
    run(config, make)
    return 0


if __name__ == "__main__":
    sys.exit(main())
