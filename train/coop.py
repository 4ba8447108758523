"""Train robot and person to cooperate: ``agym-jax coop --env-name ScratchItchJacoHuman-v0``.

Co-optimisation as in Assistive Gym: two policies with separate observations and a common reward, in one compiled update.
Rerunning the same command resumes an interrupted run; ``train`` does the same from Python.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from typing import Any

from .configs import CoopConfig
from .envs import make_env, refuse_static_human
from .learning.agents import Agents
from .runs.progress import Progress
from .runs.result import TrainResult
from .runs.session import OnLog, command_line, resolve_config, run_session


def train(
    env: Any,
    config: CoopConfig,
    progress: Progress | None = None,
    on_log: OnLog | None = None,
) -> TrainResult:
    """Train two policies, on all devices.

    Args:
        env: an environment (``agym_jax.make``) in which robot and person act, or a ``StepwiseEnv``.
        config: settings; ``save_dir=None`` writes no files.
        progress: receives progress reports; None shows nothing.
        on_log: called as ``on_log(row, policies)`` at each log line, where ``policies()`` returns the current policies
            by agent; a true result stops the run (its state is saved).

    Returns:
        Policies by agent, learning curve and times.

    Raises:
        ActiveHumanError: if only the robot acts.
        PolicyNotFoundError, PolicyEnvironmentError, PolicyLayoutError: if a policy to start from does not exist or fit.
        ConfigError, SaveFolderError, CheckpointMismatchError, BufferOverflowError, DivergedError: as for
            ``train.ppo.train``.
    """
    refuse_static_human(env)
    config, mesh = resolve_config(env, config)
    return run_session(env, config, Agents(config, env, ("robot", "human")), mesh, progress, on_log)


def main(
    arguments: Sequence[str] | None = None,
    make: Callable[..., Any] = make_env,
    prog: str = f"python -m {__package__}.coop",
) -> int:
    """Run the command line and return the exit status."""
    return command_line(CoopConfig, train, arguments, make, prog)


if __name__ == "__main__":
    sys.exit(main())
