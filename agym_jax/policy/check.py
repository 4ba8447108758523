"""Check whether a policy fits an environment: same task and robot, same agent, same observation."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from agym_jax.changes import arguments_of, describe, essential, flags_of
from agym_jax.errors import PolicyEnvironmentError, PolicyLayoutError
from agym_jax.memory import MEMORY
from agym_jax.policy.agents import BASELINES, AnyPolicy, Pair, parts
from agym_jax.policy.policy import Policy, read_policy
from agym_jax.registry import active_id, plain_id, static_id

MOVES = {"robot": "the robot", "human": "the person", "joint": "robot and person together"}
FLAGS = {
    "robot": "--policy, and a --human-policy (a file, zero or random) where the person acts too",
    "human": "--human-policy, and an id whose person acts (...Human-v0)",
    "joint": "--policy alone, and the id it was trained in",
}
MEANT = "for this policy"


def train_command(env_name: str) -> str:
    """Return the command that trains a policy for an environment."""
    trainer = "train" if env_name == static_id(env_name) else "coop"
    return f"agym-jax {trainer} --env-name {env_name}"


def settings_for(path: Path | str, env_name: str) -> dict[str, Any]:
    """Return the ``agym_jax.make`` arguments of a policy's environment, for commands that take their settings from it.

    Args:
        path: path of the policy's file, or the name of a baseline.
        env_name: environment id; the result is empty if the policy belongs to another one.

    Raises:
        PolicyNotFoundError, PolicyDamagedError: if there is no such file, or it cannot be read.
    """
    if str(path) in BASELINES:
        return {}
    info, plain = read_policy(path).info, plain_id(env_name)
    same = static_id(str(info.get("env"))) == static_id(plain)
    return arguments_of(meant_for(info)) if same else {}


def meant_for(info: Mapping[str, Any]) -> dict[str, Any]:
    """Return the settings of the environment that a policy is for: those of its training, unless ``info`` names others."""
    return info.get("meant_for", info.get("changes", {}))


def check_policy(
    policy: Policy,
    env: Any,
    path: Path | str,
    any_env: bool = False,
    agent: str | None = None,
    other_people: bool = False,
    other_settings: bool = False,
) -> None:
    """Check that a policy fits an environment.

    Args:
        policy: the policy to check.
        env: environment that it must fit.
        path: path of the policy's file, for the error message.
        any_env: accept a policy of another environment, or one with different settings, if the observation layout and
            the action size agree.
        agent: agent that it is to control: "robot", "human", or "joint" for both; None = all active agents.
        other_people: accept a policy trained with a different population or episode length, to evaluate how it
            generalises.
        other_settings: accept a policy trained with any other settings of the same environment, to train it further.

    Raises:
        PolicyEnvironmentError: if the policy was trained for another task, robot or agent (a robot's policy fits both the
            passive and the active person of the same task and robot), or with different settings or another memory.
        PolicyLayoutError: if it expects a different observation layout or different sizes.
    """
    agents = parts(env)
    agent = agent or ("joint" if "joint" in agents else "robot")
    part, whose = agents[agent], policy.info.get("agent", "robot")
    trained_in = str(policy.info.get("env"))
    if whose != agent:
        raise PolicyEnvironmentError(
            f"{path} moves {MOVES[whose]} of {trained_in!r}, not {MOVES[agent]} of {env.name!r}. "
            f"Use it with {FLAGS[whose]}."
        )
    fitting = {
        "robot": (static_id(env.name), active_id(env.name)),
        "human": (active_id(env.name),),
        "joint": (env.name,),
    }[agent]
    if trained_in not in fitting and not any_env:
        raise PolicyEnvironmentError(
            f"{path} was trained in {trained_in!r}, not in {env.name!r}. A policy that fits was trained in "
            f"{' or '.join(map(repr, fitting))}. Use --env-name {trained_in}, or train one: "
            f"{train_command(env.name)}"
        )
    _check_memory(policy, env, path)
    theirs_changed, ours_changed = meant_for(policy.info), getattr(env, "changes", {})
    if other_people:
        theirs_changed, ours_changed = essential(theirs_changed), essential(ours_changed)
    if not (any_env or other_settings) and (differ := describe(theirs_changed, ours_changed)):
        flags = flags_of(theirs_changed)
        remedy = f"Make the environment as it was there ({flags})" if flags else "Leave them out"
        raise PolicyEnvironmentError(
            f"{path} was trained in {trained_in!r} with other settings: {differ}. {remedy}. To run the policy here "
            f"anyway: agym-jax evaluate, enjoy or view with --any-env, or load_policy without env."
        )
    layout = policy.info.get("layout")
    if layout not in (part.layout, part.former_layout):
        raise PolicyLayoutError(
            f"{path} reads observation layout {layout!r}, but {env.name!r} now has "
            f"{part.layout!r}: the entries of the observation have changed since it was "
            f"trained. Train it again, or use the version of agym_jax that it was made with "
            f"({policy.info.get('versions', {}).get('agym_jax', 'unknown')})."
        )
    theirs = (policy.arch.observation_size, policy.arch.action_size)
    ours = part.sizes
    if theirs != ours:
        raise PolicyLayoutError(
            f"{path} takes {theirs[0]} observations and gives {theirs[1]} actions; {env.name!r} "
            f"has {ours[0]} and {ours[1]}."
        )


def _check_memory(policy: Policy, env: Any, path: Path | str) -> None:
    """Raise PolicyEnvironmentError if policy and environment have different memories."""
    theirs = tuple(policy.info.get("changes", {}).get(MEMORY, ()))
    ours = tuple(getattr(env, MEMORY, ()))
    if theirs == ours:
        return
    told = lambda memory: f"the memory {memory}" if memory else "no memory"  # noqa: E731
    remedy = f"with --memory {' '.join(f'{x:g}' for x in theirs)}" if theirs else "without --memory"
    raise PolicyEnvironmentError(
        f"{path} has {told(theirs)}, and the observation of {env.name!r} here is that of {told(ours)}. Make the environment "
        f"{remedy} (in Python, agym_jax.make({env.name!r}, memory={theirs or None}))."
    )


def trained_otherwise(policy: AnyPolicy, env: Any) -> str:
    """Describe how an environment differs from a policy's training (or what it is ``meant_for``); empty if it does not.

    Args:
        policy: a policy or a pair of them; baselines and functions were not trained and never differ.
        env: environment in which it runs.
    """
    policies = (policy.robot, policy.human) if isinstance(policy, Pair) else (policy,)
    ours = getattr(env, "changes", {})

    def differ(info: Mapping[str, Any]) -> str:
        meant = meant_for(info)
        as_trained = meant == info.get("changes", {})
        return describe(meant, ours, "in training" if as_trained else MEANT)

    told = [differ(x.info) for x in policies if isinstance(x, Policy)]
    return "; ".join(dict.fromkeys(filter(None, told)))
