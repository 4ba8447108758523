# ruff: noqa: D103 (a test's name says what it shows)
"""What an evaluation tells in the units of care: how far, how fast, and for whom."""

from __future__ import annotations

from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest
from fake_env import FakeEnv
from fake_press_env import FakePressEnv

import agym_jax
from agym_jax.human.population import Human
from agym_jax.spec import Ending, Measure
from train.evaluate import evaluate
from train.evaluation.outcome import Outcome
from train.evaluation.people import People, by_group, people_in, worst
from train.evaluation.score import EvaluationResult
from train.evaluation.seed_scores import SeedScores

HELD = Measure("held", "1", "share of episodes in which the gripper still holds the gown")


@dataclass
class Counting(FakeEnv):
    """Tells how many steps were made; the task is done in the steps of ``done_in``."""

    done_in: tuple[int, ...] = ()
    dt: float = 0.1
    task: Any = field(
        default_factory=lambda: SimpleNamespace(measures=(Measure("steps", "1", "steps made"),))
    )

    def _first(self, key):
        first = super()._first(key)
        return first.replace(metrics=first.metrics | {"task/steps": jnp.zeros(())})

    def step(self, state, action):
        """One step more."""
        after, number = super().step(state, action), state.time + 1
        success = jnp.isin(number, jnp.array(self.done_in, number.dtype))
        counted = {"task/steps": number.astype(jnp.float32), "success": jnp.float32(success)}
        return after.replace(metrics=after.metrics | counted)


@pytest.mark.parametrize(
    ("done_in", "seconds"),
    [
        (range(1, 21), 0.1),
        (range(8, 21), 0.8),
        ([3, 4, *range(15, 21)], 1.5),  # reached, left, and reached for good
        ([20], 2.0),
        ([5, 6], None),
        ([], None),
    ],
)
def test_the_time_to_success_is_that_from_which_on_the_task_is_done(done_in, seconds):
    env = Counting(done_in=tuple(done_in) or (-1,))
    assert env.episode_length == 20
    found = evaluate(env, "zero", 3)
    assert found.outcome.median_time == pytest.approx(seconds)
    assert found.summary()["time_to_success"] == pytest.approx(seconds)
    assert ("time to success" in found.table()) == (seconds is not None)


def test_a_measure_is_that_of_the_last_step_of_the_first_episode():
    found = evaluate(Counting(done_in=(20,)), "zero", 4)
    assert found.outcome.values["steps"].tolist() == [20.0] * 4
    assert found.summary()["task/steps"] == 20.0 and "steps made" in found.table()


def people(**changes) -> People:
    usual = {
        "sex": np.tile([0.0, 1.0], 50),
        "stature": np.ones(100),
        "girth": np.ones(100),
        **dict.fromkeys(("limits", "weakness", "tremor"), np.zeros(100, bool)),
    }
    return People(**usual | changes)


def test_groups_are_those_of_sex_impairment_and_size():
    number = np.arange(100)
    groups = people(tremor=number < 10, weakness=(number >= 10) & (number < 30)).groups()
    assert {name: int(mask.sum()) for name, mask in groups.items()} == {
        "men": 50,
        "women": 50,
        "without impairment": 70,
        "with weakness": 20,
        "with tremor": 10,
    }
    girth = np.random.default_rng(0).permutation(np.linspace(0.9, 1.15, 100))
    groups = people(girth=girth).groups()
    fifths = [mask for name, mask in groups.items() if "fifth" in name]
    assert len(fifths) == 5 and np.sum(fifths, 0).tolist() == [1] * 100
    assert girth[groups["stoutest fifth"]].min() > girth[~groups["stoutest fifth"]].max()
    assert girth[groups["slimmest fifth"]].max() < girth[~groups["slimmest fifth"]].min()


def test_the_worst_group_is_none_of_a_few_people():
    weakness, successes = np.arange(100) < 10, np.ones(100, bool)
    successes[:10] = False  # ten people: too few, though nobody of them is helped
    successes[51::2] = False
    found = by_group(people(weakness=weakness), successes, successes)
    assert {x.name: x.success for x in found}["with weakness"] == 0.0
    assert worst(found).name == "women" and worst(found).success == pytest.approx(0.4)
    assert worst([]) is None


def test_the_table_of_seeds_says_whom_each_helps_least():
    half, nobody = people().sex > 0.5, np.zeros(100, bool)
    results = {
        seed: EvaluationResult("X-v0", *np.zeros((2, 100)), successes, nobody, 0, 1.0, people=who)
        for seed, (successes, who) in enumerate([(half, people()), (~nobody, None)], start=1)
    }
    scores = SeedScores(results)
    assert "least helped: men, 0.0%" in scores.table().splitlines()[1]
    assert "least helped" not in scores.table().splitlines()[2]  # it is not known who they were
    least, unknown = scores.summary()["least_helped_of_seeds"]
    assert (least["name"], least["episodes"], least["success"]) == ("men", 50, 0.0) and not unknown
    assert "least_helped_of_seeds" not in SeedScores({2: results[2]}).summary()


