"""Two learners: the robot and the person, each with a policy, value, optimiser and statistics.

They share the environments, the random key's tree and the reward, nothing else. A policy reads its own
columns of the observation. The value functions read, in training, what nobody observes besides, and
with a central critic the other's columns too.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from brax.training.types import UInt64

from agym_jax.policy.agents import Part, parts
from agym_jax.policy.check import check_policy
from agym_jax.policy.networks import Architecture, make_networks, mode_action, sample_action
from agym_jax.policy.policy import Policy, read_policy

from ..configs import CoopConfig
from ..runs.checkpoint import tree_to_arrays
from .algorithm import policy_of, privileged_obs_size, shape_of
from .ppo import LOSSES, LearnerState, architecture, batch_steps, init_learner, learn
from .rollout import Batch

AGENTS = ("robot", "human")


@dataclass(frozen=True)
class Agent:
    """One of the two.

    Attributes:
        name: "robot" or "person".
        part: what it sees and moves.
        arch: its networks.
        critic_columns: columns that its value function reads, of the whole observation and what is hidden.
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
    def value_size(self) -> int | None:
        """How many columns its value function reads; None if just its own."""
        own = tuple(range(self.part.observed.start, self.part.observed.stop))
        return None if self.critic_columns == own else len(self.critic_columns)

    @property
    def networks(self) -> Any:
        """From ``make_networks``."""
        return make_networks(self.arch, self.value_size)

    def view(self, batch: Batch) -> Batch:
        """What it learns from: its own columns, and what its value function reads."""
        all_obs = batch.obs if batch.value_obs is None else batch.value_obs
        return replace(
            batch,
            obs=batch.obs[..., self.part.observed],
            raw_action=batch.raw_action[..., self.part.acted],
            log_prob=batch.log_prob[self.name],
            final_observation=self.of(batch.final_observation),
            value_obs=None if self.value_size is None else self.of(all_obs),
        )

    def of(self, all_obs: jax.Array) -> jax.Array:
        """The columns that its value function reads."""
        return all_obs[..., np.array(self.critic_columns)]


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class TeamState:
    """All that learning needs to go on; exactly this is saved in a checkpoint."""

    members: dict[str, LearnerState]  # by agent; their own keys lie idle
    key: jax.Array

    @property
    def env_steps(self) -> jax.Array:
        """Environment steps so far    ()."""
        return self.members["robot"].env_steps


def make_agent(config: CoopConfig, env: Any, name: str) -> Agent:
    """One agent as a configuration wants it.

    Raises:
        PolicyNotFoundError: there is no such file to start from.
        PolicyEnvironmentError: its policy is of another task, robot or agent.
        PolicyLayoutError: its policy reads another observation layout.
    """
    part = parts(env)[name]
    arch = architecture(config, *part.sizes)
    path = getattr(config, f"{name}_policy")
    start = None if path is None else read_policy(path)
    if start is not None:
        check_policy(start, env, path, agent=name)
        arch = replace(start.arch, value_hidden=arch.value_hidden)
    whole, size = range(env.observation_size), env.observation_size
    critic_columns = (
        *(whole if config.central_critic else whole[part.observed]),
        *range(size, size + privileged_obs_size(config, env)),
    )
    return Agent(name, part, arch, critic_columns, start, getattr(config, f"freeze_{name}"))


def start_from(learner: LearnerState, policy: Policy) -> LearnerState:
    """A new learner that acts, and has seen observations, as a policy did."""
    count = max(1, int(policy.info.get("env_steps", 1)))
    normalizer: Any = learner.normalizer
    normalizer = normalizer.replace(
        count=UInt64(hi=jnp.uint32(0), lo=jnp.uint32(count)),
        mean=policy.mean,
        summed_variance=policy.std**2 * count,
        std=policy.std,
    )
    params: Any = learner.params
    return replace(learner, params=params.replace(policy=policy.weights), normalizer=normalizer)


