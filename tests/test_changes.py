# ruff: noqa: D103
"""Environments with other weights, people and lengths than their ids say, and that nothing mixes them up."""

from __future__ import annotations

import dataclasses
from typing import Any

import gymnasium
import numpy as np
import pytest

import agym_jax
from agym_jax import Population, RobotVariation
from agym_jax.__main__ import main
from agym_jax.changes import arguments_of, change_task, flags_of, settings_of
from agym_jax.errors import (
    ArgumentError,
    PolicyEnvironmentError,
    SpecError,
    UnknownNameError,
)
from agym_jax.spec import Preferences
from agym_jax.tasks import TASKS
from agym_jax.tasks.scratch_itch import SCRATCH_ITCH, Config

NAME = "ReachingJaco-v0"
OPTIONS: dict[str, Any] = {
    "humans": Population("continuous", impairments=("none", "tremor")),
    "config": {"distance": 2, "preferences": {"velocity": 0.5}},
    "episode_length": 3,
}


@pytest.fixture(scope="module")
def changed() -> agym_jax.Env:
    return agym_jax.make(NAME, impl="native", **OPTIONS)


def test_a_changed_environment_says_what_is_other(changed):
    assert agym_jax.make(NAME, impl="native").changes == {}
    assert changed.changes == {
        "task.distance": 2.0,
        "task.preferences.velocity": 0.5,
        "episode_length": 3,
        "humans.sizes": "continuous",
        "humans.impairments": ["none", "tremor"],
    }
    assert flags_of(changed.changes) == (
        "--task.distance 2.0 --task.preferences.velocity 0.5 --episode-length 3 --humans.sizes continuous "
        "--humans.impairments none tremor"
    )
    again = agym_jax.make(NAME, impl="native", **arguments_of(changed.changes))
    assert again.changes == changed.changes and again.humans == changed.humans


def test_what_is_as_registered_is_no_change():
    task = TASKS["ScratchItch"]
    assert change_task(task) is task
    same = {"scratch": task.config.scratch, "preferences": Preferences()}
    assert change_task(task, same, task.episode_length) is task
    assert change_task(task, {"preferences.velocity": 1, "scratches": 3.0}).config == Config(
        scratches=3, preferences=Preferences(velocity=1.0)
    )
    assert change_task(task, Config(scratch=3.0)).config.scratch == 3.0
    assert SCRATCH_ITCH.config == Config()  # the task itself stays as it is


@pytest.mark.parametrize(
    ("options", "error", "told"),
    [
        ({"config": {"scratc": 3}}, UnknownNameError, "Did you mean 'scratch'"),
        ({"config": {"velocity": 3}}, UnknownNameError, "Did you mean 'preferences.velocity'"),
        ({"config": {"preferences.velocit": 3}}, UnknownNameError, "'preferences.velocity'"),
        ({"config": {"scratch.x": 3}}, UnknownNameError, "'scratch.x'"),
        ({"config": {"preferences": 3}}, ArgumentError, '"velocity"'),
        ({"config": {"scratch": "3"}}, ArgumentError, "finite number such as 2.0, got '3'"),
        ({"config": {"scratch": float("nan")}}, ArgumentError, "finite number"),
        ({"config": {"scratch": True}}, ArgumentError, "finite number"),
        ({"config": {"scratches": 2.5}}, ArgumentError, "whole number such as 25"),
        ({"config": 3}, ArgumentError, "dictionary"),
        ({"episode_length": 0}, ArgumentError, "at least 1"),
        ({"episode_length": 2.5}, ArgumentError, "whole number"),
    ],
)
def test_what_makes_no_sense_is_refused_before_anything_is_built(options, error, told):
    with pytest.raises(error, match=told):
        agym_jax.make("ScratchItchJaco-v0", **options)
    with pytest.raises(error, match=told):
        gymnasium.make("ScratchItchJaco-v0", **options)


def test_a_task_has_the_last_word_on_its_settings():
    with pytest.raises(SpecError, match=r"spacing must be at least 0\.03"):
        change_task(TASKS["BedBathing"], {"spacing": 0.01})

    @dataclasses.dataclass(frozen=True)
    class Bare:
        name: str = "Bare"

    with pytest.raises(SpecError, match="no settings to change"):
        change_task(Bare(), {"x": 1})  # pyrefly: ignore


@pytest.mark.parametrize("name", list(TASKS))
def test_every_setting_has_a_unit_and_a_meaning(name):
    settings = settings_of(TASKS[name])
    assert len(settings) > 6
    assert not [x.name for x in settings if not x.unit or len(x.meaning) < 10]
    idle = {x.name for x in settings if "none in this task" in x.meaning}
    assert "preferences.velocity" not in idle and idle


def test_the_command_prints_settings(capsys):
    assert main(["settings", NAME]) == 0
    said = capsys.readouterr().out
    assert (
        "| `reached` | `0.03` | m | distance from hand to mouth within which the task succeeds |"
        in said
    )
    assert "| `sizes` | `'ag'` |" in said and "| `episode_length` | `200` |" in said
    assert main(["settings", "ReachingJako-v0"]) == 2
    assert "ReachingJaco-v0" in capsys.readouterr().err


