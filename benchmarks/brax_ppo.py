"""Brax's own PPO and ``train.ppo`` side by side: success over environment steps and over seconds of training.

    python -m benchmarks.brax_ppo --json benchmarks/results/brax_ppo.jsonl
    python -m benchmarks.brax_ppo --draw

Three trainings of each environment: ``brax`` is ``brax.training.agents.ppo.train``; ``same`` is ``train.ppo`` with the same
settings, what Brax has not switched off (``WITHOUT``); ``shipped`` is ``train.ppo`` as it comes. The networks are the
same, and one evaluator measures the mode of all policies, on the same humans. Evaluating does not count as training.
``--draw`` makes ``docs/images/brax_ppo.png`` of the newest results.
"""

from __future__ import annotations

import dataclasses
import itertools
import statistics
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, Literal

import jax
import tyro

from agym_jax.adapters.brax import wrap_for_brax_training
from agym_jax.policy.networks import make_networks
from agym_jax.policy.policy import Policy
from benchmarks.keep import keep
from benchmarks.markdown import RESULTS, Line, read_results
from benchmarks.training_tables import TRAINERS
from train import ppo
from train.configs import Count, PPOConfig, config_for, resolve, updates_in
from train.envs import make_env
from train.evaluate import Evaluator
from train.learning.ppo import architecture
from train.task_changes import NO_SEARCH

Trainer = Literal["brax", "same", "shipped"]
WITHOUT: dict[str, Any] = {
    "stagger": False,
    "use_linear_lr_decay": False,
    "entropy_decay_share": 0.0,
    "normalize_reward": False,
    "privileged_critic": False,
    "value_layer_norm": False,
    "gradient_precision": "float32",
    "noise_floor": 0.0,
    "noise_ceiling": 0.0,
    **NO_SEARCH,
}
"""What ``train.ppo`` does besides, switched off. What stays: the true last observation at a time limit."""
PICTURE = RESULTS.parent.parent / "docs" / "images" / "brax_ppo.png"
ENOUGH = 0.9
"""The share of successes whose first time is noted."""


@dataclass(frozen=True)
class BraxPPOConfig:
    """Flags of ``python -m benchmarks.brax_ppo``."""

    env_names: tuple[str, ...] = ("ReachingJaco-v0", "ScratchItchJaco-v0")
    """Environment ids."""
    trainers: tuple[Trainer, ...] = ("brax", "same", "shipped")
    """Who trains."""
    num_env_steps: Count = 10_000_000
    """Environment steps of a training."""
    num_envs: Count = 0
    """Environments; 0 = as many as train.ppo takes."""
    reward_scaling: float = 0.05
    """Factor on the reward, where it is not normalised (brax, same)."""
    points: Count = 20
    """Evaluations in a training."""
    episodes: Count = 500
    """Episodes of an evaluation."""
    seed: int = 1
    """Of a training."""
    impl: str = "auto"
    """Physics: "jax", "warp", "auto"."""
    json: Path | None = None
    """File to which each result is added as a JSON line."""
    draw: bool = False
    """Train nothing, only draw the recorded results."""


@dataclass
class Curve:
    """Measures policies while one is trained, and keeps the time that this takes apart.

    Attributes:
        evaluator: of the environment.
        key: decides the episodes.
        points: what was measured: environment steps, seconds of training, and what the policy achieved.
    """

    evaluator: Evaluator
    key: jax.Array
    points: list[dict[str, Any]] = field(default_factory=list)
    _start: float = field(default_factory=time.perf_counter)
    _aside: float = 0.0

    def seconds(self) -> float:
        """Since the training began, without evaluations [s]."""
        return time.perf_counter() - self._start - self._aside

    def measure(self, env_steps: int, policy: Callable[[], Policy]) -> None:
        """Add a point."""
        seconds = self.seconds()
        found = self.evaluator(policy(), self.key)
        self.points.append(
            {
                "env_steps": env_steps,
                "seconds": seconds,
                "success": found.success,
                "return": float(found.returns.mean()),
                "nan": int(found.nan.sum()),
                "overflow": found.overflow,
            }
        )
        self._aside += self.seconds() - seconds
        print(f"{env_steps:>11,} steps {seconds:6.1f} s  success {found.success:.0%}", flush=True)


def settings(config: BraxPPOConfig, env_name: str, trainer: Trainer) -> PPOConfig:
    """What is trained with; those of ``brax`` and ``same`` are the same."""
    own = config_for(env_name, PPOConfig)
    if trainer != "shipped":
        own = dataclasses.replace(own, **WITHOUT, reward_scaling=config.reward_scaling)
    own = dataclasses.replace(
        own,
        num_env_steps=config.num_env_steps,
        num_envs=config.num_envs,
        seed=config.seed,
        impl=config.impl,
        save_dir=None,
        log_interval=1,
        devices=1,
    )
    own = resolve(own, jax.default_backend())
    total = updates_in(own.num_env_steps, own.num_envs * own.num_steps)
    return dataclasses.replace(own, log_interval=max(1, round(total / config.points)))