def fingerprint(policy: Policy) -> str:
    """Short hash of what decides a policy's actions."""
    arrays = tree_to_arrays([policy.weights, policy.mean, policy.std])
    content = b"".join(name.encode() + np.asarray(a).tobytes() for name, a in arrays.items())
    return hashlib.sha256(content).hexdigest()[:12]


class TwoLearners:
    """PPO of both agents at once; see ``train.learning.algorithm.Algorithm``.

    Args:
        config: resolved settings.
        env: an environment in which both act.
    """

    trainer = "coop"

    def __init__(self, config: CoopConfig, env: Any) -> None:
        self.config = config
        self.agents = [make_agent(config, env, name) for name in AGENTS]
        learning = [agent.name for agent in self.agents if not agent.frozen]
        self.losses = tuple(f"{name}/{loss}" for name in learning for loss in LOSSES)

    def init(self, key: jax.Array) -> TeamState:
        """Two learners that have seen nothing, but for the policies that they start from."""
        key, *keys = jax.random.split(key, 1 + len(self.agents))
        members = {}
        for agent, key_agent in zip(self.agents, keys, strict=True):
            member = init_learner(self.config, agent.arch, key_agent, agent.value_size)
            members[agent.name] = start_from(member, agent.start) if agent.start else member
        return TeamState(members, key)

    def act(
        self, learner: TeamState, obs: jax.Array, key: jax.Array
    ) -> tuple[jax.Array, jax.Array, dict[str, jax.Array]]:
        """Each acts by what it sees itself; a frozen one by the mode of its distribution."""
        actions, raws, log_probs = [], [], {}
        for agent, key_agent in zip(self.agents, jax.random.split(key), strict=True):
            member, own = learner.members[agent.name], obs[..., agent.part.observed]
            known = (agent.networks, member.normalizer, member.params.policy, own)
            if agent.frozen:
                action = raw = mode_action(*known)
                log_prob = jnp.zeros(own.shape[:-1])
            else:
                action, raw, log_prob = sample_action(*known, key_agent)
            actions.append(action)
            raws.append(raw)
            log_probs[agent.name] = log_prob
        return jnp.concatenate(actions, -1), jnp.concatenate(raws, -1), log_probs

    def learn(
        self,
        learner: TeamState,
        batch: Batch,
        last: jax.Array,
        key: jax.Array,
        total_steps: jax.Array,
        axis: str | None = None,
    ) -> tuple[TeamState, dict[str, jax.Array]]:
        """One update of each who learns."""
        members, losses = {}, {}
        for agent, key_agent in zip(self.agents, jax.random.split(key), strict=True):
            member = learner.members[agent.name]
            if agent.frozen:
                steps = member.env_steps + jnp.uint32(batch_steps(batch, axis))
                members[agent.name] = replace(member, env_steps=steps)
                continue
            members[agent.name], scalars = learn(
                member,
                agent.view(batch),
                agent.of(last),
                key_agent,
                self.config,
                agent.networks,
                total_steps,
                axis,
            )
            losses |= {f"{agent.name}/{name}": value for name, value in scalars.items()}
        return replace(learner, members=members), losses

    def policies(self, learner: TeamState, info: Mapping[str, Any]) -> dict[str, Policy]:
        """The present policies; a frozen one as it came."""
        found = {}
        for agent in self.agents:
            about = {**info, "agent": agent.name, "layout": agent.part.layout}
            member = learner.members[agent.name]
            frozen = agent.start if agent.frozen else None
            found[agent.name] = frozen or policy_of(member, agent.arch, about)
        return found

    def belongs(self) -> dict[str, Any]:
        """What a checkpoint must agree in: networks, the critic, and what is frozen."""
        agreed: dict[str, Any] = {"central_critic": self.config.central_critic}
        for agent in self.agents:
            agreed[f"{agent.name}.value_size"] = agent.value_size
            agreed |= {f"{agent.name}.{k}": v for k, v in shape_of(agent.arch).items()}
            kept = fingerprint(agent.start) if agent.frozen and agent.start else None
            agreed[f"{agent.name}.frozen_policy"] = kept
        return agreed
