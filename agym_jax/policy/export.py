"""Export a policy to ONNX, with its normaliser built in and its inputs and outputs described: ``agym-jax export``.

    agym-jax export ScratchItchJaco-v0 policy.onnx
    agym-jax export ScratchItchJaco-v0 policy.onnx --load-dir trained_models
    agym-jax export FeedingPR2Human-v0 person.onnx --agent human

If neither a policy file nor a run's folder is given, the policy that ships with the package is exported. The exported
graph computes the policy's mean actions.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import agym_jax
from agym_jax.data.npz import check_writable, write_file
from agym_jax.errors import AgymError, ArgumentError, PolicyEnvironmentError, PolicyNotFoundError
from agym_jax.memory import Memory
from agym_jax.policy.agents import BASELINES
from agym_jax.policy.check import check_policy, settings_for
from agym_jax.policy.contract import contract
from agym_jax.policy.files import find_policies
from agym_jax.policy.onnx_graph import PRECISIONS, build_model, import_onnx
from agym_jax.policy.policy import Policy, read_policy
from agym_jax.registry import active_id, parse, plain_id, static_id

SUFFIX = ".onnx"
AGENTS = ("robot", "human", "joint")


def export_policy(
    policy: Policy, env: Any, path: Path | str, precision: str = PRECISIONS[0]
) -> Path:
    """Export a policy to ONNX.

    Args:
        policy: policy of one agent of ``env``, or of both together.
        env: environment in which it acts.
        path: file to write, ending in ``.onnx``; its folder is created if necessary.
        precision: precision of the computation inside the graph, see ``onnx_graph.PRECISIONS``.

    Returns:
        The path.

    Raises:
        ArgumentError: if the file name does not end in ``.onnx``.
        SaveFolderError: if the folder cannot be written to.
        MissingExtraError: if onnx is not installed.
        PolicyEnvironmentError: if the policy was trained for another task, robot or agent.
        PolicyLayoutError: if it expects a different observation.
    """
    path = checked_path(path)
    agent = policy.info.get("agent", "robot")
    check_policy(policy, env, path, agent=agent if env.active else None)
    model = build_model(policy, contract(env, agent, policy.info), precision)
    write_file(path, model.SerializeToString())
    return path


def checked_path(path: Path | str) -> Path:
    """Check that a file can be written and return its path.

    Raises:
        ArgumentError: if its name does not end in ``.onnx``.
        SaveFolderError: if its folder cannot be written to.
    """
    path = Path(path)
    if path.suffix != SUFFIX:
        raise ArgumentError(f"A policy is exported to a file whose name ends in {SUFFIX}, got {str(path)!r}.")  # fmt: skip
    if path.is_dir():
        raise ArgumentError(f"{path} is a folder. Name a file.")
    check_writable(path.parent, "Choose another file.")
    return path


def choose_policy(
    env_id: str,
    load_dir: str | None = None,
    policy: str | None = None,
    agent: str | None = None,
    memory: Memory = (),
) -> Path:
    """Return the file of the policy that the command line selects.

    Args:
        env_id: environment id.
        load_dir: ``--save-dir`` of a training run.
        policy: a policy file, which takes precedence over ``load_dir``.
        agent: agent whose policy to export; None for the robot's, or for the agent of the given file.
        memory: time constants [s] of the memory that a shipped policy is to have.

    Raises:
        PolicyNotFoundError: if there is no such policy.
        PolicyEnvironmentError: if the person's policy is requested for an id in which the person does not act.
        ArgumentError: if a baseline is requested, which has no file.
    """
    if policy in BASELINES:
        raise ArgumentError(f"{policy!r} is not a policy that can be exported. Name a file with --policy.")  # fmt: skip
    plain = plain_id(env_id)
    if agent in ("human", "joint") and plain == static_id(plain):
        raise PolicyEnvironmentError(
            f"In {plain!r} the person holds still: there is no --agent {agent}. Use {active_id(plain)}."
        )
    files = find_policies(env_id, load_dir, policy, memory=memory)
    if policy is not None or agent != "human":
        return Path(files.robot)
    if files.human is None:
        raise PolicyNotFoundError(
            f"There is no person's policy for {plain!r} beside {files.robot}. Name its file with --policy."
        )
    return Path(files.human)


def main(argv: Sequence[str] | None = None, prog: str = "agym-jax export") -> int:
    """Run the command line and return the exit status."""
    parser = argparse.ArgumentParser(
        prog=prog, description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("id", help="environment id, such as ScratchItchJaco-v0")
    parser.add_argument("output", help="file to write, such as policy.onnx")
    parser.add_argument("--policy", help="policy file to export instead of the shipped policy")
    parser.add_argument("--load-dir", help="--save-dir of the training run whose policy to export")
    parser.add_argument(
        "--agent", choices=AGENTS, help="agent whose policy to export, if the person acts too"
    )
    parser.add_argument(
        "--memory", type=float, nargs="+", default=(), metavar="T", help="memory of the shipped policy to export [s]"
    )  # fmt: skip
    parser.add_argument("--precision", choices=PRECISIONS, default=PRECISIONS[0], help="of the computation; float32 for runtimes without float64")  # fmt: skip
    args = parser.parse_args(argv)
    try:
        import_onnx()
        path = checked_path(args.output)
        parse(args.id)
        file = choose_policy(args.id, args.load_dir, args.policy, args.agent, args.memory)
        # no compiling: only names and sizes are read
        env = agym_jax.make(args.id, impl="native", **settings_for(file, args.id))
        policy = read_policy(file)
        if args.agent:
            check_policy(policy, env, file, agent=args.agent)
        export_policy(policy, env, path, args.precision)
    except AgymError as error:
        print(f"{type(error).__name__}: {error}", file=sys.stderr)
        return 2
    sizes = policy.arch.observation_size, policy.arch.action_size
    print(
        f"{path}: {file.name}, {policy.info['agent']} of {env.name}, {sizes[0]} observations, {sizes[1]} actions"
    )
    return 0
