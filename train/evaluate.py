"""Evaluate a policy: ``agym-jax evaluate --env-name ScratchItchJaco-v0 --num-episodes 100``.

All episodes run in parallel. As in Assistive Gym's evaluation over 100 episodes, the results are the return, the mean
over the steps of the force on the person, and success at the last step.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import jax

from agym_jax.data.npz import check_appendable
from agym_jax.errors import checked_count
from agym_jax.flags import Count, PolicyFlags, first_paragraph, parse_flags
from agym_jax.policy.agents import BASELINES, AnyPolicy, baseline_policy
from agym_jax.policy.check import trained_otherwise
from agym_jax.policy.files import load_policies

from .envs import changed, env_and_policies, make_env
from .errors import ConfigError, reports_errors
from .evaluation.evaluator import Evaluator
from .evaluation.score import EvaluationResult
from .runs.record import append_record, record


def evaluate(
    env: Any,
    policy: AnyPolicy | str,
    num_episodes: int = 100,
    key: jax.Array | int = 0,
    impl: str = "auto",
    deterministic: bool = True,
) -> EvaluationResult:
    """Evaluate a policy; to evaluate several, create an ``Evaluator`` and reuse it.

    Args:
        env: environment or its id.
        policy: a ``Policy``, a ``Pair`` of them, ``"zero"``, ``"random"``, or a function with the same signature.
        num_episodes: number of episodes.
        key: random key or seed.
        impl: physics, if ``env`` is an id.
        deterministic: act by the mode of the policy's distribution.

    Raises:
        ConfigError: if there is less than one episode.
    """
    if num_episodes < 1:
        raise ConfigError(f"num_episodes must be at least 1, got {num_episodes}.")
    env = make_env(env, impl) if isinstance(env, str) else env
    if isinstance(policy, str):
        policy = baseline_policy(policy, env.action_size)
    key = jax.random.PRNGKey(key) if isinstance(key, int) else key
    return Evaluator(env, num_episodes)(policy, key, deterministic)


MODE = "  Actions: the mode of the policy's distribution. With --non-det, samples of it, as in training."
SAMPLED = "  Actions: samples of the policy's distribution, as in training (evaluate --non-det)."


@dataclass(frozen=True)
class EvaluateConfig(PolicyFlags):
    """Flags of ``agym-jax evaluate``."""

    num_episodes: Count = 100
    """Number of episodes, all run in parallel."""
    seed: int = 1001
    """Seed of the episodes (Assistive Gym: training seed + 1000)."""
    impl: str = "auto"
    """Physics: "jax", "warp", "native" (C MuJoCo), or "auto": "native" on a CPU, "warp" on an NVIDIA GPU if installed."""
    by_group: bool = False
    """Report success by sex, impairment and size of the person; otherwise only the group with the lowest success."""
    json: str | None = None
    """File to which the result is appended as a JSON line."""

    def __post_init__(self) -> None:
        """Reject invalid settings before anything is built."""
        checked_count("--num-episodes", self.num_episodes)


@reports_errors
def main(
    arguments: Sequence[str] | None = None,
    make: Callable[..., Any] = make_env,
    prog: str = f"python -m {__package__}.evaluate",
) -> int:
    """Run the command line and return the exit status."""
    config = parse_flags(EvaluateConfig, arguments, prog, first_paragraph(__doc__))
    if config.json:
        check_appendable(config.json)
    env, files = env_and_policies(config, config.impl, make)
    policy = load_policies(files, env, config.any_env, other_people=True)
    print(f"Policy: {', '.join(x for x in (files.robot, files.human) if x)}", flush=True)
    result = evaluate(
        env, policy, config.num_episodes, config.seed, deterministic=not config.non_det
    )
    if otherwise := trained_otherwise(policy, env):
        print(f"Differs from training: {otherwise}.")
    print(result.table(config.by_group))
    if {files.robot, files.human} - {None, *BASELINES}:
        print(SAMPLED if config.non_det else MODE)
    if config.json:
        trained = dict(policy.info)
        human = {"human_policy": files.human} if files.human else {}
        line = record(
            "evaluation",
            policy=files.robot,
            **human,
            policy_commit=trained.get("commit"),
            policy_env_steps=trained.get("env_steps"),
            **({"policy_changes": trained["changes"]} if trained.get("changes") else {}),
            **({"other_than_in_training": otherwise} if otherwise else {}),
            seed=config.seed,
            deterministic=not config.non_det,
            impl=str(getattr(env, "impl", config.impl)),
            **changed(env),
            **result.summary(),
        )
        append_record(config.json, line)
    return 0


if __name__ == "__main__":
    sys.exit(main())
