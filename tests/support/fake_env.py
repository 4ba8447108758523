"""A point that has to reach a target, in the environment contract of ``train``; compiles in no time.

``traces`` counts how often Python runs ``reset`` and ``step``, that is, how often they are traced.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import jax
import jax.numpy as jnp

XML = """
<mujoco>
  <worldbody>
    <light pos="0 0 3"/>
    <camera name="front" pos="0 0 4"/>
    <body>
      <joint type="slide" axis="1 0 0"/>
      <joint type="slide" axis="0 1 0"/>
      <geom type="sphere" size="0.1" rgba="0.2 0.4 0.9 1"/>
    </body>
  </worldbody>
</mujoco>
"""


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class FakeState:
    """State of one point, or of a batch of them."""

    position: jax.Array
    target: jax.Array
    time: jax.Array
    obs: jax.Array
    reward: jax.Array
    done: jax.Array
    metrics: dict[str, jax.Array]
    info: dict[str, Any]
    key: jax.Array
    privileged_obs: Any = None
    regions: Any = None

    def replace(self, **changes: Any) -> FakeState:
        """A copy with some fields changed."""
        return replace(self, **changes)


@dataclass
class FakeEnv:
    """One environment: a point at speed 0.2 towards a target in [-1, 1]^2."""

    name: str = "FakeReach-v0"
    episode_length: int = 20
    layout_version: str = "fake-1"
    action_sizes: dict[str, int] = field(default_factory=lambda: {"robot": 2})
    overflow: float = 0.0
    nan_at: int = -1
    privileged_obs_size: int = 0  # 1: value functions may see the clock
    traces: dict[str, int] = field(default_factory=lambda: {"reset": 0, "step": 0})

    observation_size = 4
    dt = 0.1

    @property
    def action_size(self) -> int:
        """Entries of an action, all agents."""
        return sum(self.action_sizes.values())

    def reset(self, key: jax.Array) -> FakeState:
        """First state of an episode."""
        self.traces["reset"] += 1
        return self._first(key)

    def _first(self, key: jax.Array) -> FakeState:
        key, key_target = jax.random.split(key)
        target = jax.random.uniform(key_target, (2,), minval=-1.0, maxval=1.0)
        position, zero = jnp.zeros(2), jnp.zeros(())
        names = ("reward/distance", "force/on_human", "success", "nan", "overflow")
        return FakeState(
            position=position,
            target=target,
            time=zero,
            obs=jnp.concatenate([position, target]),
            reward=zero,
            done=zero,
            metrics=dict.fromkeys(names, zero),
            info={},
            key=key,
        )

    def step(self, state: FakeState, action: jax.Array) -> FakeState:
        """Move the point by 0.2 x the first two entries of the action."""
        self.traces["step"] += 1
        position = state.position + 0.2 * jnp.clip(action[:2], -1, 1)
        dist = jnp.linalg.norm(position - state.target)
        time = state.time + 1
        nan = (time == self.nan_at).astype(jnp.float32)
        done = jnp.maximum((time >= self.episode_length).astype(jnp.float32), nan)
        metrics = {
            "reward/distance": -dist,
            "force/on_human": 2.0 * dist,
            "success": (dist < 0.1).astype(jnp.float32),
            "nan": nan,
            "overflow": jnp.asarray(self.overflow, jnp.float32),
        }
        obs = jnp.concatenate([position, state.target])
        return state.replace(
            position=position, time=time, obs=obs, reward=-dist, done=done, metrics=metrics
        )

    def to_mujoco(self, state: FakeState, visuals: str = "primitives") -> tuple[Any, Any]:
        """A ball in front of a camera."""
        import mujoco

        model = mujoco.MjModel.from_xml_string(XML)
        data = mujoco.MjData(model)
        self.write_mujoco(state, data, model)
        return model, data

    def write_mujoco(self, state: FakeState, data: Any, model: Any) -> None:
        """Put the ball where the point is."""
        import mujoco

        data.qpos[:2] = state.position
        mujoco.mj_forward(model, data)

    def markers(self, state: FakeState) -> list[Any]:
        """The target."""
        from agym_jax.rendering.raycast import Marker

        return [Marker((*map(float, state.target), 0.0), 0.05)]

    def vectorize(self, num_envs: int) -> FakeVectorEnv:
        """The batched, auto-resetting environment."""
        return FakeVectorEnv(self, num_envs)


@dataclass
class FakeVectorEnv:
    """B points; a finished one starts over and shows its last observation in ``info``."""

    env: FakeEnv
    num_envs: int

    @property
    def observation_size(self) -> int:
        """Entries of an observation."""
        return self.env.observation_size

    @property
    def action_size(self) -> int:
        """Entries of an action."""
        return self.env.action_size

    def reset(self, key: jax.Array) -> FakeState:
        """First states."""
        keys = jax.random.split(key, self.num_envs) if key.ndim == 1 else key
        state = jax.vmap(self.env.reset)(keys)
        return self._observed(state, state, jnp.zeros(self.num_envs))

    def _observed(self, state: FakeState, last: FakeState, truncation: jax.Array) -> FakeState:
        """The state with what belongs to the end of a step; the clock only if it is privileged."""
        info = {"truncation": truncation, "final_observation": last.obs}
        if not self.env.privileged_obs_size:
            return state.replace(info=info)
        clock = lambda s: s.time[:, None] / self.env.episode_length  # noqa: E731
        info["final_privileged_obs"] = clock(last)
        return state.replace(info=info, privileged_obs=clock(state))

    def stagger(self, state: FakeState, key: jax.Array) -> FakeState:
        """Spread the environments over the phases of an episode."""
        keys = key.reshape(-1, 2)  # one, or that of each seed
        draw = lambda key: jax.random.randint(  # noqa: E731
            key, (self.num_envs // len(keys),), 0, self.env.episode_length
        )
        time = draw(key) if key.ndim == 1 else jax.vmap(draw)(keys).reshape(-1)
        return state.replace(time=time.astype(jnp.float32))

    def step(self, state: FakeState, action: jax.Array) -> FakeState:
        """One step of all points."""
        assert action.shape == (self.num_envs, self.action_size)
        bare = state.replace(info={}, privileged_obs=None)
        after = jax.vmap(self.env.step)(bare, action)
        first = jax.vmap(self.env._first)(after.key)
        kept = {"reward": after.reward, "done": after.done, "metrics": after.metrics}

        def choose(where: jax.Array, new: Any, old: Any) -> Any:
            shaped = lambda x: where.reshape(-1, *[1] * (x.ndim - 1)) > 0  # noqa: E731
            return jax.tree.map(lambda x, y: jnp.where(shaped(x), x, y), new, old)

        truncation = jnp.where(after.done > 0, 1.0, 0.0)  # weakly typed, as an environment's may be
        last = choose(after.metrics["nan"], bare, after)  # what was seen before a divergence
        state = choose(after.done, first, after).replace(**kept)
        return self._observed(state, last, truncation)
