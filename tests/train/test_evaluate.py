# ruff: noqa: D103 (a test's name says what it shows)
"""Policies evaluated and replayed."""

from __future__ import annotations

import dataclasses
import itertools
import json
import sys
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from fake_env import FakeEnv
from fake_press_env import HARDEST, FakePressEnv

from agym_jax.human.regions import NAMES
from agym_jax.policy import Policy, baseline_policy, save_policy
from train import enjoy, evaluate
from train.configs import PPOConfig
from train.errors import ConfigError
from train.evaluate import Evaluator
from train.evaluation.gentleness import Gentleness
from train.evaluation.score import wilson_interval
from train.learning.agents import Agents

INFO = {"env": "FakeReach-v0", "layout": "fake-1", "commit": None, "versions": {}}


def make_policy(distribution="normal", seed=0, head_gain=1.0):
    """An untrained policy for the fake environment."""
    config = PPOConfig(
        distribution=distribution, policy_hidden=(8,), value_hidden=(8,), policy_head_gain=head_gain
    )
    agents = Agents(config, FakeEnv(), ("robot",))
    learner = jax.jit(agents.init)(jax.random.PRNGKey(seed))
    return agents.policies(learner, INFO)["robot"]


@pytest.fixture(scope="module")
def policy():
    """A policy."""
    return make_policy()


@pytest.mark.parametrize(
    ("successes", "trials", "low", "high"),
    [  # R: prop.test(x, n, correct = FALSE)$conf.int
        (0, 10, 0.0, 0.2775),
        (5, 10, 0.2366, 0.7634),
        (10, 10, 0.7225, 1.0),
        (81, 263, 0.2553, 0.3662),  # Newcombe (1998), table I, method 3
        (15, 148, 0.0624, 0.1605),
        (0, 20, 0.0, 0.1611),
        (1, 29, 0.0061, 0.1718),
    ],
)
def test_wilson_interval_against_published_values(successes, trials, low, high):
    assert wilson_interval(successes, trials) == pytest.approx((low, high), abs=5e-5)


def test_wilson_interval_of_nothing():
    assert wilson_interval(0, 0) == (0.0, 1.0)


def test_an_evaluation_agrees_with_stepping_one_environment_after_another():
    env = FakeEnv()
    key = jax.random.PRNGKey(3)
    found = evaluate.evaluate(env, "zero", 3, key)
    key_reset, _ = jax.random.split(key)
    reset, step = jax.jit(env.reset), jax.jit(env.step)
    for i, key_one in enumerate(jax.random.split(key_reset, 3)):
        state = reset(key_one)
        total = force = 0.0
        for _ in range(20):
            state = step(state, jnp.zeros(2))
            total, force = (
                total + float(state.reward),
                force + float(state.metrics["force/on_human"]),
            )
        assert found.returns[i] == pytest.approx(total, rel=1e-5)
        assert found.forces[i] == pytest.approx(force / 20, rel=1e-5)
        assert found.successes[i] == bool(state.metrics["success"])


def test_native_episodes_run_some_at_a_time_each_from_its_own_key(policy):
    env = FakeEnv()
    env.impl = "native"  # what JAX cannot trace is evaluated so
    found = Evaluator(env, 3, at_once=2)(policy, jax.random.PRNGKey(5))
    for i, key in enumerate(jax.random.split(jax.random.PRNGKey(5), 3)):
        state, total = env.reset(jax.random.split(key)[0]), 0.0
        for _ in range(env.episode_length):
            state = env.step(state, policy(state.obs))
            total += float(state.reward)
        assert np.isclose(found.returns[i], total, rtol=1e-4)
        assert found.successes[i] == (state.metrics["success"] > 0.5)
    assert found.episodes == 3 and found.env == env.name and not found.nan.any()
    again = evaluate.evaluate(env, policy, 3, jax.random.PRNGKey(5))
    np.testing.assert_allclose(again.returns, found.returns, rtol=1e-6)  # of batches of other sizes


def test_no_episodes_are_refused(policy):
    with pytest.raises(ConfigError, match="num_episodes must be at least 1, got 0"):
        evaluate.evaluate(FakeEnv(), policy, 0)


