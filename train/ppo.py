"""Train a robot's policy with PPO: ``agym-jax train --env-name ScratchItchJaco-v0``.

Rerunning the same command resumes an interrupted run; ``train`` does the same from Python.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from typing import Any

from agym_jax.policy.policy import Policy

from .configs import PPOConfig
from .envs import make_env, refuse_active_human
from .learning.agents import Agents
from .runs.curve import Row
from .runs.progress import Progress
from .runs.result import TrainResult
from .runs.session import Policies, command_line, resolve_config, run_session

OnLog = Callable[[Row, Callable[[], Policy]], bool | None]


def train(
    env: Any,
    config: PPOConfig,
    progress: Progress | None = None,
    on_log: OnLog | None = None,
) -> TrainResult:
    """Train a policy, on all devices.

    Args:
        env: an environment (``agym_jax.make``) with one acting agent, or a ``StepwiseEnv``.
        config: settings; ``save_dir=None`` writes no files.
        progress: receives progress reports; None shows nothing.
        on_log: called as ``on_log(row, policy)`` at each log line, where ``policy()`` returns the current policy; a true
            result stops the run (its state is saved).

    Returns:
        Policy, learning curve and times.

    Raises:
        ActiveHumanError: if the person acts too, and joint training was not allowed.
        ConfigError: if settings are inconsistent.
        SaveFolderError: if results cannot be written.
        CheckpointMismatchError: if the folder contains a run of something else.
        BufferOverflowError: if the physics lost contacts.
        DivergedError: if a loss is not finite.
    """
    refuse_active_human(env, config.allow_joint_observation)
    config, mesh = resolve_config(env, config)
    agent = "robot" if len(env.action_sizes) == 1 else "joint"

    def on_log_of_one(row: Row, policies: Callable[[], Policies]) -> bool | None:
        return on_log(row, lambda: policies()[agent]) if on_log else None

    return run_session(env, config, Agents(config, env, (agent,)), mesh, progress, on_log_of_one)


def main(
    arguments: Sequence[str] | None = None,
    make: Callable[..., Any] = make_env,
    prog: str = f"python -m {__package__}.ppo",
) -> int:
    """Run the command line and return the exit status."""
    return command_line(PPOConfig, train, arguments, make, prog)


if __name__ == "__main__":
    sys.exit(main())
