"""Learning under a limit: PPO with a Lagrange multiplier, which a PID controller moves.

The cost of a control step is 0 up to the comfort limit of what is touched (``agym_jax.human.regions``). Above it, the cost is 1, and up
to 1 more for how far: 1.5 at one and a half times the limit, 2 from twice the limit on. With a margin (``cost_margin``), costs begin that
share below the limit and rise to 1 at it. A policy that presses far too hard thus
gains by pressing less hard, and as every step above the limit costs at least 1, the mean cost of an episode is never less
than the share of episodes that are not gentle: a limit of 0.05 asks for 95 % of them, or more.

The policy learns from the advantage ``A_reward - multiplier * A_cost``. Rewards are divided by the deviation of the discounted return
(``normalize_reward``), and costs are counted, so the multiplier says how many such deviations a step just above the limit costs. (Were both
of unit variance, each cost would weigh the more, the fewer are left.) ``A_cost`` comes from a value function of
the cost, with the architecture and the learning rate of the other. The multiplier is set before every update by a PID controller (Stooke, Achiam and Abbeel 2020, "Responsive safety in
reinforcement learning by PID Lagrangian methods"): the integral finds its level, the proportional part keeps that from
swinging, the derivative answers to a cost that rises.

Some things are not as in that paper. The limit is tightened during the run, from any cost to what was asked for: under a tight limit from the
first step on, a policy learns to keep away from the person before it learns the task, and stays there (FeedingJaco, 300,000 steps: no success,
no contact). And the multiplier is bounded: where sampled actions cannot be so gentle, ever more weight on the cost makes a policy give up
the task. The controller's error is ``(cost - limit) / (cost + limit)``, within [-1, 1]: at first the cost of an
episode can be a thousand limits, and an integral of the difference would take thousands of updates to unwind. The controller moves the share
of the largest multiplier that is used. And the sum of both advantages is scaled to unit variance, which takes the place of a division by
``1 + multiplier``.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import optax

from ..configs import LearnConfig
from ..errors import ConfigError
from .advantage import LastObservations, compute_gae, values_of
from .optimizer import moved
from .rollout import BEYOND, COMFORT_KEY, Batch, RolloutState, Totals, record_step

SHARED = ("cost", "multiplier")
"""Scalars that are the same for all agents: cost of an episode in the update, and the multiplier."""
COST_LOSSES = (*SHARED, "cost_value_loss")
"""Names of the scalars that learning under a limit tells besides."""
SMOOTHING = 0.1
"""Share of the newest update in the cost that the controller sees: an update of 20,000 steps has some ten costs near the limit."""
LEAST_LIMIT = 0.01
"""Up to which a limit is tightened by equal factors; a limit of 0 then follows at once."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class ConstraintHyper:
    """Numbers of a cost limit that are arguments of the compiled update, float32, () or (seeds,)."""

    limit: Any  # mean cost of an episode
    episode_length: Any  # control steps
    proportional: Any
    integral: Any
    derivative: Any
    tighten_from: Any  # share of the run
    tighten_until: Any  # share of the run
    largest: Any  # multiplier; gains are shares of it
    margin: Any = 0.0  # share of the comfort limit below it from which steps cost something

    @classmethod
    def of(cls, config: LearnConfig, episode_length: int) -> ConstraintHyper | None:
        """Those of a configuration; None if it has no cost limit."""
        if config.cost_limit is None:
            return None
        gains = (config.cost_proportional, config.cost_integral, config.cost_derivative)
        shares = (config.cost_tighten_from, config.cost_tighten_until)
        numbers = (config.cost_limit, episode_length, *gains, *shares, config.cost_multiplier_max)
        return cls(*(np.float32(x) for x in (*numbers, config.cost_margin)))

    def limit_at(self, progress: jax.Array) -> jax.Array:
        """The limit after a share of the run: equal factors from 1 a step, that is hardly any, down to ``limit`` ()."""
        span = jnp.maximum(self.tighten_until - self.tighten_from, 1e-6)
        left = 1 - jnp.clip((progress - self.tighten_from) / span, 0.0, 1.0)
        lowest = jnp.maximum(self.limit, LEAST_LIMIT)
        loose = lowest * (jnp.maximum(self.episode_length, lowest) / lowest) ** left
        return jnp.where(progress >= self.tighten_until, self.limit, loose)


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class ConstraintState:
    """What learning under a limit needs to go on."""

    params: Any  # of the cost's value function
    optimizer: optax.OptState
    cost: jax.Array  # of an episode, smoothed over updates; -1 before the first    ()
    integral: jax.Array  # of the controller, a share of the largest multiplier    ()
    multiplier: jax.Array  # of the last update                                    ()


def init_constraint(
    networks: Any, optimizer: optax.GradientTransformation, key: jax.Array
) -> ConstraintState:
    """A multiplier of 0, and a value function of the cost that has seen nothing.

    Args:
        networks: from ``make_networks``.
        optimizer: of the value function.
        key: that of the other value function.
    """
    params = networks.value_network.init(jax.random.fold_in(key, 1))
    zero = jnp.zeros(())
    return ConstraintState(params, optimizer.init(params), zero - 1, zero, zero)


def step_cost(share: jax.Array, margin: Any = 0.0) -> jax.Array:
    """Cost of control steps.

    Args:
        share: of the comfort limit that was reached; above 1 it is exceeded.
        margin: share of the limit below it from which steps cost something; 0 = none do.
    """
    near = jnp.clip((share - 1 + margin) / jnp.maximum(margin, 1e-6), 0.0, 1.0)
    return jnp.where(share > 1, 1 + jnp.minimum(share - 1, 1), jnp.where(margin > 0, near, 0.0))


