# ruff: noqa: D103
"""What tasks tell in the units of care, of states made by hand."""

from __future__ import annotations

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import agym_jax
from agym_jax.matter.particles.fill import fill, load_fill
from agym_jax.metrics import metric_names, progress_of
from agym_jax.spec import Diagnosed, Measured
from agym_jax.tasks import TASKS
from agym_jax.tasks.arm_manipulation import ARM_MANIPULATION, ArmState
from agym_jax.tasks.bed_bathing import BED_BATHING, BathState
from agym_jax.tasks.drinking import DRINKING, DrinkState
from agym_jax.tasks.feeding import FEEDING, FeedState

ZERO, HERE, UPRIGHT = jnp.float32(0.0), jnp.zeros(3), jnp.array([1.0, 0.0, 0.0, 0.0])


@pytest.mark.parametrize("task", TASKS.values(), ids=lambda task: task.name)
def test_every_task_tells_how_far_it_has_come(task):
    assert isinstance(task, Measured) and task.measures
    names = metric_names(task)
    assert len(set(names)) == len(names)
    assert {f"task/{x.name}" for x in task.measures} < set(names)
    assert all(x.unit in ("1", "m") and x.words for x in task.measures)


@pytest.mark.parametrize("task", TASKS.values(), ids=lambda task: task.name)
def test_every_failure_has_an_ending(task):
    assert isinstance(task, Diagnosed)
    names = {x.name for x in task.measures}
    assert len({x.words for x in task.endings}) == len(task.endings) > 1
    assert all(x.measure in names and x.low < x.high for x in task.endings)
    last = task.endings[-1]
    assert (last.low, last.high) == (-np.inf, np.inf)  # whatever is left


@pytest.mark.parametrize(("wiped", "done"), [(0, False), (2, False), (4, True), (10, True)])
def test_wiped_is_the_share_of_the_points_that_exist(wiped, done):
    exists = jnp.zeros((2, 20)).at[0, :6].set(1).at[1, :4].set(1)
    order = jnp.cumsum(exists.ravel()).reshape(2, 20)
    dirty = exists * (order > wiped)
    state = BathState(jnp.zeros((2, 20, 3)), exists, dirty, jnp.zeros((2, 20, 3)), ZERO)
    found = progress_of(BED_BATHING, state)
    assert found["task/wiped"] == pytest.approx(wiped / 10)
    assert found["success"] == done


def test_food_is_eaten_spilled_or_still_there():
    food = fill(load_fill("spoon"), HERE, UPRIGHT)
    gone = jnp.array([0, 1, 2])  # two eaten, one on the floor
    food = replace(food, alive=food.alive.at[gone].set(False))
    state = FeedState(food, jnp.zeros(8, bool), jnp.float32(2.0), jnp.int32(0), HERE, HERE)
    found = FEEDING.measure(state)
    assert (float(found["eaten"]), float(found["spilled"])) == (2 / 8, 1 / 8)
    found = FEEDING.measure(
        replace(state, lost=jnp.int32(1))
    )  # it went non-finite: nobody spilled it
    assert (float(found["eaten"]), float(found["spilled"])) == (2 / 8, 0.0)


def test_water_is_drunk_spilled_or_still_there():
    water = fill(load_fill("cup"), HERE, UPRIGHT)
    water = replace(water, alive=water.alive.at[jnp.arange(52)].set(False))
    state = DrinkState(water, jnp.float32(48.0), jnp.int32(0), ZERO, HERE, ZERO, HERE)
    found = progress_of(DRINKING, state)
    assert float(found["task/drunk"]) == 0.75 and float(found["task/spilled"]) == 4 / 64
    assert found["success"] == 1.0


def test_the_arm_is_as_far_away_as_now_not_as_at_its_best():
    found = progress_of(ARM_MANIPULATION, ArmState(jnp.float32(-0.9), jnp.float32(-0.6)))
    assert float(found["task/distance"]) == pytest.approx(0.9) and found["success"] == 1.0


def test_it_is_told_from_the_beginning():
    state = agym_jax.make("ReachingJaco-v0", impl="native").reset(jax.random.PRNGKey(0))
    assert 0.2 < float(state.metrics["task/distance"]) < 1.0
