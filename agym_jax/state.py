"""The state of one environment: what ``reset`` returns and ``step`` maps to the next."""

from __future__ import annotations

import dataclasses
import warnings
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from agym_jax.data.banks import Placement
from agym_jax.errors import WrapperError
from agym_jax.human.body import BodyFields
from agym_jax.human.population import Human
from agym_jax.human.pose import BodyPose
from agym_jax.memory import Past
from agym_jax.variation import RobotDraw

_INSTEAD = "use wrap_env_fn=agym_jax.adapters.brax.wrap_for_brax_training"
SAME_HUMAN = (
    "Brax's AutoResetWrapper begins every episode of an environment with the same human, goal and start. For "
    f"others in each, {_INSTEAD}."
)
WARP_RESET = (
    "With impl='warp' there is no pipeline_state: environments share buffers, which Brax's AutoResetWrapper would mix "
    f"up. For training, {_INSTEAD}; for MuJoCo's fields, read state.data."
)


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Episode:
    """Everything that is drawn once per episode, and the episode's clock."""

    human: Human
    pose: BodyPose  # how the person sits or lies
    rows: BodyFields  # the person's part of the model, rows of the scene's links
    placement: Placement
    human_angles: jax.Array  # start angles of the moving joints [rad]        (n_person,)
    human_target: jax.Array  # what the muscles hold, without tremor [rad]    (n_person,)
    step: jax.Array  # control steps done, int32                               ()
    robot: RobotDraw | None = None  # how the robot is other than usual; None if it does not vary
    sent: jax.Array | None = None  # its actions under way, the newest first   (longest, n_arm)