def test_only_the_first_episode_of_an_environment_counts_and_nan_is_seen():
    found = evaluate.evaluate(FakeEnv(nan_at=4), baseline_policy("random", 2), 5, 0)
    assert found.nan.all() and found.summary()["nan_episodes"] == 5
    assert not found.successes.any() and found.returns.min() > -4 * 3
    assert "episodes that went NaN          5" in found.table()


def pressing(*newtons):
    """A policy that presses with these forces in the environments of a batch, as the step's number says."""
    rows = np.array(newtons, np.float32) / HARDEST * 2 - 1

    def act(obs, key, deterministic=True):
        return jnp.repeat(jnp.asarray(rows)[:, None], 2, 1)

    return act


def test_a_gentle_success_never_exceeds_the_comfort_limit():
    # success needs 5 N; 20 N are comfortable: too little, gentle, just gentle, too much
    found = evaluate.evaluate(FakePressEnv(), pressing(2.0, 10.0, 20.0, 30.0), 4, 0)
    assert found.successes.tolist() == [False, True, True, True]
    assert found.gentle_successes.tolist() == [False, True, True, False]
    assert (found.success, found.gentle_success) == (0.75, 0.5)
    gentle = found.gentleness
    np.testing.assert_allclose(gentle.peaks, [2, 10, 20, 30], rtol=1e-5)
    assert gentle.over_comfort.tolist() == [0, 0, 0, 20] and gentle.share_over_comfort == 0.25
    assert gentle.share_over_limit == 0.0 and gentle.worst_region == "forearm"
    line = found.summary()
    assert line["gentle_success"] == 0.5 and line["gentle_success_low"] < 0.5
    assert line["peak_median"] == pytest.approx(15.0, rel=1e-4) and line["peak_99"] > 29.0
    assert line["region_over_comfort"] == {"forearm": 0.25} and line["worst_region"] == "forearm"
    assert json.loads(json.dumps(line)) == line
    text = found.table()
    assert "gentle success              50.0%" in text and "peak force [N]" in text
    assert "above 20 N in 25.0% of the episodes" in text


def test_the_worst_region_is_that_which_exceeds_its_limit_most_often():
    def worst(episodes, **peaks):
        regions = np.zeros((episodes, len(NAMES)))
        for name, values in peaks.items():
            regions[:, NAMES.index(name)] = values
        zero = np.zeros(episodes)
        comfort = np.full(len(NAMES), 20.0)
        return Gentleness(zero, zero, zero, zero, regions, comfort).worst_region

    # 99 % quantiles of four episodes: 19.52 N and 19.9 N, but only the forearm exceeds 20 N
    assert worst(4, forearm=[4, 4, 4, 20.1], chest=[19.9] * 4) == "forearm"
    assert worst(4, forearm=[30, 4, 4, 4], chest=[21, 21, 4, 4]) == "chest"  # more often
    assert worst(4, forearm=[30, 4, 4, 4], chest=[4, 4, 4, 21]) == "forearm"  # as often, but harder
    assert worst(4, forearm=[4, 4, 4, 4], chest=[4, 4, 4, 5]) == "chest"  # none exceeds it
    assert worst(1000, forearm=[30] + [0] * 999) == "forearm"
    assert worst(4) is None


def test_one_step_above_the_limit_is_enough_and_what_comes_after_the_episode_is_not():
    class Once(FakePressEnv):
        """Presses hard in one step only; episodes of some environments are over before."""

        def step(self, state, action):
            hard = jnp.where(state.time == 7, 1.0, -0.5)
            return super().step(state, jnp.full(2, hard))

    found = evaluate.evaluate(Once(), "zero", 3, 0)
    assert found.successes.all() and not found.gentle_successes.any()
    assert found.gentleness.over_comfort.tolist() == [1, 1, 1]
    found = evaluate.evaluate(Once(nan_at=5), "zero", 3, 0)  # begun anew, it would press in step 7
    assert found.nan.all() and not found.gentleness.over_comfort.any()
    np.testing.assert_allclose(found.gentleness.peaks, 10.0)


def test_an_environment_that_measures_no_limits_is_told_as_before(policy):
    found = evaluate.evaluate(FakeEnv(), policy, 3, 0)
    assert found.gentle_success is None and "gentle" not in found.table()
    assert not {"gentle_success", "peak_99"} & found.summary().keys()