def test_a_policy_of_other_settings_is_refused_by_name(changed, tmp_path):
    told = "task.distance is the default there, 2.0 here"
    with pytest.raises(PolicyEnvironmentError, match=told) as error:
        agym_jax.load_policy(NAME, changed)
    assert "humans" not in str(error.value) and "--any-env" in str(error.value)
    from agym_jax.policy import check_policy, save_policy
    from agym_jax.policy.check import settings_for

    policy = agym_jax.load_policy(NAME)
    with pytest.raises(PolicyEnvironmentError, match="episode_length is the default there, 3 here"):
        check_policy(policy, changed, NAME)
    check_policy(policy, changed, NAME, any_env=True)
    info = {name: x for name, x in policy.info.items() if name != "meant_for"}
    trained = dataclasses.replace(policy, info=info | {"changes": changed.changes})
    path = save_policy(tmp_path / "policy.npz", trained)
    assert agym_jax.load_policy(path, changed).info["changes"] == changed.changes
    assert settings_for(path, "ReachingJacoHuman-v0") == arguments_of(changed.changes)
    assert settings_for(path, "ReachingPR2-v0") == {} and settings_for("zero", NAME) == {}
    usual = agym_jax.make(NAME, impl="native")
    with pytest.raises(PolicyEnvironmentError, match=r"--task.distance 2.0 .*velocity 0.5\)"):
        agym_jax.load_policy(path, usual)
    with pytest.raises(PolicyEnvironmentError, match=r"--episode-length 3 --humans.sizes"):
        check_policy(trained, usual, path)
    meant = dataclasses.replace(trained, info=trained.info | {"meant_for": {}})
    path = save_policy(tmp_path / "meant.npz", meant)
    assert agym_jax.load_policy(path, usual).info["changes"] == changed.changes
    assert settings_for(path, NAME) == {}
    with pytest.raises(PolicyEnvironmentError, match=told):
        agym_jax.load_policy(path, changed)


def test_a_policy_meets_other_people_for_other_lengths():
    """Training does not go on with them, which is what ``check_policy`` asks for unless it is told otherwise."""
    from agym_jax.policy import check_policy
    from agym_jax.policy.agents import Pair, baseline_policy
    from agym_jax.policy.check import trained_otherwise

    env = agym_jax.make(
        NAME, impl="native", humans=Population(impairments=("tremor",)), episode_length=50
    )
    policy = agym_jax.load_policy(NAME, env)
    with pytest.raises(PolicyEnvironmentError, match=r"humans.impairments is the default there"):
        check_policy(policy, env, NAME)
    # trained with people of both kinds of size, for the id as it is
    assert policy.info["changes"] and policy.info["meant_for"] == {}
    where = "is the default for this policy"
    said = f"episode_length {where}, 50 here; humans.impairments {where}, ['tremor'] here"
    assert trained_otherwise(policy, env) == said
    plain = dataclasses.replace(policy, info=policy.info | {"changes": {}})
    told = "episode_length is the default in training, 50 here; humans.impairments is the default in training, ['tremor'] here"
    assert trained_otherwise(plain, env) == told
    zero = baseline_policy("zero", 7)
    assert trained_otherwise(Pair(policy, zero, 21), env) == said
    assert trained_otherwise(zero, env) == ""
    assert trained_otherwise(policy, agym_jax.make(NAME, impl="native")) == ""
    varied = agym_jax.make(NAME, impl="native", robot=RobotVariation(latency=(0, 1)))
    with pytest.raises(PolicyEnvironmentError, match=r"robot.latency is the default there"):
        agym_jax.load_policy(NAME, varied)


@pytest.mark.jit
def test_gymnasium_takes_the_same(changed):
    """Weights, length and people are those that were asked for."""
    config = {"distance": 2.0, "preferences.velocity": 0.5}
    env: Any = gymnasium.make(NAME, **OPTIONS | {"config": config}).unwrapped
    assert env.core.changes == changed.changes
    same: Any = gymnasium.make(NAME, **OPTIONS).unwrapped
    assert same.core is env.core  # programs are shared
    env.reset(seed=1)
    assert env.state.episode.human.stature != 1.0
    for step in range(1, 4):
        *_, reward, terminated, truncated, info = env.step(np.full(7, 0.5, np.float32))
        assert not terminated and truncated == (step == 3)
        assert info["reward_terms"]["distance"] == pytest.approx(-2.0 * env.state.task.distance)
    assert reward == pytest.approx(sum(info["reward_terms"].values()), rel=1e-5)
    PettingZooEnv = pytest.importorskip("agym_jax.adapters.pettingzoo").PettingZooEnv
    pair = PettingZooEnv("ReachingJacoHuman-v0", **OPTIONS)
    assert pair.core.changes == changed.changes
    envs: Any = gymnasium.make_vec(NAME, num_envs=2, **OPTIONS)
    assert envs.unwrapped.core.changes == changed.changes


def test_what_is_on_or_off_becomes_a_flag_without_a_value():
    assert flags_of({"a_b": False, "c.d_e": True, "c.f": False}) == "--no-a-b --c.d-e --c.no-f"