def record_comfort(
    rollout: RolloutState, totals: Totals, raw: jax.Array, log_prob: Any, after: Any, *more: Any
) -> tuple[RolloutState, Totals, Batch]:
    """As ``record_step``, and take note of the share of the comfort limit that was reached.

    Raises:
        ConfigError: the environment does not measure what its limit is about.
    """
    if COMFORT_KEY not in after.metrics:
        raise ConfigError(
            f"--cost-limit is about the comfort limit of the person, which this environment does not measure: its "
            f"metrics are {', '.join(after.metrics)}. Leave --cost-limit out, or add {COMFORT_KEY!r}."
        )
    rollout, totals, batch = record_step(rollout, totals, raw, log_prob, after, *more)
    return rollout, totals, replace(batch, of_comfort=after.metrics[COMFORT_KEY])


def control(
    state: ConstraintState, cost: jax.Array, hyper: ConstraintHyper, progress: Any = 1.0
) -> tuple[jax.Array, jax.Array, jax.Array]:
    """One step of the PID controller.

    Args:
        state: before it.
        cost: mean cost of an episode in the newest update ().
        hyper: limit and gains.
        progress: share of the run that is over ().

    Returns:
        The smoothed cost, the integral and the multiplier after it, () each.
    """
    old = jnp.where(state.cost < 0, cost, state.cost)
    new = old + SMOOTHING * (cost - old)
    limit = hyper.limit_at(jnp.asarray(progress))
    error, before = (_error(x, limit) for x in (new, old))
    integral = jnp.clip(state.integral + hyper.integral * error, 0.0, 1.0)
    rise = jnp.maximum(0.0, error - before)
    share = hyper.proportional * error + integral + hyper.derivative * rise
    return new, integral, hyper.largest * jnp.clip(share, 0.0, 1.0)


def _error(cost: jax.Array, limit: jax.Array) -> jax.Array:
    """How far a cost is from the limit, within [-1, 1]; 0 at the limit, and where both are 0."""
    return (cost - limit) / jnp.maximum(cost + limit, 1e-6)


@dataclass(frozen=True)
class Penalty:
    """What the cost makes of advantages."""

    advantage: jax.Array  # of the cost, centred    (T, B)
    multiplier: jax.Array  # ()


def penalised(advantage: jax.Array, penalty: Penalty | None) -> jax.Array:
    """Centred advantages of the reward (T, B), less those of the cost."""
    if penalty is None:
        return advantage
    return advantage - penalty.multiplier * penalty.advantage


def learn_constraint(
    state: ConstraintState | None,
    batch: Batch,
    last: jax.Array,
    ends: LastObservations,
    key: jax.Array,
    hyper: Any,
    config: LearnConfig,
    value: Callable[[Any, jax.Array], jax.Array],
    optimizer: optax.GradientTransformation,
    rate: jax.Array,
    progress: jax.Array,
    mean: Callable[[Any], Any],
) -> tuple[ConstraintState | None, Penalty | None, dict[str, jax.Array]]:
    """Set the multiplier, and teach the value function of the cost.

    Args:
        state: before the update; None without a cost limit, and then nothing happens.
        batch: rollout of (T, B), in the agent's own view, with shares of the comfort limit.
        last: what value functions read after it    (B, critic observation).
        ends: ``last_observations`` of the batch.
        key: random key of the update.
        hyper: ``train.learning.ppo.Hyper``.
        config: settings that the program is compiled for.
        value: (parameters, what value functions read) -> value.
        optimizer: of the value function.
        rate: learning rate, now.
        progress: share of the run that is over.
        mean: over the devices that share the batch.

    Returns:
        State after, what the cost makes of advantages, and ``COST_LOSSES``.
    """
    if state is None:
        return None, None, {}
    assert batch.of_comfort is not None  # config.cost_limit makes both
    costs = step_cost(batch.of_comfort, hyper.constraint.margin)
    cost = mean(jnp.mean(costs)) * hyper.constraint.episode_length
    smooth, integral, multiplier = control(state, cost, hyper.constraint, progress)
    values, next_values = values_of(lambda obs: value(state.params, obs), batch, last, ends)
    advantage = compute_gae(costs, values, next_values, batch.done, hyper.gamma, hyper.gae_discount)
    centred = advantage - mean(advantage.mean())

    read = batch.obs if batch.critic_obs is None else batch.critic_obs
    read, target = read.reshape(-1, read.shape[-1]), (advantage + values).reshape(-1)

    def loss(params: Any, rows: jax.Array) -> jax.Array:
        return 0.5 * jnp.mean((value(params, read[rows]) - target[rows]) ** 2)

    def step(carry: tuple, rows: jax.Array) -> tuple[tuple, jax.Array]:
        params, opt_state = carry
        with jax.default_matmul_precision(config.gradient_precision):
            error, grads = jax.value_and_grad(loss)(params, rows)
        changes, opt_state = optimizer.update(mean(grads), opt_state)
        return (moved(params, changes, rate), opt_state), error

    keys = jax.random.split(jax.random.fold_in(key, BEYOND), config.ppo_epoch)
    orders = jax.vmap(lambda key: jax.random.permutation(key, len(target)))(keys)
    rows = orders.reshape(config.ppo_epoch * config.num_mini_batch, -1)
    (params, opt_state), errors = jax.lax.scan(step, (state.params, state.optimizer), rows)
    told = {"cost": cost, "multiplier": multiplier, "cost_value_loss": mean(jnp.mean(errors))}
    state = ConstraintState(params, opt_state, smooth, integral, multiplier)
    return state, Penalty(centred, multiplier), told