def test_policies_of_one_architecture_share_a_compilation(policy):
    env = FakeEnv()
    run = Evaluator(env, 4)
    first = run(policy, jax.random.PRNGKey(0))
    other = dataclasses.replace(make_policy(seed=1), info={"env_steps": 5})
    second = run(other, jax.random.PRNGKey(0))
    assert env.traces["step"] == 1
    assert not np.array_equal(first.returns, second.returns)
    assert isinstance(policy, Policy)


def test_the_command_line_evaluates_and_records(tmp_path, capsys, policy):
    save_policy(tmp_path / "FakeReach-v0" / "policy.npz", policy)
    out = tmp_path / "results" / "lines.jsonl"
    words = f"--env-name FakeReach-v0 --load-dir {tmp_path} --num-episodes 6 --json {out}"
    assert evaluate.main(words.split(), lambda *_: FakeEnv()) == 0
    text = capsys.readouterr().out
    assert "6 episodes" in text and "95 % interval" in text and "±" in text
    assert "Actions: the mode" in text and "--non-det" in text
    assert f"Policy: {tmp_path / 'FakeReach-v0' / 'policy.npz'}" in text
    line = json.loads(out.read_text().splitlines()[0])
    assert line["kind"] == "evaluation" and line["env"] == "FakeReach-v0" and line["episodes"] == 6
    assert {"commit", "device", "versions", "time", "success", "success_low"} <= line.keys()
    assert evaluate.main([*words.split(), "--non-det"], lambda *_: FakeEnv()) == 0
    assert "Actions: samples" in capsys.readouterr().out
    words = ["--env-name", "ReachingJaco-v0", "--load-dir", str(tmp_path)]
    assert evaluate.main(words, lambda *_: FakeEnv()) == 2
    assert "PolicyNotFoundError" in capsys.readouterr().err
    assert evaluate.main(["--env-name", "ReechingJaco-v0", "--load-dir", str(tmp_path)]) == 2
    text = capsys.readouterr().err  # of a wrong id, not of a policy that is missing for it
    assert "UnknownNameError" in text and "Did you mean 'ReachingJaco-v0'" in text


def test_enjoy_shows_an_episode(tmp_path, capsys):
    clip, sheet = tmp_path / "new" / "a.gif", tmp_path / "a.png"
    words = f"--env-name FakeReach-v0 --policy random --episodes 2 --clip {clip} --sheet {sheet}"
    words += " --width 64 --height 48 --backend raycast"
    assert enjoy.main(words.split(), lambda *_: FakeEnv(episode_length=6)) == 0
    out = capsys.readouterr().out
    assert "episode 2, seed 1002: 6 steps" in out and str(clip) in out
    assert clip.read_bytes()[:3] == b"GIF" and sheet.read_bytes()[:4] == b"\x89PNG"
    assert enjoy.main(words.split(), lambda *_: FakeEnv(episode_length=6)) == 0
    assert capsys.readouterr().out == out  # the seed decides


def test_a_sheet_shows_twenty_moments_from_the_first_to_the_last(tmp_path, monkeypatch):
    shown = []
    monkeypatch.setattr(enjoy, "film", lambda env, frames, *_: shown.extend(frames) or [None])
    monkeypatch.setattr(enjoy, "contact_sheet", lambda *_, labels: shown.append(labels))
    words = f"--env-name FakeReach-v0 --policy random --sheet {tmp_path / 'a.png'}"
    assert enjoy.main(words.split(), lambda *_: FakeEnv(episode_length=50)) == 0
    *frames, labels = shown
    assert [frames[0].step, frames[-1].step] == [0, 50] and len(frames) == 20
    assert len(labels) == 20 and labels[-1].startswith("step 50 ")


