"""Settings of PPO: one base, a table of differences per task, and the command line made from both.

Flags carry the names of Assistive Gym's ``ppo.train``; a flag has one default, the one written
here. Switches are ``--flag`` / ``--no-flag`` (in Assistive Gym, passing ``--use-linear-lr-decay``
turned the decay off).
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Any, Literal, TypeVar

import tyro

from agym_jax.flags import Count, EnvFlags, env_name_in, task_config

from .errors import ConfigError, check_save_dir
from .task_changes import CPU_CHANGES, TASK_CHANGES

POSITIVE = ("lr", "eps", "max_grad_norm", "clip_param", "init_noise_std", "reward_scaling")
NOT_NEGATIVE = (
    "value_loss_coef", "entropy_coef", "policy_head_gain",
    "noise_floor",
    "cost_limit", "cost_proportional", "cost_integral", "cost_derivative", "cost_multiplier_max",
)  # fmt: skip
SHARES = ("gamma", "gae_lambda", "entropy_decay_share", "cost_tighten_from", "cost_tighten_until")
MAX_ENV_STEPS = 2**32 - 1  # the learner counts steps in 32 unsigned bits


@dataclass(frozen=True)
class LearnConfig(EnvFlags):
    """What every trainer can be told; see ``PPOConfig`` and ``CoopConfig``."""

    num_env_steps: Count = 10_000_000
    """Environment steps in all; 1e7 is accepted. Rounded up to whole updates."""
    save_dir: str | None = "trained_models"
    """Folder of the results; each environment gets its own folder in it. None writes nothing."""
    seed: int = 1
    """Seed of the networks, the environments and the exploration."""
    num_seeds: Count = 1
    """Independent trainings side by side, with the seeds seed, seed + 1, ...; num_envs and num_env_steps are
    those of each. Their policies and curves are in folders seed_1, seed_2, ... of the run."""
    impl: str = "auto"
    """Physics: "jax" and "warp" (MJX), "native" (C MuJoCo), or "auto": "native" on a CPU, "warp" on an NVIDIA GPU where it
    is installed."""
    devices: Count = 0
    """Accelerators that share the environments; 0 = all there are."""
    hosts: str | None = None
    """Train on several machines, each started with this command: "auto" where JAX finds them itself
    (SLURM, Open MPI, Cloud TPU), or ADDRESS:PORT,COUNT,INDEX with the address of machine 0, how many
    they are, and which one this is. They need a common --save-dir."""

    num_envs: Annotated[Count, tyro.conf.arg(aliases=["--num-processes"])] = 0
    """Environments simulated side by side; 0 = 64 on a CPU and 1024 on an accelerator. More of them make
    more steps a second, but fewer updates of the steps that they make."""
    num_steps: Count = 20
    """Steps of each environment in one update."""
    ppo_epoch: Count = 4
    """Passes over the data of an update."""
    num_mini_batch: Count = 8
    """Gradient steps in a pass; fewer where a step would have less than 80 samples."""
    stagger: bool = True
    """Start the environments at different times of their first episode, so that an update sees all
    phases of an episode (needs an environment that can; the first episodes are not counted)."""

    lr: float = 3e-4
    """Learning rate of Adam."""
    eps: float = 1e-5
    """Epsilon of Adam."""
    use_linear_lr_decay: bool = True
    """Let the learning rate fall linearly to zero over the run."""
    max_grad_norm: float = 0.5
    """Gradients are scaled down to this norm."""
    gamma: float = 0.99
    """Discount per step."""
    gae_lambda: Annotated[float, tyro.conf.arg(aliases=["--tau"])] = 0.95
    """Lambda of generalised advantage estimation."""
    clip_param: float = 0.2
    """Clipping range of the probability ratio, and of the value with clip_value_loss."""
    clip_value_loss: bool = False
    """Clip the change of the value prediction too, as Assistive Gym's trainer does."""
    recompute_advantages: bool | None = None
    """Estimate advantages and value targets anew before every pass over the data of an update. None: where an update
    has at least 10,000 samples; a value function that knows fewer by heart would learn its own errors."""
    gradient_precision: Literal["float32", "tensorfloat32"] = "float32"
    """Of matrix products in gradients: NVIDIA's TensorFloat-32 is faster and rounds their factors to 10 bits. Environments,
    actions, values and advantages always take float32, as does everything on a CPU."""
    value_loss_coef: float = 0.5
    """Weight of the value loss (which itself carries another 0.5)."""
    entropy_coef: float = 0.0
    """Weight of the entropy bonus."""
    entropy_decay_share: float = 0.0
    """Share of the run in which the entropy bonus falls linearly to zero: first look around, then
    settle; 0 = it stays."""
    privileged_critic: bool = True
    """Let the value functions, in training only, see what rewards to come depend on and nobody
    observes, such as how much water is left in the cup. The policies never see it."""
    normalize_observations: bool = True
    """Normalise observations by their running mean and deviation, clipped to 10 deviations."""
    normalize_reward: bool = True
    """Divide rewards by the running deviation of the discounted return, clipped to 10."""
    reward_scaling: float = 1.0
    """Constant factor on the reward, before normalize_reward."""

    cost_limit: float | None = None
    """Learn to be gentle: the mean cost of an episode must not exceed this. A step in which robot or tool press on a
    region of the person's body harder than is comfortable costs 1, and up to 1 more for how far; 0.05 asks for at least
    95 % gentle episodes. None: forces cost only what the task's reward says."""
    cost_proportional: float = 1.0
    """With cost_limit: proportional gain of the multiplier's controller."""
    cost_integral: float = 0.05
    """With cost_limit: integral gain, per update; the multiplier grows by so much where the cost is far too high."""
    cost_derivative: float = 0.5
    """With cost_limit: derivative gain, per update, while the cost rises."""
    cost_multiplier_max: float = 2.0
    """With cost_limit: largest multiplier. At 1, cost and reward weigh alike; much more, and the task may be given up."""
    cost_tighten_from: float = 0.35
    """With cost_limit: share of the run after which the limit falls, from any cost, so that the task is learned first."""
    cost_tighten_until: float = 0.7
    """With cost_limit: share of the run after which the limit is cost_limit."""

    policy_hidden: tuple[int, ...] = (64, 64)
    """Hidden layers of the policy."""
    value_hidden: tuple[int, ...] = (128, 128)
    """Hidden layers of the value function."""
    activation: Literal["tanh", "swish", "elu", "relu"] = "tanh"
    """Activation of both networks."""
    distribution: Literal["normal", "tanh_normal"] = "tanh_normal"
    """Exploration: a tanh-squashed Gaussian whose deviation depends on the observation, or one
    clipped to [-1, 1] with a deviation of its own ("normal", as in Assistive Gym)."""
    init_noise_std: float = 1.0
    """Initial deviation of "normal"."""
    noise_floor: float = 0.0
    """Least deviation of "normal" in the first half of the run, then falling to zero: noise must last until a success
    that is rare is found."""
    policy_head_gain: float = 0.01
    """Gain of the initial weights of the policy's last layer (Assistive Gym: 1)."""

    log_interval: Count = 0
    """Updates between two log lines; 0 = about 80 lines in a run."""
    save_interval: Count = 0
    """Updates between two checkpoints, rounded up to a log line; 0 = about 10 in a run, and at
    least one a minute. A killed run loses at most what follows its last checkpoint."""
    logger: tuple[Literal["tensorboard", "wandb", "trackio"], ...] = ()
    """Where hyper-parameters and curves go besides the run's folder, one or several: each is an extra of its name."""
    fresh: bool = False
    """Start over: the results of an earlier run are moved aside instead of being continued."""

    def __post_init__(self) -> None:
        """Reject values that can never work.

        Raises:
            ConfigError: names the field, its value and what is allowed.
        """
        for name in ("num_env_steps", "num_steps", "ppo_epoch", "num_mini_batch", "num_seeds"):
            if getattr(self, name) < 1:
                raise ConfigError(f"{name} must be at least 1, got {getattr(self, name)}.")
        for name in POSITIVE:
            value = getattr(self, name)
            if not value > 0 or (math.isinf(value) and name != "max_grad_norm"):
                raise ConfigError(f"{name} must be greater than 0 and finite, got {value}.")
        for name in ("policy_hidden", "value_hidden"):
            sizes = getattr(self, name)
            if not sizes or any(size < 1 for size in sizes):
                raise ConfigError(
                    f"{name} must be the sizes of at least one layer, each at least 1, such as --{name.replace('_', '-')} "
                    f"64 64; got {' '.join(map(str, sizes)) or 'none'}."
                )
        if self.noise_floor and self.distribution != "normal":
            raise ConfigError(
                f"noise_floor bounds the deviation of --distribution normal; {self.distribution} has none of its own."
            )
        check_save_dir(self.save_dir)
        for name in SHARES:
            if not 0 <= getattr(self, name) <= 1:
                raise ConfigError(f"{name} must be between 0 and 1, got {getattr(self, name)}.")
        for name in NOT_NEGATIVE:
            value = getattr(self, name)
            if value is not None and not 0 <= value < math.inf:
                raise ConfigError(f"{name} must be at least 0 and finite, got {value}.")
        if self.num_env_steps > MAX_ENV_STEPS:
            raise ConfigError(
                f"num_env_steps must be at most {MAX_ENV_STEPS}, got {self.num_env_steps}."
            )


