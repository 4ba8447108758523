"""Locations of policies: shipped with the package, in the folder of a training run, or in a file."""

from __future__ import annotations

from dataclasses import dataclass
from os.path import isdir  # of "" it says no
from pathlib import Path
from typing import Any

from agym_jax.data.assets import asset_path, asset_root
from agym_jax.errors import (
    MissingAssetError,
    PolicyEnvironmentError,
    PolicyNotFoundError,
    did_you_mean,
)
from agym_jax.memory import SHIPPED, Memory
from agym_jax.policy.agents import BASELINES, Baseline, Pair, baseline_policy, parts
from agym_jax.policy.check import check_policy, train_command
from agym_jax.policy.policy import Policy, not_found, read_policy, shipped, shipped_folder
from agym_jax.registry import active_id, plain_id, static_id

FILE_NAMES = {"robot": "policy.npz", "joint": "policy.npz", "human": "human_policy.npz"}
"""Agent -> name of its policy file in the folder of a run."""
FORMER_FILE_NAMES = {"human": "person_policy.npz"}
"""The same for runs from before the agent was renamed."""


def load_policy(source: Path | str, env: Any = None) -> Policy | Pair:
    """Load a policy by environment id or by path; see ``agym_jax.load_policy``.

    Args:
        source: an environment id, to load its shipped policy; or the path of a file (``.npz``) or of a training run's
            folder (``trained_models/ScratchItchJaco-v0``). If ``env`` has a memory, the shipped one has it too. A string is
            taken as a path if it contains a slash, or if no policy ships under that name and there is such a folder.
        env: environment that the policy must fit; None skips this check.

    Returns:
        The policy of all active agents: a pair if robot and person each have their own.
    """
    text = str(source).removeprefix("agym_jax/")
    is_path = isinstance(source, Path) or "/" in text or "\\" in text or text.endswith(".npz")
    if is_path or (text not in shipped() and isdir(str(source))):
        files = _files_at(Path(source), None if env is None else env.name)
    else:
        files = find_policies(text, memory=getattr(env, "memory", ()))
    robot = read_policy(files.robot)
    human = None if files.human is None else read_policy(files.human)
    if env is not None:
        agent = "robot" if human else None
        check_policy(robot, env, files.robot, agent=agent, other_people=True)
    if human is None:
        return robot
    if env is not None:
        check_policy(human, env, str(files.human), agent="human", other_people=True)
    return Pair(robot, human, robot.arch.observation_size)


def _files_at(path: Path, env_name: str | None) -> PolicyFiles:
    """Return the policies in a file, in the folder of a run, or in the ``--save-dir`` of an environment's run."""
    if not path.is_dir():
        return PolicyFiles(str(path), None)
    run = path if env_name is None else run_folder(path, env_name)
    robot, human = _chosen_file(run), run_file(run, "human")
    others = sorted(str(file.parent) for file in path.glob(f"*/{robot.name}"))
    if others and not robot.is_file():
        raise PolicyNotFoundError(
            f"{str(path)!r} holds runs, not a policy. Name one of them: {', '.join(others)}."
        )
    return PolicyFiles(str(robot), str(human) if human.is_file() else None)


def run_file(folder: Path, agent: str) -> Path:
    """Return the file of an agent's policy in the folder of a run; it may not exist."""
    former = folder / FORMER_FILE_NAMES.get(agent, FILE_NAMES[agent])
    path = folder / FILE_NAMES[agent]
    return former if former.is_file() and not path.is_file() else path


def run_folder(load_dir: Path | str, env_name: str) -> Path:
    """Return the folder of an environment's run: ``load_dir/<env>``, or ``load_dir`` if it is itself the folder of a run."""
    folder = Path(load_dir)
    inside = folder / env_name
    is_run = run_file(folder, "robot").is_file() or _seeds(folder)
    return folder if is_run and not inside.is_dir() else inside


def _seeds(run: Path) -> list[Path]:
    """Return the policies of the seeds of a run that had several."""
    return sorted(run.glob(f"seed_*/{FILE_NAMES['robot']}"))


def _chosen_file(run: Path) -> Path:
    """Return the file of the robot's policy in the folder of a run; it may not exist.

    Raises:
        PolicyNotFoundError: if the run had several seeds and none has been chosen; the message says how to choose one.
    """
    path, seeds = run_file(run, "robot"), _seeds(run)
    if seeds and not path.is_file():
        raise PolicyNotFoundError(
            f"{str(run)!r} is a run with {len(seeds)} seeds, of which none has been chosen yet. Choose one: agym-jax select "
            f"{run}; or use one of them: --policy {seeds[0]}."
        )
    return path