@pytest.mark.parametrize("ending", ["success", "failure", "rough"])
def test_enjoy_shows_only_episodes_that_end_so(ending, monkeypatch):
    def finger(newtons):
        act = lambda obs, key, deterministic: jnp.full(2, newtons / HARDEST * 2 - 1)  # noqa: E731
        return enjoy.Player(FakePressEnv(), act)

    monkeypatch.setattr(enjoy, "LOOK_THROUGH", 4)
    so, otherwise = (3.0, 30.0) if ending == "failure" else (30.0, 3.0)
    found = list(finger(so).episodes(1001, ending))
    assert [seed for seed, _ in found] == [1001, 1002, 1003, 1004]
    assert all(enjoy.ends_so(list(frames), ending) for _, frames in found)
    assert list(finger(otherwise).episodes(1001, ending)) == []


def test_enjoy_keeps_what_it_has_found(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(enjoy, "LOOK_THROUGH", 2)
    film = tmp_path / "a.gif"
    words = f"--env-name FakeReach-v0 --policy random --episodes 3 --clip {film} --ending failure"
    words += " --width 64 --height 48 --backend raycast"
    assert enjoy.main(words.split(), lambda *_: FakeEnv(episode_length=6)) == 0
    said = "2 of 3 found: no other of the 2 episodes with seeds 1001 to 1002 is a failure.\n"
    assert said in capsys.readouterr().out
    assert film.is_file()
    words = words.replace("failure", "success")
    assert enjoy.main(words.split(), lambda *_: FakeEnv(episode_length=6)) == 2
    said = "None of the 2 episodes with seeds 1001 to 1002 is a success. Try another --seed, or --ending any."
    assert said in capsys.readouterr().err


@pytest.mark.parametrize("terminal", [True, False])
def test_a_search_shows_the_seed_it_looks_at(terminal, monkeypatch, capsys):
    seconds = itertools.count(0, 4)  # each episode takes 4 s
    monkeypatch.setattr(enjoy, "time", SimpleNamespace(monotonic=lambda: next(seconds)))
    monkeypatch.setattr(sys.stderr, "isatty", lambda: terminal)
    monkeypatch.setattr(enjoy, "LOOK_THROUGH", 5)
    monkeypatch.setattr(enjoy.Player, "episode", lambda *_: [SimpleNamespace(success=True)])
    player = enjoy.Player(FakeEnv(), baseline_policy("zero", 2))
    assert list(player.episodes(1001, "failure")) == []
    said = capsys.readouterr().err
    if terminal:
        assert said.count("\rLooking at seed 100") == 5 and said.endswith(f"\r{' ' * 20}\r")
    else:
        assert said == "Looking at seed 1001\nLooking at seed 1004\n"


@pytest.mark.parametrize(
    ("terminal", "seconds", "done", "left"),
    [
        (True, 0.25, [], []),  # short enough to say nothing
        (False, 0.25, [], []),
        (True, 1.0, [3, 4, 5, 6], [4, 3, 2, 1]),
        (False, 4.0, [1, 4], [24, 12]),
    ],
)
def test_drawing_shows_how_long_it_will_take(terminal, seconds, done, left, monkeypatch, capsys):
    now = 0.0

    def markers(*_):
        nonlocal now
        now += seconds  # of each picture
        return []

    monkeypatch.setattr(enjoy, "time", SimpleNamespace(monotonic=lambda: now))
    monkeypatch.setattr(sys.stderr, "isatty", lambda: terminal)
    env = FakeEnv(episode_length=6)
    monkeypatch.setattr(env, "markers", markers)
    frames = list(enjoy.Player(env, baseline_policy("zero", 2)).episode(1001))
    config = enjoy.EnjoyConfig(width=16, height=12, backend="raycast")
    with enjoy.Notice(enjoy.QUIET) as notice:
        assert len(enjoy.film(env, frames, config, notice)) == 7
    texts = [f"Drawing 7 pictures: {i}, about {x} s left" for i, x in zip(done, left, strict=True)]
    if terminal:
        in_place = "".join(f"\r{text}" for text in texts)
        assert capsys.readouterr().err == in_place + (f"\r{' ' * 37}\r" if texts else "")
    else:
        assert capsys.readouterr().err == "".join(f"{text}\n" for text in texts)


def test_enjoy_refuses_a_wrong_suffix_at_once(capsys):
    words = "--env-name FakeReach-v0 --policy zero --clip film.avi"
    assert enjoy.main(words.split(), lambda *_: pytest.fail("too late")) == 2
    assert "must end in .gif or .mp4" in capsys.readouterr().err