@dataclass(frozen=True)
class PPOConfig(LearnConfig):
    """Every setting of ``train.ppo``."""

    allow_joint_observation: bool = False
    """Train one policy for robot and person together, which lets the robot read the person's
    observation."""


@dataclass(frozen=True)
class CoopConfig(LearnConfig):
    """Every setting of ``train.coop``."""

    env_name: str = "ScratchItchJacoHuman-v0"
    """Environment id, one whose person acts too."""
    central_critic: bool = False
    """Let the value functions see both observations (the policies never do)."""
    robot_policy: str | None = None
    """A policy file that the robot starts from."""
    freeze_robot: bool = False
    """Leave --robot-policy as it is, and let it act by the mode of its distribution."""
    human_policy: str | None = None
    """A policy file that the person starts from."""
    freeze_human: bool = False
    """Leave --human-policy as it is, and let it act by the mode of its distribution."""

    def __post_init__(self) -> None:
        """Reject values that can never work.

        Raises:
            ConfigError: as ``LearnConfig``; or there is nothing to freeze, or nothing to learn.
        """
        super().__post_init__()
        for agent in ("robot", "human"):
            if getattr(self, f"freeze_{agent}") and getattr(self, f"{agent}_policy") is None:
                raise ConfigError(
                    f"--freeze-{agent} keeps a policy as it is, so it needs --{agent}-policy FILE."
                )
        if self.freeze_robot and self.freeze_human:
            raise ConfigError(
                "--freeze-robot with --freeze-human leaves nobody to learn. Use one of them, or "
                "agym-jax evaluate to measure the two policies."
            )


