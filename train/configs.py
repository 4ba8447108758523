"""Settings of PPO: base settings, a table of changes for each task, and the command line generated from both.

Flags have the same names as those of Assistive Gym's ``ppo.train``; their defaults are defined here only. Boolean flags
are ``--flag`` / ``--no-flag`` (in Assistive Gym, passing ``--use-linear-lr-decay`` turned the decay off).
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Any, Literal, TypeVar

import tyro

from agym_jax.flags import Count, EnvFlags, env_name_in, task_config
from agym_jax.registry import plain_id

from .continued import NOISE_BOUNDS, value_warm_up
from .errors import ConfigError, check_save_dir
from .task_changes import CPU_CHANGES, SEARCH_CHANGES, STEPS, TASK_CHANGES

POSITIVE = "lr", "eps", "max_grad_norm", "clip_param", "init_noise_std", "reward_scaling", "candidates_until"  # fmt: skip
NOT_NEGATIVE = (
    "value_loss_coef", "entropy_coef", "policy_head_gain", "noise_floor", "noise_ceiling",
    "cost_limit", "cost_proportional", "cost_integral", "cost_derivative", "cost_multiplier_max",
)  # fmt: skip
SHARES = (
    "gamma", "gae_lambda", "entropy_decay_share", "value_warm_up", "noise_ceiling_from", "candidates_until",
    "restart_share", "cost_margin", "cost_tighten_from", "cost_tighten_until",
)  # fmt: skip
COUNTS = "num_env_steps", "num_steps", "ppo_epoch", "num_mini_batch", "num_seeds", "num_candidates"
MAX_ENV_STEPS = 2**32 - 1  # the learner counts steps in 32 unsigned bits


@dataclass(frozen=True)
class LearnConfig(EnvFlags):
    """Settings shared by all trainers; see ``PPOConfig`` and ``CoopConfig``."""

    num_env_steps: Annotated[Count, tyro.conf.arg(aliases=["--total-timesteps"])] = 10_000_000
    """Number of environment steps of each seed, such as 1e7; rounded up to whole updates. Other candidates' steps come on top."""
    save_dir: str | None = "trained_models"
    """Folder for the results; each environment gets its own subfolder. None writes nothing."""
    seed: int = 1
    """Seed of the networks, the environments and the exploration."""
    num_seeds: Count = 1
    """Number of independent trainings in parallel, with the seeds seed, seed + 1, ..., each with num_envs and num_env_steps;
    their policies and learning curves are stored in the run's folders seed_1, seed_2, ..."""
    num_candidates: Count = 1
    """Begin each training this many times with different random numbers, each with num_envs; after candidates_until of the steps, only
    the one with the highest success rate continues (if none succeeds, the largest return; with cost_limit, gentle success counts, too)."""
    candidates_until: float = 0.4
    """With num_candidates: fraction of the run after which one of them continues."""
    restart_share: float = 0.0
    """Largest fraction of ended episodes that are followed by the rest of one that has just succeeded, from a random moment of
    it on, instead of by a new one; it is smaller where few episodes succeed and falls to 0 as all do. See docs/rare_success.md."""
    impl: str = "auto"
    """Physics: "jax" or "warp" (MJX), "native" (C MuJoCo), or "auto": "native" on a CPU, "warp" on an NVIDIA GPU if
    installed."""
    devices: Count = 0
    """Number of accelerators among which the environments are divided; 0 = all available."""
    hosts: str | None = None
    """Train on several machines, starting this command on each: "auto" where JAX can detect them (SLURM, Open MPI, Cloud
    TPU), or ADDRESS:PORT,COUNT,INDEX with the address of machine 0, the number of machines, and the index of this one.
    They need a shared --save-dir."""

    num_envs: Annotated[Count, tyro.conf.arg(aliases=["--num-processes"])] = 0
    """Number of environments simulated in parallel; 0 = 64 on a CPU and 1024 on an accelerator. More environments give more
    steps per second, but fewer updates for the same number of steps."""
    num_steps: Count = 20
    """Steps of each environment per update."""
    ppo_epoch: Annotated[Count, tyro.conf.arg(aliases=["--epochs"])] = 4
    """Passes over the data of each update."""
    num_mini_batch: Annotated[Count, tyro.conf.arg(aliases=["--num-minibatches"])] = 8
    """Gradient steps per pass; fewer if a mini-batch would have less than 80 samples."""
    stagger: bool = True
    """Begin at different times of an episode, so that every update contains most of them (first episodes are not counted)."""

    lr: Annotated[float, tyro.conf.arg(aliases=["--learning-rate"])] = 3e-4
    """Learning rate of Adam."""
    eps: float = 1e-5
    """Epsilon of Adam."""
    use_linear_lr_decay: bool = True
    """Decay the learning rate linearly to zero over the run."""
    max_grad_norm: float = 0.5
    """Maximum gradient norm; larger gradients are scaled down to it."""
    gamma: float = 0.99
    """Discount factor per step."""
    gae_lambda: Annotated[float, tyro.conf.arg(aliases=["--tau"])] = 0.95
    """Lambda of generalised advantage estimation."""
    clip_param: Annotated[float, tyro.conf.arg(aliases=["--clip-range"])] = 0.2
    """Clipping range of the probability ratio, and of the value if clip_value_loss is set."""
    clip_value_loss: bool = False
    """Also clip the change of the value prediction, as Assistive Gym's trainer does."""
    recompute_advantages: bool | None = None
    """Recompute advantages and value targets before every pass over the data of an update. None: only if an update has at
    least 10,000 samples; with fewer, the value function memorises them and would learn from its own errors."""
    gradient_precision: Literal["float32", "tensorfloat32"] = "tensorfloat32"
    """Of matrix products in gradients: NVIDIA's TensorFloat-32 is faster and rounds their factors to 10 bits. Environments,
    actions, values and advantages always take float32, as does everything on a CPU."""
    value_loss_coef: float = 0.5
    """Weight of the value loss (which itself contains another factor of 0.5)."""
    entropy_coef: float = 0.0
    """Weight of the entropy bonus."""
    entropy_decay_share: float = 0.0
    """Fraction of the run over which the entropy bonus decays linearly to zero: explore first, settle later; 0 = no decay."""
    privileged_critic: bool = True
    """Give the value functions, never the policies, what no agent observes but rewards depend on, such as the water left."""
    normalize_observations: bool = True
    """Normalise observations by their running mean and standard deviation, clipped to 10 standard deviations. A policy that training
    starts from keeps those with which it learned."""
    normalize_reward: bool = True
    """Divide rewards by the running standard deviation of the discounted return, clipped to 10."""
    reward_scaling: float = 1.0
    """Constant factor on the reward, applied before normalize_reward."""

    cost_limit: float | None = None
    """Train for gentleness: upper limit on the mean cost of an episode. Each step in which the robot or its tool presses on
    a region of the person's body harder than its comfort limit costs 1, plus up to 1 depending on the excess; 0.05 demands
    at least 95 % gentle episodes. None: forces are penalised only by the task's reward."""
    cost_proportional: float = 1.0
    """With cost_limit: proportional gain of the controller of the cost multiplier."""
    cost_integral: float = 0.05
    """With cost_limit: integral gain per update, as a share of the largest multiplier, where the cost is far too high."""
    cost_derivative: float = 0.5
    """With cost_limit: derivative gain per update, applied while the cost is rising."""
    cost_multiplier_max: float = 0.5
    """With cost_limit: largest multiplier, which the gains above are shares of. It says how many standard deviations of the
    return (normalize_reward) a step just above the comfort limit costs; if it is too large, the task may be given up."""
    cost_margin: float = 0.0
    """With cost_limit: fraction of the comfort limit below it from which a step costs something, rising to 1 at the limit, so
    that forces just below the limit are avoided too."""
    cost_tighten_from: float = 0.35
    """With cost_limit: fraction of the run after which the limit, initially unbounded, tightens; the task is learned first."""
    cost_tighten_until: float = 0.7
    """With cost_limit: fraction of the run after which the limit equals cost_limit."""

    policy_hidden: tuple[int, ...] = (64, 64)
    """Sizes of the policy's hidden layers."""
    value_hidden: tuple[int, ...] = (128, 128)
    """Sizes of the value function's hidden layers."""
    activation: Literal["tanh", "swish", "elu", "relu"] = "tanh"
    """Activation function of both networks."""
    value_layer_norm: bool = True
    """Normalise the outputs of each hidden layer of the value function to mean 0 and deviation 1 (layer normalisation, with learned
    scales and shifts)."""
    distribution: Literal["normal", "tanh_normal"] = "tanh_normal"
    """Action distribution: a tanh-squashed Gaussian whose standard deviation depends on the observation, or a Gaussian
    clipped to [-1, 1] whose standard deviation is a separate parameter ("normal", as in Assistive Gym)."""
    clip_actions: bool = True
    """Clip sampled actions of "normal" to [-1, 1] before the environments take them. Assistive Gym's trainer does not, and its reward
    penalises what lies beyond: policies then act more smoothly, but succeed less often in ArmManipulation."""
    init_noise_std: float = 1.0
    """Initial standard deviation of "normal"."""
    noise_floor: float = 0.0
    """Smallest standard deviation of "normal" in the first half of the run, decaying to zero afterwards: exploration has to
    continue until rare successes are found. With --robot-policy, which can do the task already, 0 by default."""
    noise_ceiling: float = 0.0
    """Largest standard deviation of "normal" at the end of the run, decreasing to it from 1 by equal factors; 0 = no bound.
    Policies are evaluated without noise; with this they learn to act without it."""
    noise_ceiling_from: float = 0.0
    """With noise_ceiling: fraction of the run from which the bound decreases; until then, it is 1."""
    policy_head_gain: float = 0.01
    """Gain of the initial weights of the policy's last layer (Assistive Gym: 1)."""

    robot_policy: str | None = None
    """Policy from which the robot's training starts: a file, an id, or "shipped" for the policy included for the environment (of
    coop: for its passive person, unless --human-policy is shipped, too)."""
    value_warm_up: float | None = None
    """Fraction of the run in which only the value functions learn, so that a policy that can do the task already is not
    spoiled by value functions that know nothing yet. None: 0.05 if training starts from a policy, otherwise 0."""

    log_interval: Count = 0
    """Updates between log lines; 0 = about 80 lines per run."""
    save_interval: Count = 0
    """Updates between checkpoints, rounded up to a log line; 0 = about 10 per run, and at least one per minute."""
    logger: tuple[Literal["tensorboard", "wandb", "trackio"], ...] = ()
    """Further destinations for hyperparameters and learning curves; each requires the extra of the same name."""
    fresh: bool = False
    """Start over, moving the results of an earlier run aside instead of continuing it."""

    def __post_init__(self) -> None:
        """Reject values that can never work.

        Raises:
            ConfigError: if a value is invalid; the message names the field, its value and what is allowed.
        """
        for name in COUNTS:
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
        for name in ("noise_floor", "noise_ceiling"):
            if getattr(self, name) and self.distribution != "normal":
                raise ConfigError(
                    f"{name} ({getattr(self, name):g}, perhaps by default) bounds the deviation of --distribution normal; "
                    f"{self.distribution} has no such parameter. Add --{name.replace('_', '-')} 0."
                )
        if self.noise_ceiling > 1 or self.noise_ceiling_from == 1:
            raise ConfigError(
                f"noise_ceiling must be at most 1 and noise_ceiling_from less than 1, got {self.noise_ceiling}, {self.noise_ceiling_from}."
            )
        check_save_dir(self.save_dir)
        for name in SHARES:
            value = getattr(self, name)
            if value is not None and not 0 <= value <= 1:
                raise ConfigError(f"{name} must be between 0 and 1, got {value}.")
        for name in NOT_NEGATIVE:
            value = getattr(self, name)
            if value is not None and not 0 <= value < math.inf:
                raise ConfigError(f"{name} must be at least 0 and finite, got {value}.")
        if self.num_env_steps > MAX_ENV_STEPS:
            steps = self.num_env_steps
            raise ConfigError(f"num_env_steps must be at most {MAX_ENV_STEPS}, got {steps}.")