def test_the_table_of_seeds_says_how_episodes_end():
    values = {"held": np.arange(100) < 2}
    end = Outcome((HELD,), values, np.full(100, np.nan))
    done, nobody = np.ones(100, bool), np.zeros(100, bool)
    result = EvaluationResult("X-v0", *np.zeros((2, 100)), done, nobody, 0, 1.0, outcome=end)
    other = EvaluationResult("X-v0", *np.zeros((2, 100)), done, nobody, 0, 1.0)
    scores = SeedScores({1: result, 2: other})
    assert scores.table().splitlines()[1].endswith("2% held")
    assert "held" not in scores.table().splitlines()[2]
    assert [x and x["task/held"] for x in scores.summary()["outcome_of_seeds"]] == [0.02, None]
    assert "outcome_of_seeds" not in SeedScores({2: other}).summary()


def test_failed_episodes_are_told_apart_by_how_they_end():
    endings = (Ending("spilled", "spilled", low=0.26), Ending("nothing", "drunk", high=0.01))
    endings += (Ending("rest", "drunk"),)
    values = {
        "drunk": np.array([0.9, 0.0, 0.0, 0.5, 0.7, 0.0]),
        "spilled": np.array([0.0, 0.9, 0.1, 0.5, 0.2, 0.0]),
    }
    measures = tuple(Measure(name, "1", f"share {name}") for name in values)
    times = np.array([3.0, *[np.nan] * 5])  # the first one succeeds
    end = Outcome(measures, values, times, endings)
    assert end.failures == {"spilled": 2, "nothing": 2, "rest": 1}  # each counts once
    assert (
        dict(end.rows())["episodes that fail"].split("   ")[-1]
        == "spilled (2), nothing (2), rest (1)"
    )
    assert end.summary()["failures"] == end.failures
    assert dict(end.rows())["episodes that fail"].split()[0] == "5"
    assert "failures" not in Outcome(measures, values, times).summary()
    assert not Outcome(measures, values, np.ones(6), endings).failures


def test_a_seed_that_misses_a_measure_is_chosen_only_if_all_do():
    def result(held, successes):
        end = Outcome((HELD,), {"held": np.arange(100) < held}, np.full(100, np.nan))
        done = np.arange(100) < successes
        return EvaluationResult(
            "X-v0", *np.zeros((2, 100)), done, np.zeros(100, bool), 0, 1.0, outcome=end
        )

    results = {1: result(2, 99), 2: result(95, 90), 3: result(91, 92)}
    assert SeedScores(results).best == 1
    scores = SeedScores(results, at_least={"held": 0.9})
    assert scores.best == 3 and scores.worst == 2 and scores.summary()["at_least"] == {"held": 0.9}
    assert [scores.fulfils(seed) for seed in results] == [False, True, True]
    none = SeedScores(results, at_least={"held": 0.99})
    assert none.best == 1 and not none.fulfils(1)
    assert "at_least" not in SeedScores(results).summary()


def test_who_has_no_joint_that_moves_does_not_tremble():
    one = jnp.ones(3)
    human = Human(jnp.zeros(3), one, one, one, one, tremor=jnp.zeros((3, 0)))
    found = people_in(SimpleNamespace(episode=SimpleNamespace(human=human)))
    assert found["person/tremor"].tolist() == [False] * 3


def test_environments_without_people_have_no_groups():
    found = evaluate(FakePressEnv(), "zero", 3)
    assert people_in(SimpleNamespace()) == {} and found.people is None and found.groups == []
    assert "groups" not in found.summary() and "least helped" not in found.table()


@pytest.fixture(scope="module")
def reaching():
    env = agym_jax.make(
        "ReachingJaco-v0",
        "native",
        humans=agym_jax.Population(sizes="continuous"),
        episode_length=5,
    )
    return evaluate(env, "zero", 60, 3)


def test_people_are_those_of_the_episodes(reaching):
    found = reaching.people
    assert (
        len(np.unique(found.girth)) == 60 and 0.9 <= found.girth.min() < found.girth.max() <= 1.15
    )
    groups = found.groups()
    kinds = ("without impairment", "with limited joints", "with weakness", "with tremor")
    assert sum(groups[x].sum() for x in kinds) == 60  # one of them each
    assert groups["stoutest fifth"].sum() == 12
    line = reaching.summary()
    assert {x["name"] for x in line["groups"]} == set(groups)
    text = reaching.table(groups=True)
    assert "stoutest fifth" in text and "stoutest fifth" not in reaching.table()


def test_what_the_task_measures_is_told(reaching):
    # nobody moves: the hand is as far away as in the beginning
    assert 0.2 < reaching.outcome.values["distance"].min() < 1.0
    assert "distance [m]" in reaching.table() and "from hand to mouth" in reaching.table()