Config = TypeVar("Config", PPOConfig, CoopConfig)

NUM_ENVS = {"cpu": 64, "gpu": 1024, "tpu": 1024}
"""Environments by kind of device."""
LEAST_RECOMPUTED = 10_000
"""Samples of an update from which on its advantages are estimated anew before every pass."""
LEAST_SAMPLES = 80
"""Of a mini-batch, when ``num_mini_batch`` would make smaller ones of a small batch."""


def config_for(env_name: str, kind: type[Config] = PPOConfig, platform: str = "gpu") -> Config:
    """The settings of an environment: the base with its task's changes, and with those of a CPU.

    Args:
        env_name: environment id, such as ``"ScratchItchJaco-v0"``; an id of no known task gets
            the base.
        kind: whose settings.
        platform: JAX's name of the device kind: "cpu", "gpu", "tpu".
    """
    changes = _of(TASK_CHANGES, env_name, {})
    changes = changes | (_of(CPU_CHANGES, env_name, {}) if platform == "cpu" else {})
    return dataclasses.replace(kind(), env_name=env_name, task=task_config(env_name), **changes)


def _of(table: dict[str, Any], env_name: str, otherwise: Any) -> Any:
    """The entry of the longest key that an environment id begins with."""
    plain = env_name.rpartition(":")[2]  # without the module of a plug-in
    keys = [key for key in table if plain.startswith(key)]
    return table[max(keys, key=len)] if keys else otherwise