MOVING = ("human_target", "step", "sent")
"""Fields of an episode that change with every step; the others stay as they were drawn."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class PipelineState:
    """Everything needed to continue an episode; Brax's ``AutoResetWrapper`` stores that of the first state and restores it.

    Attributes of ``data``, such as ``qpos``, are available on this object too.
    """

    data: Any  # mjx.Data
    task: Any  # the task's own pytree
    episode: Episode
    past: Past  # as last observed

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__") or name == "data":
            raise AttributeError(name)
        return getattr(self.data, name)


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class State:
    """State of one environment.

    It can be used like Brax's ``State``: it has ``obs``, ``reward``, ``done``, ``metrics``, ``info`` and ``replace``.
    """

    data: Any  # mjx.Data
    obs: jax.Array  # robot's columns, then the active person's               (n_obs,)
    reward: jax.Array  #                                                      ()
    done: jax.Array  # 1.0 when the episode is over                           ()
    metrics: dict[str, jax.Array]  # every reward term, forces, success, ...   each ()
    info: dict[str, Any]  # belongs to wrappers; see ``AssistiveEnv.step`` on Brax's
    task: Any  # the task's own pytree
    episode: Episode
    key: jax.Array
    privileged_obs: Any = None  # for value functions, else unseen; may be None (n_privileged,)
    past: Any = None  # what was observed before, see ``memory.Past``
    regions: Any = None  # forces on the person's body, see ``human.regions.RegionForces``

    def replace(self, **changes: Any) -> State:
        """Return a copy with some fields replaced; ``pipeline_state`` replaces every field that it contains."""
        whole = changes.pop("pipeline_state", None)
        if isinstance(whole, PipelineState):
            if "first_pipeline_state" in self.info:
                warnings.warn(SAME_HUMAN, stacklevel=2)
            changes = vars(whole) | changes
        elif whole is not None:
            changes["data"] = whole
        return dataclasses.replace(self, **changes)

    @property
    def pipeline_state(self) -> PipelineState:
        """Brax's name for the state of the simulation.

        Raises:
            WrapperError: if the physics is Warp, whose data must not be selected leaf by leaf.
        """
        if getattr(getattr(self.data, "impl", None), "value", None) == "warp":
            raise WrapperError(WARP_RESET)
        return PipelineState(self.data, self.task, self.episode, self.past)


def strong(tree: Any) -> Any:
    """Remove weak types, so that what ``reset`` and ``step`` return compiles only once."""
    return jax.tree.map(
        lambda x: jax.lax.convert_element_type(x, x.dtype) if getattr(x, "weak_type", False) else x,
        tree,
    )


def select(where: jax.Array, new: Any, old: Any) -> Any:
    """Select from two trees: the new one where ``where`` is true, otherwise the old one."""
    return jax.tree.map(lambda a, b: jnp.where(where, a, b), new, old)


def raw_key(key: jax.Array) -> jax.Array:
    """Convert a PRNG key, typed or raw, to a raw key (..., 2)."""
    typed = jax.dtypes.issubdtype(key.dtype, jax.dtypes.prng_key)
    return jax.random.key_data(key) if typed else key


def moved(state: State, fields: dict[str, Any]) -> State:
    """Return the state with the fields that a step has changed."""
    fields = dict(fields)
    clock = {name: fields.pop(name) for name in MOVING}
    metrics = {**state.metrics, **fields.pop("metrics")}
    episode = dataclasses.replace(state.episode, **clock)
    return last_seen(state, state.replace(episode=episode, metrics=metrics, **fields), np)


def last_seen(before: State, after: State, xp: Any = jnp) -> State:
    """Return the state after a step, with the observations before it where the simulation diverged: what was seen last.

    Args:
        before: state of one environment or of a batch.
        after: the same after the step.
        xp: ``jax.numpy`` or ``numpy``.
    """
    failed = xp.asarray(after.metrics["nan"])[..., None] > 0
    names = ("obs",) if after.privileged_obs is None else ("obs", "privileged_obs")
    return after.replace(
        **{name: xp.where(failed, getattr(before, name), getattr(after, name)) for name in names}
    )


RESTARTED = ("data", "task", "obs", "privileged_obs", "past", "episode", "key")
"""Fields of a state that a new episode replaces; reward, metrics and ``done`` remain those of the last step."""


def begun(state: State, resets: list[tuple[Any, dict[str, Any]]]) -> State:
    """Return the state of a batch in which some environments begin another episode, in NumPy.

    Args:
        state: state of the batch.
        resets: row indices (n,) and the new fields of those rows (n, ...).
    """
    if not resets:
        return state
    parts = [{name: fields.get(name) for name in RESTARTED} for _, fields in resets]
    old = {name: getattr(state, name) for name in RESTARTED}

    def written(old: Any, *parts: Any) -> Any:
        new = np.array(old)
        for (rows, _), part in zip(resets, parts, strict=True):
            new[rows] = part
        return new

    return state.replace(**jax.tree.map(written, old, *parts))


def drawable(state: Any) -> dict[str, Any]:
    """Return what pictures need of a batch's state, in NumPy.

    A state of a batch cannot be indexed as a whole with every physics: some of Warp's buffers are shared by all environments.
    """
    data = {name: getattr(state.data, name) for name in ("qpos", "qvel")}
    return jax.device_get({"task": state.task, "episode": state.episode, "data": data})


def drawn_of(batch: dict[str, Any], index: int) -> Any:
    """Return the part of one environment of ``drawable``, as ``AssistiveEnv.to_mujoco`` and ``markers`` take it."""
    one = jax.tree.map(lambda x: x[index], batch)
    return SimpleNamespace(**one | {"data": SimpleNamespace(**one["data"])})


def limited_by_brax(state: State) -> State:
    """Return the state after a step, ending the episode at its length only if no Brax wrapper does so.

    Brax's EpisodeWrapper counts steps in ``info`` and applies the limit itself; it would mistake ours for a failure.
    It wraps the environment directly and reads ``done`` immediately, so our adapter is never in between.
    """
    return state.replace(done=state.metrics["nan"]) if "steps" in state.info else state


def as_brax_env(env: type) -> None:
    """Make ``isinstance(x, brax.envs.Env)`` hold for instances of a class. Not a base class: importing Brax imports MJX."""
    from brax import envs

    envs.Env.register(env)
