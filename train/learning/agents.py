"""Who learns: one agent that sees and moves all there is, or robot and human side by side.

Several agents share the environments, the random key's tree and the reward, nothing else: each has a policy, value
function, optimiser and statistics of its own. A policy reads its own columns of the observation. The value
functions read, in training, what is privileged besides, and with a central critic the others' columns too.

DEVIATION(clipped-actions): sampled actions are clipped to [-1, 1] before the environments take them, so that the penalty of an action
ends there in training; AG's trainer passes them on as they are (``--no-clip-actions``). Where the entropy bonus makes the noise
large, policies learn to act at the bounds: after 8 M steps of ArmManipulation without clipping, the interquartile mean of the return
of eight seeds is -129 instead of -150 (Baxter) and -111 instead of -127 (Jaco), 7 % of the entries of actions are at the bounds, in
the policies that ship 65 to 96 %, but the interquartile mean of success is 61 instead of 67 % and 34 instead of 53 %, and the
chosen seeds succeed in 1 and 4 of 20 episodes of AG (those that ship in 25 and 36 of 40).
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from agym_jax.errors import PolicyNotFoundError
from agym_jax.memory import MEMORY
from agym_jax.policy.agents import Part, parts
from agym_jax.policy.check import check_policy
from agym_jax.policy.files import find_policies, find_policy
from agym_jax.policy.networks import Architecture, make_networks, mode_action, sample_action
from agym_jax.policy.policy import Policy, read_policy, shipped
from agym_jax.registry import active_id, static_id
from agym_jax.wrappers import shared_reset_interval

from ..configs import LearnConfig
from .constraint import COST_LOSSES, SHARED
from .ppo import (
    LOSSES,
    AgentState,
    Hyper,
    architecture,
    batch_steps,
    init_agent,
    learn,
)
from .rollout import Batch

SHIPPED = "shipped"  # in place of a file or an id to start from: the policy that ships for the environment
STARTING = ("init_noise_std", "policy_head_gain")  # of an architecture; matter at the start only


@dataclass(frozen=True)
class Agent:
    """One of those who act.

    Attributes:
        name: "robot", "human", or "joint" for one policy that moves both.
        part: what it sees and moves.
        arch: its networks.
        critic_columns: columns that its value function reads, of the whole observation and what is privileged.
        start: the policy that it begins with; None = a new one.
        frozen: whether it stays at that.
    """

    name: str
    part: Part
    arch: Architecture
    critic_columns: tuple[int, ...]
    start: Policy | None
    frozen: bool

    @property
    def critic_size(self) -> int | None:
        """How many columns its value function reads; None if just its own."""
        own = tuple(range(self.part.observed.start, self.part.observed.stop))
        return None if self.critic_columns == own else len(self.critic_columns)

    @property
    def networks(self) -> Any:
        """From ``make_networks``."""
        return make_networks(self.arch, self.critic_size)

    def view(self, batch: Batch) -> Batch:
        """What it learns from: its own columns, and what its value function reads."""
        read = None if self.critic_size is None else self.critic_view(batch.critic_obs)
        return replace(
            batch,
            obs=batch.obs[..., self.part.observed],
            raw_action=batch.raw_action[..., self.part.acted],
            log_prob=batch.log_prob[self.name],
            final_critic_obs=self.critic_view(batch.final_critic_obs),
            critic_obs=read,
        )

    def critic_view(self, all_obs: Any) -> jax.Array:
        """The columns that its value function reads (..., critic observation)."""
        first, last = self.critic_columns[0], self.critic_columns[-1]
        if len(self.critic_columns) == last + 1 - first:
            return all_obs[..., first : last + 1]
        return all_obs[..., np.array(self.critic_columns)]


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class LearnerState:
    """All that learning needs to go on; exactly this is saved in a checkpoint."""

    agents: dict[str, AgentState]
    key: jax.Array

    @property
    def env_steps(self) -> jax.Array:
        """Environment steps so far    ()."""
        return next(iter(self.agents.values())).env_steps


class Agents:
    """PPO of one or several agents: pure functions of a ``LearnerState``.

    Args:
        config: resolved settings.
        env: says how large observations and actions are, and who acts.
        names: of the agents, in the order of their actions.

    Attributes:
        trainer: the command that trains so, as in files and messages.
        losses: names of the scalars that ``learn`` returns.
        episode_length: control steps of an episode.
        truncated_every: control steps between two truncations of an environment by length; None if that is not known.
        axes: the leading axes of the learner: none, see ``train.learning.seeds``.

    Raises:
        PolicyNotFoundError: there is no such file to start from.
        PolicyEnvironmentError: its policy is of another task, robot or agent.
        PolicyLayoutError: its policy reads another observation layout.
    """

    def __init__(self, config: LearnConfig, env: Any, names: tuple[str, ...]) -> None:
        self.config = config
        self.agents = [_make_agent(config, env, name) for name in names]
        self.trainer = "ppo" if len(names) == 1 else "coop"
        learning = [agent.name for agent in self.agents if not agent.frozen]
        self.constrained = config.cost_limit is not None
        scalars = (*LOSSES, *(COST_LOSSES if self.constrained else ()))
        losses = (self._loss(name, loss) for name in learning for loss in scalars)
        self.losses, self.episode_length = tuple(dict.fromkeys(losses)), env.episode_length
        # a batch of the environment's own may truncate whenever it wants, and a restarted episode ends sooner
        length = env.episode_length
        # (twice in an interval, if the one that it continues began anew after a divergence)
        every = shared_reset_interval(length) // 2 if config.restart_share else length
        self.truncated_every = None if hasattr(env, "vectorize") else every
        self.axes: tuple[int, ...] = ()

    def init(self, key: jax.Array) -> LearnerState:
        """Agents that have seen nothing, but for the policies that they start from."""
        key, *keys = self._split(key, 1)
        states = {}
        for agent, key_agent in zip(self.agents, keys or [key], strict=True):
            constrained = self.constrained and not agent.frozen
            state, rest = init_agent(agent.arch, key_agent, agent.critic_size, constrained)
            states[agent.name] = _start_from(state, agent.start) if agent.start else state
            key = key if keys else rest
        return LearnerState(states, key)

    def act(
        self, learner: LearnerState, obs: jax.Array, key: jax.Array
    ) -> tuple[jax.Array, jax.Array, dict[str, jax.Array]]:
        """Actions, raw samples and log-probabilities by agent, for observations (B, observation).

        Each acts by what it sees itself; a frozen one by the mode of its distribution.
        """
        actions, raws, log_probs = [], [], {}
        for agent, key_agent in zip(self.agents, self._split(key), strict=True):
            state, own = learner.agents[agent.name], obs[..., agent.part.observed]
            known = (agent.networks, state.normalizer, state.params.policy, own)
            if agent.frozen:
                action = raw = mode_action(*known)
                log_prob = jnp.zeros(own.shape[:-1])
            else:
                action, raw, log_prob = sample_action(*known, key_agent)
                action = jnp.clip(action, -1.0, 1.0) if self.config.clip_actions else action
            actions.append(action)
            raws.append(raw)
            log_probs[agent.name] = log_prob
        return jnp.concatenate(actions, -1), jnp.concatenate(raws, -1), log_probs

    def learn(
        self,
        learner: LearnerState,
        batch: Batch,
        last: jax.Array,
        key: jax.Array,
        hyper: Hyper,
        axis: str | None = None,
    ) -> tuple[LearnerState, dict[str, jax.Array]]:
        """One update of each agent that learns.

        A policy that training starts from keeps the statistics of the observation with which it has learned to act: with others,
        the same weights are another policy.

        Args:
            learner: before it.
            batch: as collected.
            last: ``train.learning.rollout.critic_obs`` of the environments after it    (B, all).
            key: random key.
            hyper: hyper-parameters.
            axis: name of the axis of devices that each have a part of the batch.
        """
        states, losses = {}, {}
        for agent, key_agent in zip(self.agents, self._split(key), strict=True):
            state = learner.agents[agent.name]
            if agent.frozen:
                steps = state.env_steps + jnp.uint32(batch_steps(batch, axis))
                states[agent.name] = replace(state, env_steps=steps)
                continue
            states[agent.name], scalars = learn(
                state,
                agent.view(batch),
                agent.critic_view(last),
                key_agent,
                hyper,
                self.config,
                agent.networks,
                axis,
                self.truncated_every,
            )
            if agent.start:
                states[agent.name] = replace(states[agent.name], normalizer=state.normalizer)
            losses |= {self._loss(agent.name, name): value for name, value in scalars.items()}
        return replace(learner, agents=states), losses

    def hyper(self, total_steps: float) -> Hyper:
        """The hyper-parameters of a run of so many environment steps."""
        return Hyper.of(self.config, total_steps, self.episode_length)

    def of_seeds(self, learner: LearnerState) -> list[LearnerState]:
        """The learner of each seed: here of the only one."""
        return [learner]

    def policies(self, learner: LearnerState, info: Mapping[str, Any]) -> dict[str, Policy]:
        """The present policies by agent; a frozen one as it came.

        Args:
            learner: state.
            info: what their files tell of the run.
        """
        found = {}
        for agent in self.agents:
            state, frozen = learner.agents[agent.name], agent.start if agent.frozen else None
            about = {**info, "agent": agent.name, "layout": agent.part.layout}
            about["env_steps"] = int(state.env_steps)
            mean, std = jnp.asarray(state.normalizer.mean), jnp.asarray(state.normalizer.std)
            policy = Policy(state.params.policy, mean, std, agent.arch, about)
            found[agent.name] = frozen or policy
        return found

    def compatibility(self) -> dict[str, Any]:
        """Name -> value of what a checkpoint must agree in, besides the environment, for JSON."""
        agreed: dict[str, Any] = {"central_critic": getattr(self.config, "central_critic", False)}
        agreed["constrained"] = self.constrained or None  # older checkpoints do not tell
        for agent in self.agents:
            agreed[f"{agent.name}.critic_size"] = agent.critic_size
            for name, value in vars(agent.arch).items():
                if name not in STARTING:
                    kept = list(value) if isinstance(value, tuple) else value
                    agreed[f"{agent.name}.{name}"] = kept
            start = agent.start if agent.frozen else None
            agreed[f"{agent.name}.frozen_policy"] = start and fingerprint(start)
        return agreed

    def _split(self, key: jax.Array, more: int = 0) -> Any:
        """A key for each agent, and ``more``; a single agent has the key itself."""
        count = len(self.agents)
        return [key] if count == 1 else jax.random.split(key, count + more)

    def _loss(self, agent: str, name: str) -> str:
        """Name of a loss in the curve; what is the same for all agents has no agent in it."""
        return name if len(self.agents) == 1 or name in SHARED else f"{agent}/{name}"


def _make_agent(config: LearnConfig, env: Any, name: str) -> Agent:
    """One agent as a configuration wants it."""
    part = parts(env)[name]
    arch = architecture(config, *part.sizes)
    path = getattr(config, f"{name}_policy", None)
    frozen = getattr(config, f"freeze_{name}", False)
    start = None
    if path is not None:
        path = _starting_file(config, env, name, path)
        start = read_policy(path)
        check_policy(start, env, path, agent=name, other_people=True, other_settings=not frozen)
        arch = replace(
            start.arch, value_hidden=arch.value_hidden, value_layer_norm=arch.value_layer_norm
        )
    size = env.observation_size
    privileged = getattr(env, "privileged_obs_size", 0) if config.privileged_critic else 0
    central = getattr(config, "central_critic", False)
    own = range(size) if central else range(size)[part.observed]
    critic_columns = (*own, *range(size, size + privileged))
    return Agent(name, part, arch, critic_columns, start, frozen)


def _starting_file(config: LearnConfig, env: Any, name: str, path: str) -> str | Path:
    """The file of the policy that an agent begins with.

    A robot's "shipped" is the one for the person who keeps still, unless the person begins with the pair's.

    Raises:
        PolicyNotFoundError: there is none.
    """
    if path != SHIPPED and path not in shipped():
        return path
    of_pair = getattr(config, "human_policy", None) == SHIPPED
    env_name = env.name if of_pair else static_id(env.name)
    if path != SHIPPED:
        env_name = path
    memory = getattr(env, MEMORY, ())
    if name != "human":
        return find_policy(env_name, memory=memory)
    human = find_policies(env_name, memory=memory).human
    if human is None:
        raise PolicyNotFoundError(
            f"agym_jax ships no policy of a person for {env_name!r}. Use --human-policy {active_id(env_name)}, or a FILE."
        )
    return human


def _start_from(state: AgentState, policy: Policy) -> AgentState:
    """A new agent that acts, and has seen observations, as a policy did."""
    normalizer: Any = state.normalizer
    normalizer = normalizer.replace(mean=policy.mean, std=policy.std)
    params: Any = state.params
    return replace(state, params=params.replace(policy=policy.weights), normalizer=normalizer)


def fingerprint(policy: Policy) -> str:
    """Short hash of what decides a policy's actions."""
    leaves = jax.tree_util.tree_leaves_with_path([policy.weights, policy.mean, policy.std])
    names = [jax.tree_util.keystr(path, simple=True, separator="/") for path, _ in leaves]
    content = (
        name.encode() + np.asarray(x).tobytes() for name, (_, x) in zip(names, leaves, strict=True)
    )
    return hashlib.sha256(b"".join(content)).hexdigest()[:12]