def parse_arguments(
    arguments: Sequence[str],
    kind: type[Config] = PPOConfig,
    prog: str | None = None,
    platform: str = "gpu",
) -> Config:
    """Settings from command-line words, with the defaults of the environment they name on a kind of device."""
    does = {
        PPOConfig: "Train a robot's policy with PPO.",
        CoopConfig: "Train robot and person side by side: two policies, one reward.",
    }[kind]
    return tyro.cli(
        kind,
        prog=prog,
        description=f"{does} Rerunning the same command continues it.",
        args=list(arguments),
        default=config_for(env_name_in(arguments, kind.env_name), kind, platform),
    )


def resolve(config: Config, platform: str, devices: int = 1) -> Config:
    """Fill in what depends on the machine.

    Args:
        config: settings, with 0 meaning automatic.
        platform: JAX's name of the device kind: "cpu", "gpu", "tpu".
        devices: how many share the environments.

    Returns:
        Settings without a 0 in ``devices``, ``num_envs`` and ``log_interval``;
        ``save_interval`` is a whole number of log intervals.

    Raises:
        ConfigError: the environments do not divide among the devices, or the data of an update not into
            mini-batches.
    """
    num_envs = config.num_envs or NUM_ENVS.get(platform, NUM_ENVS["gpu"])
    if num_envs % devices:
        raise ConfigError(
            f"{num_envs} environments cannot be shared by {devices} devices. Nearest that can: "
            f"--num-envs {devices * max(1, round(num_envs / devices))}; or use fewer: --devices 1."
        )
    batch = num_envs * config.num_steps
    if batch // config.num_mini_batch < LEAST_SAMPLES and batch % LEAST_SAMPLES == 0:
        config = dataclasses.replace(config, num_mini_batch=batch // LEAST_SAMPLES)
    here = batch // devices
    if here % config.num_mini_batch:
        divisors = [n for n in range(1, min(here, 256) + 1) if here % n == 0]
        near = min(divisors, key=lambda n: abs(n - config.num_mini_batch))
        each = f" on each of {devices} devices" if devices > 1 else ""
        raise ConfigError(
            f"An update has {num_envs // devices} environments x {config.num_steps} steps = {here} "
            f"samples{each}, which do not divide into {config.num_mini_batch} mini-batches. Nearest "
            f"that does: --num-mini-batch {near}."
        )
    if config.recompute_advantages is None:
        config = dataclasses.replace(config, recompute_advantages=batch >= LEAST_RECOMPUTED)
    total = updates_in(config.num_env_steps, batch)
    log_interval = config.log_interval or max(1, round(total / 80))
    save_interval = config.save_interval or max(1, math.ceil(total / 10))
    save_interval = log_interval * math.ceil(save_interval / log_interval)
    return dataclasses.replace(
        config,
        devices=devices,
        num_envs=num_envs,
        log_interval=log_interval,
        save_interval=save_interval,
    )


def updates_in(num_env_steps: int, batch: int) -> int:
    """Updates of ``batch`` steps that make at least ``num_env_steps``."""
    return math.ceil(num_env_steps / batch)