@dataclass(frozen=True)
class PPOConfig(LearnConfig):
    """Settings of ``train.ppo``."""

    allow_joint_observation: bool = False
    """Train a single policy for robot and person, which gives the robot access to the person's observation."""

    def __post_init__(self) -> None:
        """Reject values that can never work.

        Raises:
            ConfigError: as for ``LearnConfig``; or if a robot's policy is to be the start of one for robot and person.
        """
        super().__post_init__()
        if self.robot_policy is not None and self.allow_joint_observation:
            raise ConfigError(
                "--robot-policy is a policy of the robot alone, and --allow-joint-observation trains one policy for robot and "
                "person. Leave one of them out, or use agym-jax coop."
            )


@dataclass(frozen=True)
class CoopConfig(LearnConfig):
    """Settings of ``train.coop``."""

    env_name: str = "ScratchItchJacoHuman-v0"
    """Environment id with an active person."""
    central_critic: bool = False
    """Give the value functions both observations (the policies never receive both)."""
    freeze_robot: bool = False
    """Do not train --robot-policy; it acts by the mode of its distribution."""
    human_policy: str | None = None
    """Policy from which the person's training starts: a file, an id, or "shipped" for that of the included pair."""
    freeze_human: bool = False
    """Do not train --human-policy; it acts by the mode of its distribution."""

    def __post_init__(self) -> None:
        """Reject values that can never work.

        Raises:
            ConfigError: as for ``LearnConfig``; or if there is no policy to freeze, or no policy left to train.
        """
        super().__post_init__()
        for agent in ("robot", "human"):
            if getattr(self, f"freeze_{agent}") and getattr(self, f"{agent}_policy") is None:
                raise ConfigError(
                    f"--freeze-{agent} keeps a policy as it is, so it needs --{agent}-policy FILE."
                )
        if self.freeze_robot and self.freeze_human:
            raise ConfigError(
                "--freeze-robot with --freeze-human leaves nothing to train. Use one of them, or "
                "agym-jax evaluate to measure the two policies."
            )