def find_policy(
    env_name: str,
    load_dir: Path | str | None = None,
    policy: Path | str | None = None,
    memory: Memory = (),
) -> Path:
    """Return the policy file that the command-line tools select.

    Args:
        env_name: environment id.
        load_dir: ``--save-dir`` of a training run, or the run's own folder in it; selects ``<env>/policy.npz``.
        policy: a policy file, which takes precedence over ``load_dir``.
        memory: time constants [s] of the memory that a shipped policy is to have.

    Returns:
        The file; if neither folder nor file is given, the shipped policy of the environment.

    Raises:
        PolicyNotFoundError: if there is none; the message lists the available policies and how to train one.
    """
    train = f"Train one: {train_command(env_name)}"
    if policy is not None:
        if not Path(policy).is_file():
            raise not_found(Path(policy))
        return Path(policy)
    if load_dir is not None:
        run = run_folder(load_dir, env_name)
        path = _chosen_file(run)
        if not path.is_file():
            there = [p.parent.name for p in run.parent.glob(f"*/{path.name}")]
            raise PolicyNotFoundError(
                f"No policy for {env_name!r} in {str(load_dir)!r} (looked for {path}). "
                f"{did_you_mean(env_name, there)} {train} --save-dir {run.parent}"
            )
        return path
    if memory:
        return _with_memory(env_name, tuple(sorted(memory)), train)
    try:
        return asset_path(f"{shipped_folder()}/{env_name}.npz")
    except MissingAssetError:
        raise PolicyNotFoundError(
            f"agym_jax ships no policy for {env_name!r}. {did_you_mean(env_name, shipped())} {train}"
        ) from None


def _with_memory(env_name: str, memory: Memory, train: str) -> Path:
    """Return the file of the shipped policy that has a memory.

    Raises:
        PolicyNotFoundError: if there is none; the message says which there are, and ends with the command that trains one.
    """
    there = shipped(memory=True)
    if memory == SHIPPED and env_name in there:
        return asset_path(f"{shipped_folder(memory=True)}/{env_name}.npz")
    without = " Without a memory, one does." if env_name in shipped() else ""
    times = " ".join(f"{x:g}" for x in memory)
    raise PolicyNotFoundError(
        f"agym_jax ships no policy with the memory {memory} for {env_name!r}.{without} With {SHIPPED}, policies ship for "
        f"{', '.join(there)}. {train} --memory {times}"
    )


@dataclass(frozen=True)
class PolicyFiles:
    """The policies that the command line selects: files or names of baselines; no person's policy if none is named."""

    robot: str
    human: str | None


def find_policies(
    env_name: str,
    load_dir: str | None = None,
    policy: str | None = None,
    human_policy: str | None = None,
    memory: Memory = (),
) -> PolicyFiles:
    """Return the policies that the command-line tools select, before anything is built.

    Args:
        env_name: environment id.
        load_dir: ``--save-dir`` of a training run, or the run's own folder in it.
        policy: policy of the robot (or of both agents together): a file or a baseline, which takes precedence over
            ``load_dir``.
        human_policy: the same for the person.
        memory: time constants [s] of the memory that shipped policies are to have.

    Raises:
        PolicyNotFoundError: if there is no such file.
        PolicyEnvironmentError: if a person's policy is given, but the person does not act.
    """
    plain = plain_id(env_name)
    acts = plain != static_id(plain)
    if human_policy and not acts:
        raise PolicyEnvironmentError(
            f"In {plain!r} the person holds still and needs no --human-policy ({human_policy}). "
            f"Leave it out, or use --env-name {active_id(plain)}."
        )
    robot = policy if policy in BASELINES else str(find_policy(plain, load_dir, policy, memory))
    human = human_policy
    if human and human not in BASELINES:
        human = str(find_policy(plain, None, human))
    if human is None and acts and policy is None:
        beside = asset_root() / shipped_folder(bool(memory)) / "human" / f"{plain}.npz"
        if load_dir is not None:
            beside = run_file(run_folder(load_dir, plain), "human")
        human = str(beside) if beside.is_file() else None
    return PolicyFiles(str(robot), human)


def load_agent(
    name: Path | str, env: Any, agent: str, any_env: bool = False, other_people: bool = False
) -> Policy | Baseline:
    """Load the policy of one agent: from a file that fits the environment, or a baseline.

    Args:
        name: name of a file, or "zero" or "random".
        env: environment that it must fit.
        agent: agent that it controls: "robot", "human", or "joint" for both.
        any_env: see ``check_policy``.
        other_people: see ``check_policy``.

    Raises:
        PolicyNotFoundError: if there is no such file.
        PolicyDamagedError: if the file is damaged.
        PolicyEnvironmentError: if it is for another task, robot or agent, or different settings.
        PolicyLayoutError: if it expects a different observation layout or different sizes.
    """
    if str(name) in BASELINES:
        return baseline_policy(str(name), parts(env)[agent].sizes[1])
    policy = read_policy(name)
    check_policy(policy, env, name, any_env, agent, other_people)
    return policy


def load_policies(
    files: PolicyFiles, env: Any, any_env: bool = False, other_people: bool = False
) -> Policy | Baseline | Pair:
    """Load the policies of all active agents of an environment; for arguments and errors see ``load_agent``."""
    if files.human is None:
        agent = "joint" if "joint" in parts(env) else "robot"
        return load_agent(files.robot, env, agent, any_env, other_people)
    robot = load_agent(files.robot, env, "robot", any_env, other_people)
    human = load_agent(files.human, env, "human", any_env, other_people)
    return Pair(robot, human, parts(env)["robot"].observed.stop)
