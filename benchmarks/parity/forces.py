"""Forces that a robot can have.

Assistive Gym solves motors and contacts as one system, so a contact presses with what motors, joint limits and momentum give.
Here the impulses on the robot's joints are accounted for over every control step of C MuJoCo (`agym_jax/sim/impulse.py`), with
actions that change every half second, and under the shipped policies, with and without a memory. What the account lacks is an
error of the integration; a force beyond what motors at their bound, limits and momentum give on every joint would have no
cause at all. The largest forces are impacts of a single step, of a scooper on the bed for example.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import agym_jax
from agym_jax.errors import PolicyLayoutError, PolicyNotFoundError
from agym_jax.memory import SHIPPED
from agym_jax.policy.policy import shipped
from agym_jax.robots import ROBOTS
from agym_jax.sim.impulse import Balance, watch
from agym_jax.tasks import TASKS
from benchmarks.parity.row import Row

ERROR = 0.25  # of the account [N m]
BEYOND = 0.1  # share of a force
STEPS, HELD = 100, 5  # control steps of an episode, and of one action


def balances(
    env: agym_jax.Env, policy: Callable[[Any], Any] | None, steps: int = STEPS
) -> list[Balance]:
    """The account of one episode.

    Args:
        env: with ``impl="native"``.
        policy: to act by; if there is none, by actions of -1, 0 and 1 that change from time to time.
        steps: how many control steps of the episode.
    """
    rng = np.random.default_rng(0)
    state, action = env.reset(jax.random.PRNGKey(0)), np.zeros(env.action_size)
    with watch(env.physics) as account:
        for i in range(steps):
            if policy is not None:
                action = policy(state.obs)
            elif i % HELD == 0:
                action = rng.choice([-1.0, 0.0, 1.0], env.action_size)
            state = env.step(state, jnp.asarray(action, jnp.float32))
    return account.steps


def rows(
    tasks: tuple[str, ...] = tuple(TASKS), robots: tuple[str, ...] = tuple(ROBOTS)
) -> list[Row]:
    """The comparison.

    Args:
        tasks: names of tasks.
        robots: names of robots, of each of which the worst counts.
    """
    out = []
    for task in tasks:
        by_chance: list[Balance] = []
        by_policy: list[Balance] = []
        with_memory: list[Balance] = []
        for robot in robots:
            env_id = f"{task}{robot}-v0"
            env = agym_jax.make(env_id, impl="native")
            by_chance += balances(env, None)
            # an environment may have no policy that was trained for what is observed now
            with contextlib.suppress(PolicyNotFoundError, PolicyLayoutError):
                by_policy += balances(env, agym_jax.load_policy(env_id))
            if env_id in shipped(memory=True):
                env = agym_jax.make(env_id, impl="native", memory=SHIPPED)
                with_memory += balances(env, agym_jax.load_policy(env_id, env))
        for who, found in (
            ("random actions", by_chance),
            ("shipped policies", by_policy),
            ("shipped policies with a memory", with_memory),
        ):
            if not found:
                continue
            error = max(x.error for x in found)
            beyond = max(max(x.force / x.possible - 1.0, 0.0) for x in found)
            strong = max(x.force for x in found)
            bound = found[0].bound
            what = f"{task}, {who}, motors of {bound:g} N m, up to {strong:.0f} N"
            out.append(
                Row(f"{what}: torque that the account lacks", "N m", 0.0, error, ERROR, "motor")
            )
            out.append(
                Row(
                    f"{what}: force beyond what there is cause for",
                    "",
                    0.0,
                    beyond,
                    BEYOND,
                    "motor",
                )
            )
    return out