Config = TypeVar("Config", PPOConfig, CoopConfig)

NUM_ENVS = {"cpu": 64, "gpu": 1024, "tpu": 1024}
"""Default number of environments by kind of device."""
LEAST_RECOMPUTED = 10_000
"""Samples per update from which advantages are recomputed before every pass."""
LEAST_SAMPLES = 80
"""Smallest mini-batch, if ``num_mini_batch`` would divide a small batch into smaller ones."""


def config_for(
    env_name: str,
    kind: type[Config] = PPOConfig,
    platform: str = "gpu",
    continues: bool = False,
) -> Config:
    """Return the default settings of an environment: the base with the changes of its task and, on a CPU, of CPUs.

    Args:
        env_name: environment id, such as ``"ScratchItchJaco-v0"``; an id of an unknown task gets the base settings.
        kind: class of the settings.
        platform: JAX's name of the device kind: "cpu", "gpu", "tpu".
        continues: whether training starts from a policy, which need not find out what succeeds.
    """
    changes = entry_of(TASK_CHANGES, env_name, {})
    if kind is PPOConfig and platform != "cpu" and not continues and "Human" not in env_name:
        changes = changes | entry_of(SEARCH_CHANGES, env_name, {})
        changes = changes | {"num_env_steps": entry_of(STEPS, env_name, kind.num_env_steps)}
    changes = changes | (entry_of(CPU_CHANGES, env_name, {}) if platform == "cpu" else {})
    changes = changes | (dict.fromkeys(NOISE_BOUNDS, 0.0) if continues else {})
    return dataclasses.replace(kind(), env_name=env_name, task=task_config(env_name), **changes)


