"""Measure a policy: ``python -m train.evaluate --env-name ScratchItchJaco-v0 --num-episodes 100``.

All episodes run side by side in one compiled call. As in Assistive Gym's 100-episode evaluation:
return, mean over the steps of the force on the person, and success at the last step.
"""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import tyro

from agym_jax.errors import AgymError
from train.acting import TREES, AnyPolicy, baseline_policy, find_policies, load_policies
from train.configs import Count
from train.envs import make_env, vectorize
from train.npz import check_writable
from train.record import append_record, record
from train.rollout import FORCE_KEY


def wilson_interval(successes: int, trials: int, z: float = 1.959964) -> tuple[float, float]:
    """Wilson's interval of a probability.

    Args:
        successes: how often it happened.
        trials: out of how many.
        z: quantile of the normal distribution; the default gives 95 %.

    Returns:
        Lower and upper end; (0, 1) without trials.
    """
    if trials == 0:
        return 0.0, 1.0
    share, weight = successes / trials, z * z / trials
    centre = (share + weight / 2) / (1 + weight)
    half = z / (1 + weight) * math.sqrt(share * (1 - share) / trials + weight / (4 * trials))
    return max(0.0, centre - half), min(1.0, centre + half)


@dataclass(frozen=True)
class EvaluationResult:
    """What an evaluation found; arrays have one entry an episode.

    Attributes:
        env: environment id.
        returns: return of the episode.
        forces: mean over its steps of the force on the person [N].
        successes: whether the task was done at its last step.
        nan: whether it ended because the physics went non-finite.
        overflow: steps in which the physics lost contacts, all episodes.
        seconds: time of the rollout, compiling included.
    """

    env: str
    returns: np.ndarray
    forces: np.ndarray
    successes: np.ndarray
    nan: np.ndarray
    overflow: int
    seconds: float

    @property
    def episodes(self) -> int:
        """Number of episodes."""
        return len(self.returns)

    @property
    def success(self) -> float:
        """Share of episodes that succeeded."""
        return float(np.mean(self.successes))

    @property
    def success_interval(self) -> tuple[float, float]:
        """Its 95 % Wilson interval."""
        return wilson_interval(int(np.sum(self.successes)), self.episodes)

    def table(self) -> str:
        """The result for people."""
        low, high = self.success_interval
        rows = [
            ("return", f"{self.returns.mean():9.2f} ± {self.returns.std():.2f}"),
            ("force on the person [N]", f"{self.forces.mean():9.2f} ± {self.forces.std():.2f}"),
            ("success", f"{self.success:9.1%}   95 % interval {low:.1%} to {high:.1%}"),
            ("episodes that went NaN", f"{int(self.nan.sum()):9d}"),
        ]
        if self.overflow:
            rows.append(("steps with lost contacts", f"{self.overflow:9d}   do not trust these"))
        head = f"{self.env}, {self.episodes} episodes"
        return "\n".join([head] + [f"  {name:<24}{value}" for name, value in rows])

    def summary(self) -> dict[str, Any]:
        """The result for a JSON line."""
        low, high = self.success_interval
        return {
            "env": self.env,
            "episodes": self.episodes,
            "return_mean": float(self.returns.mean()),
            "return_std": float(self.returns.std()),
            "force_mean": float(self.forces.mean()),
            "force_std": float(self.forces.std()),
            "success": self.success,
            "success_low": low,
            "success_high": high,
            "nan_episodes": int(self.nan.sum()),
            "overflow": self.overflow,
            "seconds": round(self.seconds, 2),
        }


def zero_sums(num_envs: int) -> dict[str, jax.Array]:
    """What ``add_step`` adds to: one entry a world."""
    names = ("return", "force", "length", "success", "nan", "overflow")
    return dict.fromkeys(names, jnp.zeros(num_envs, jnp.float32))


def add_step(
    going: jax.Array, sums: dict[str, jax.Array], state: Any
) -> tuple[jax.Array, dict[str, jax.Array]]:
    """Add one step to the sums over the first episode of each world.

    Args:
        going: 1 in the worlds whose first episode had not ended before the step    (B,).
        sums: so far.
        state: of all worlds after the step.

    Returns:
        ``going`` and ``sums`` after the step.
    """
    zero, metrics = jnp.zeros_like(going), state.metrics
    gains = {
        "return": state.reward,
        "force": metrics.get(FORCE_KEY, zero),
        "length": zero + 1,
        "success": metrics.get("success", zero) * state.done,
        "nan": metrics.get("nan", zero),
        "overflow": metrics.get("overflow", zero),
    }
    sums = {name: sums[name] + going * gain for name, gain in gains.items()}
    return going * (1 - state.done), sums


def result_of(env_name: str, sums: Mapping[str, Any], seconds: float) -> EvaluationResult:
    """The result that the sums of all steps make."""
    sums = {name: np.asarray(value) for name, value in sums.items()}
    return EvaluationResult(
        env=env_name,
        returns=sums["return"],
        forces=sums["force"] / np.maximum(sums["length"], 1),
        successes=sums["success"] > 0.5,
        nan=sums["nan"] > 0,
        overflow=int(sums["overflow"].sum()),
        seconds=seconds,
    )