def train_brax(env: Any, own: PPOConfig, curve: Curve) -> float:
    """Train with Brax; returns the seconds of compiling."""
    from brax.training.agents.ppo import train as brax_ppo

    arch = architecture(own, env.observation_size, env.action_size)
    begun: list[float] = []  # when training began; then when each epoch ended

    def on_epoch(env_steps: int, _: Any, params: tuple) -> None:
        begun.append(curve.seconds())
        if env_steps:
            normalizer, weights, _ = jax.device_get(params)
            curve.measure(env_steps, lambda: Policy(weights, normalizer.mean, normalizer.std, arch))

    batch = own.num_envs * own.num_steps
    points = max(1, round(updates_in(own.num_env_steps, batch) / own.log_interval))
    brax_ppo.train(
        environment=env,
        wrap_env_fn=wrap_for_brax_training,
        episode_length=env.episode_length,
        num_timesteps=own.num_env_steps,
        num_evals=points + 1,
        run_evals=False,
        num_envs=own.num_envs,
        num_eval_envs=own.num_envs,
        max_devices_per_host=1,
        unroll_length=own.num_steps,
        batch_size=own.num_envs // own.num_mini_batch,
        num_minibatches=own.num_mini_batch,
        num_updates_per_batch=own.ppo_epoch,
        learning_rate=own.lr,
        entropy_cost=own.entropy_coef,
        discounting=own.gamma,
        gae_lambda=own.gae_lambda,
        clipping_epsilon=own.clip_param,
        clipping_epsilon_value=own.clip_param if own.clip_value_loss else None,
        vf_loss_coefficient=own.value_loss_coef,
        max_grad_norm=own.max_grad_norm,
        reward_scaling=own.reward_scaling,
        normalize_observations=own.normalize_observations,
        seed=own.seed,
        network_factory=lambda *_, **__: make_networks(arch),
        policy_params_fn=on_epoch,
    )
    epochs = [end - start for start, end in itertools.pairwise(begun)]
    return begun[0] + epochs[0] - statistics.median(epochs[1:] or epochs)


def measure(
    config: BraxPPOConfig, env: Any, evaluator: Evaluator, trainer: Trainer
) -> dict[str, Any]:
    """Train once; returns the fields of the result line."""
    print(f"{env.name}: {trainer}", flush=True)
    own = settings(config, env.name, trainer)
    curve = Curve(evaluator, jax.random.PRNGKey(config.seed + 1000))
    if trainer == "brax":
        compile_seconds = train_brax(env, own, curve)
    else:

        def on_log(row: dict[str, Any], policy: Callable[[], Policy]) -> None:
            curve.measure(row["env_steps"], policy)

        compile_seconds = ppo.train(env, own, None, on_log).compile_seconds
    points = [point | {"seconds": point["seconds"] - compile_seconds} for point in curve.points]
    enough = next((point for point in points if point["success"] >= ENOUGH), None)
    last = points[-1]
    return {
        "env": env.name,
        "trainer": trainer,
        "impl": env.impl,
        "num_envs": own.num_envs,
        "seed": config.seed,
        "episodes": config.episodes,
        "steps": last["env_steps"],
        "success": last["success"],
        "return": last["return"],
        "compile_s": compile_seconds,
        "train_s": last["seconds"],
        "steps_per_s": round(last["env_steps"] / last["seconds"]),
        "steps_to_90": enough and enough["env_steps"],
        "seconds_to_90": enough and enough["seconds"],
        "curve": {name: [point[name] for point in points] for name in last},
        "nan": sum(point["nan"] for point in points),
        "overflow": sum(point["overflow"] for point in points),
        "settings": dataclasses.asdict(own),
    }


def draw(lines: Sequence[Line], output: Path) -> None:
    """A column for each environment: success over millions of steps above, over seconds of training below."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    names = sorted({line["env"] for line in lines})
    figure, panels = plt.subplots(2, len(names), figsize=(4.2 * len(names), 6), squeeze=False)
    for line in lines:
        curve, column = line["curve"], names.index(line["env"])
        shares = [100 * x for x in curve["success"]]
        label, colour = (
            TRAINERS[line["trainer"]].replace("`", ""),
            f"C{list(TRAINERS).index(line['trainer'])}",
        )
        millions = [x / 1e6 for x in curve["env_steps"]]
        for panel, x in zip(panels[:, column], (millions, curve["seconds"]), strict=True):
            panel.plot(x, shares, color=colour, label=label)
    for panel, name in zip(panels[0], names, strict=True):
        panel.set(title=name, xlabel="million environment steps")
    for panel in panels[1]:
        panel.set(xlabel="seconds of training")
    for panel in panels.flat:
        panel.set(ylim=(0, 101), ylabel="success [%]")
        panel.grid(alpha=0.25)
    panels[0][0].legend(frameon=False, fontsize=8)
    figure.tight_layout()
    figure.savefig(output, dpi=110)
    plt.close(figure)


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; returns the exit status."""
    config = tyro.cli(BraxPPOConfig, prog="python -m benchmarks.brax_ppo", args=arguments)
    if config.draw:
        draw(read_results("brax_ppo", ("env", "trainer")), PICTURE)
        return 0
    done = []
    for name in config.env_names:
        env = make_env(name, config.impl)
        evaluator = Evaluator(env, config.episodes)
        for trainer in config.trainers:
            run = partial(measure, config, env, evaluator, trainer)
            done.append(keep("brax-ppo", run, config.json))
    return 2 if None in done else 0


if __name__ == "__main__":
    sys.exit(main())