def entry_of(table: dict[str, Any], env_name: str, otherwise: Any) -> Any:
    """Return the entry with the longest key that is a prefix of the environment id."""
    keys = [key for key in table if plain_id(env_name).startswith(key)]
    return table[max(keys, key=len)] if keys else otherwise


def parse_arguments(
    arguments: Sequence[str],
    kind: type[Config] = PPOConfig,
    prog: str | None = None,
    platform: str = "gpu",
) -> Config:
    """Parse settings; defaults depend on the device kind, and on the environment and the policy to start from that they name."""
    does = {
        PPOConfig: "Train a robot policy with PPO.",
        CoopConfig: "Train a robot policy and a person policy together, with a common reward.",
    }[kind]
    named = [word.partition("=")[0].replace("_", "-") for word in arguments]
    return tyro.cli(
        kind,
        prog=prog,
        description=f"{does} Rerunning the same command resumes an interrupted run. Defaults and --task flags below are "
        f"those of the environment named by --env-name ({kind.env_name} if it is left out); add --env-name ID before "
        f"--help to see those of another one.",
        args=list(arguments),
        default=config_for(
            env_name_in(arguments, kind.env_name), kind, platform, "--robot-policy" in named
        ),
    )


def resolve(config: Config, platform: str, devices: int = 1) -> Config:
    """Fill in the settings that depend on the machine.

    Args:
        config: settings, with 0 meaning automatic.
        platform: JAX's name of the device kind: "cpu", "gpu", "tpu".
        devices: number of devices among which the environments are divided.

    Returns:
        Settings without a 0 in ``devices``, ``num_envs``, ``log_interval``; ``save_interval`` is a multiple of ``log_interval``.

    Raises:
        ConfigError: if the environments cannot be divided evenly among the devices, or the data of an update into
            mini-batches.
    """
    num_envs = config.num_envs or NUM_ENVS.get(platform, NUM_ENVS["gpu"])
    if num_envs % devices:
        raise ConfigError(
            f"{num_envs} environments cannot be divided evenly among {devices} devices. Nearest number that can: "
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
    config = dataclasses.replace(config, value_warm_up=value_warm_up(config))
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
    """Return the number of updates of ``batch`` steps needed for at least ``num_env_steps``."""
    return math.ceil(num_env_steps / batch)