class Evaluator:
    """Runs a fixed number of episodes; compiles once for all policies of one architecture."""

    def __init__(self, env: Any, num_episodes: int) -> None:
        self.env = env
        self._venv = vectorize(env, num_episodes)
        self._run_policy = jax.jit(self._run, static_argnames="deterministic")
        self._run_function = jax.jit(self._run, static_argnames=("policy", "deterministic"))

    def __call__(
        self, policy: AnyPolicy, key: jax.Array, deterministic: bool = True
    ) -> EvaluationResult:
        """Run the episodes.

        Args:
            policy: a ``Policy``, a ``Pair`` of them, or a function
                ``(obs, key, deterministic) -> action``.
            key: decides the episodes (and the samples of a policy that is not deterministic).
            deterministic: take the mode of the policy's distribution.
        """
        start = time.perf_counter()
        run = self._run_policy if isinstance(policy, TREES) else self._run_function
        sums = jax.device_get(run(policy=policy, key=key, deterministic=deterministic))
        return result_of(self.env.name, sums, time.perf_counter() - start)

    def _run(self, policy: Any, key: jax.Array, deterministic: bool) -> dict[str, jax.Array]:
        """Sums over the first episode of each world."""
        venv = self._venv
        key_reset, key_steps = jax.random.split(key)
        going = jnp.ones(venv.num_envs, jnp.float32)

        def step(carry: tuple, key: jax.Array) -> tuple[tuple, None]:
            state, going, sums = carry
            state = venv.step(state, policy(state.obs, key, deterministic))
            return (state, *add_step(going, sums, state)), None

        keys = jax.random.split(key_steps, self.env.episode_length)
        start = (venv.reset(key_reset), going, zero_sums(venv.num_envs))
        (_, _, sums), _ = jax.lax.scan(step, start, keys)
        return sums


def evaluate(
    env: Any,
    policy: AnyPolicy | str,
    num_episodes: int = 100,
    key: jax.Array | int = 0,
    impl: str = "auto",
    deterministic: bool = True,
) -> EvaluationResult:
    """Measure a policy; to measure several, keep an ``Evaluator``.

    Args:
        env: environment or its id.
        policy: a ``Policy``, a ``Pair`` of them, ``"zero"``, ``"random"``, or a function like one.
        num_episodes: how many, all at once.
        key: random key or seed.
        impl: physics, if ``env`` is an id.
        deterministic: take the mode of the policy's distribution.
    """
    env = make_env(env, impl) if isinstance(env, str) else env
    if isinstance(policy, str):
        policy = baseline_policy(policy, env.action_size)
    key = jax.random.PRNGKey(key) if isinstance(key, int) else key
    return Evaluator(env, num_episodes)(policy, key, deterministic)


@dataclass(frozen=True)
class EvaluateConfig:
    """Flags of ``python -m train.evaluate``."""

    env_name: str = "ScratchItchJaco-v0"
    """Environment id."""
    load_dir: str | None = None
    """--save-dir of a training run; without it and --policy, the policy shipped with agym_jax."""
    policy: str | None = None
    """A policy file, or "zero" or "random"; the robot's, where there is one for each agent."""
    person_policy: str | None = None
    """The same for a person who acts; without it, the one that lies beside the robot's."""
    num_episodes: Count = 100
    """Episodes, all side by side."""
    seed: int = 1001
    """Seed of the episodes (Assistive Gym: training seed + 1000)."""
    non_det: bool = False
    """Sample actions instead of taking the mode."""
    impl: str = "auto"
    """Physics: "jax", "warp" or "auto"."""
    any_env: bool = False
    """Accept a policy of another environment with the same observation layout."""
    json: str | None = None
    """File to which the result is added as a JSON line."""


def main(arguments: Sequence[str] | None = None, make: Callable[[str, str], Any] = make_env) -> int:
    """The command line; returns the exit status."""
    config = tyro.cli(EvaluateConfig, prog="python -m train.evaluate", args=arguments)
    jax.config.update("jax_default_matmul_precision", "highest")
    try:
        if config.json:
            check_writable(Path(config.json).parent, "Choose another file with --json.")
        files = find_policies(config.env_name, config.load_dir, config.policy, config.person_policy)
        env = make(config.env_name, config.impl)
        policy = load_policies(files, env, config.any_env)
        result = evaluate(
            env, policy, config.num_episodes, config.seed, deterministic=not config.non_det
        )
    except AgymError as error:
        print(f"{type(error).__name__}: {error}", file=sys.stderr)
        return 2
    print(result.table())
    if config.json:
        trained = dict(policy.info)
        person = {"person_policy": files.person} if files.person else {}
        line = record(
            "evaluation",
            policy=files.robot,
            **person,
            policy_commit=trained.get("commit"),
            policy_env_steps=trained.get("env_steps"),
            seed=config.seed,
            deterministic=not config.non_det,
            impl=str(getattr(env, "impl", config.impl)),
            **result.summary(),
        )
        append_record(config.json, line)
    return 0


if __name__ == "__main__":
    sys.exit(main())
