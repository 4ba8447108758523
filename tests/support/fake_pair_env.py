"""Two carts that have to carry something far enough: what neither can do alone; compiles in no time.

Cart and cart reach 0.5 each, the goal lies 0.7 to 1.0 away. With ``active=False`` the second stands
still and the goal is near.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from types import SimpleNamespace

import jax
import jax.numpy as jnp
from fake_env import FakeEnv, FakeState

from agym_jax import observe
from agym_jax.observe import column


@observe.observation
class RobotSees:
    """What the robot sees."""

    cart: jax.Array = column(1, "m", "world", "")
    goal: jax.Array = column(1, "m", "world", "")


@observe.observation
class HumanSees:
    """What the person sees, who is told nothing of the goal but the way that is left."""

    cart: jax.Array = column(1, "m", "world", "")
    speed: jax.Array = column(1, "m/s", "world", "")
    left: jax.Array = column(1, "m", "world", "")


@dataclass
class FakePairEnv(FakeEnv):
    """One environment: the sum of two positions has to reach a goal."""

    active: bool = True
    task_name: str = "FakeCarry"
    task: SimpleNamespace = field(
        default_factory=lambda: SimpleNamespace(robot_obs=RobotSees, human_obs=HumanSees)
    )

    def __post_init__(self) -> None:
        records = list(self.observation_records.values())
        self.name = f"{self.task_name}{'Human' if self.active else ''}-v0"
        self.layout_version = observe.layout_version(*records)
        self.action_sizes = {"robot": 1, "human": 1} if self.active else {"robot": 1}
        self.observation_sizes = {"robot": 2, "human": 3} if self.active else {"robot": 2}

    @property
    def observation_records(self) -> dict[str, type]:
        """Record of each agent's observation."""
        human = {"human": self.task.human_obs} if self.active else {}
        return {"robot": self.task.robot_obs, **human}

    @property
    def observation_size(self) -> int:
        """Entries of an observation, all agents."""
        return sum(self.observation_sizes.values())

    def _observed(self, position: jax.Array, target: jax.Array, speed: jax.Array) -> jax.Array:
        robot = jnp.array([position[0], target[0]])
        human = jnp.array([position[1], speed, target[0] - position.sum()])
        return jnp.concatenate([robot, human]) if self.active else robot

    def _first(self, key: jax.Array) -> FakeState:
        key, key_far, key_side = jax.random.split(key, 3)
        low, high = (0.7, 1.0) if self.active else (0.2, 0.5)
        far = jax.random.uniform(key_far, (), minval=low, maxval=high)
        goal = jnp.where(jax.random.bernoulli(key_side), far, -far)
        first = super()._first(key)
        target = jnp.array([goal, 0.0])
        obs = self._observed(first.position, target, jnp.zeros(()))
        return first.replace(target=target, obs=obs)

    def step(self, state: FakeState, action: jax.Array) -> FakeState:
        """Move both by 0.1 x their action, within their reach."""
        self.traces["step"] += 1
        moves = jnp.zeros(2).at[: self.action_size].set(0.1 * jnp.clip(action, -1, 1))
        position = jnp.clip(state.position + moves, -0.5, 0.5)
        left = jnp.abs(state.target[0] - position.sum())
        time = state.time + 1
        zero = jnp.zeros(())
        metrics = {
            "reward/distance": -left,
            "force/on_human": zero,
            "success": (left < 0.1).astype(jnp.float32),
            "nan": zero,
            "overflow": zero,
        }
        return state.replace(
            position=position,
            time=time,
            obs=self._observed(position, state.target, moves[1]),
            reward=-left,
            done=(time >= self.episode_length).astype(jnp.float32),
            metrics=metrics,
        )
