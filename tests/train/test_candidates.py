# ruff: noqa: D103 (a test's name says what it shows)
"""Several candidates of each seed: the best one continues, with what it has learned and its curve."""

from __future__ import annotations

import dataclasses
import json
import time

import numpy as np
import pytest
from fake_env import FakeEnv
from fake_pair_env import FakePairEnv
from test_seeds import SETTINGS, weights

from agym_jax.data.npz import read_npz
from agym_jax.policy.policy import read_policy
from train import coop, ppo
from train.configs import CoopConfig, PPOConfig
from train.envs import vectorize
from train.errors import CheckpointMismatchError, ConfigError
from train.learning.agents import Agents
from train.learning.execution import StepwiseEnv
from train.learning.seeds import SideBySide, candidates_of, lanes_of, stacked
from train.runs import candidates
from train.runs.candidates import score
from train.runs.manager import CheckpointManager
from train.runs.progress import Silent
from train.runs.result import SeedResult, summary

TOTAL = SETTINGS["num_env_steps"]
CONFIG = PPOConfig(**SETTINGS, num_seeds=2, num_candidates=3, candidates_until=0.5)


class Says(Silent):
    """Keeps what a run says, and where its parts begin and end."""

    def __init__(self):
        self.said, self.parts = [], []
        self.say, self.start = self.said.append, lambda *steps: self.parts.append(steps)


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    folder, says = tmp_path_factory.mktemp("candidates"), Says()
    config = dataclasses.replace(CONFIG, save_dir=str(folder))
    return ppo.train(FakeEnv(), config, says), folder / "FakeReach-v0", says


def rows(path):
    return [json.loads(line) for line in path.read_text().splitlines()]


def test_the_first_candidate_of_a_seed_is_the_training_without_candidates():
    lanes = candidates_of(CONFIG)
    assert [lane.name for lane in lanes[::3]] == ["seed_3/candidate_1", "seed_4/candidate_1"]
    assert [lane.seed for lane in lanes[::3]] == [lane.seed for lane in lanes_of(CONFIG)] == [3, 4]
    assert len({lane.seed for lane in lanes}) == len(lanes) == 6


def test_the_best_candidate_of_each_seed_continues_with_its_curve(run):
    result, folder, says = run
    assert says.parts == [(0, 960), (960, 1920)]
    assert result.env_steps == 1920 and result.session_steps == 6 * 960 + 2 * 960
    assert [found.name for found in result.seeds] == ["seed_3", "seed_4"]
    for seed in result.seeds:
        each = [folder / f"candidates/{seed.name}/candidate_{i}/curve.jsonl" for i in (1, 2, 3)]
        curves = [rows(path) for path in each]
        best = max(curves, key=lambda curve: score(curve, TOTAL))
        written = rows(folder / seed.name / "curve.jsonl")
        assert seed.curve[: len(best)] == best == written[: len(best)]
        assert [row["env_steps"] for row in seed.curve] == [640, 960, 1600, 1920]
        number = curves.index(best) + 1
        assert f"candidate {number} of {seed.name}" in says.said[-1]
        assert read_policy(folder / seed.name / "policy.npz").info["candidate"] == number
        about = json.loads((folder / "config.json").read_text())["candidates"]
        assert about["chosen"][seed.name] == number
        assert (about["count"], about["until"], about["rule"]) == (3, 0.5, "success")
    assert [row["num_seeds"] for row in result.curve] == [2, 2, 2, 2]


def test_what_the_best_has_learned_is_what_continues(run):
    result, folder, _ = run
    of_all, _ = read_npz(folder / "candidates/checkpoints/step_000000000960.npz")
    begun, meta = read_npz(folder / "checkpoints/step_000000000960.npz")
    for i, seed in enumerate(result.seeds):
        at = 3 * i + meta["candidates"]["chosen"][seed.name] - 1
        for name, leaf in begun.items():
            np.testing.assert_array_equal(leaf[i], of_all[name][at], err_msg=name)


def test_the_first_candidate_learns_as_its_seed_would_alone(run):
    _, folder, _ = run
    stop = lambda row, policy: row["env_steps"] >= 960  # noqa: E731
    config = dataclasses.replace(CONFIG, num_candidates=1, log_interval=1)
    for seed in ppo.train(FakeEnv(), config, on_log=stop).seeds:
        first, second = (
            weights(
                {"robot": read_policy(folder / f"candidates/{seed.name}/candidate_{i}/policy.npz")}
            )
            for i in (1, 2)
        )
        np.testing.assert_allclose(first, weights(seed.policies), atol=2e-4)
        assert abs(second - first).max() > 0.01


@pytest.mark.slow
def test_a_run_is_resumed_in_either_part(tmp_path):
    config = dataclasses.replace(CONFIG, save_dir=str(tmp_path))
    took = []
    for steps in (640, 960, 1600):  # the last log line of the candidates too
        stop = lambda row, policy, steps=steps: row["env_steps"] >= steps  # noqa: E731
        began = time.perf_counter()
        found = ppo.train(FakeEnv(), config, on_log=stop)
        took.append((found.compile_seconds + found.train_seconds, time.perf_counter() - began))
        assert found.interrupted and found.env_steps == steps
        assert found.of_candidates == (steps <= 960)
        assert ("of 6 candidates" in summary(found)) == (steps <= 960)
    assert all(counted <= passed for counted, passed in took)
    with pytest.raises(CheckpointMismatchError, match=r"of 2 trainings \(seed_3, seed_4\)"):
        ppo.train(FakeEnv(), dataclasses.replace(config, num_seeds=3))
    says = Says()
    found = ppo.train(FakeEnv(), dataclasses.replace(config, num_candidates=1), says)
    assert found.env_steps == 1920 and says.parts == [(1600, 1920)]
    assert "began with 3 candidates for each seed, until 50% of the steps" in says.said[0]
    for seed in found.seeds:
        assert [row["env_steps"] for row in seed.curve] == [640, 960, 1600, 1920]
        seconds = [row["seconds"] for row in seed.curve]
        assert seconds == sorted(seconds) and seconds[0] > 0


def test_candidates_are_not_left_behind_unnoticed(tmp_path):
    config = dataclasses.replace(CONFIG, save_dir=str(tmp_path))
    ppo.train(FakeEnv(), config, on_log=lambda row, policy: True)
    without = dataclasses.replace(config, num_candidates=1)
    with pytest.raises(CheckpointMismatchError, match="candidates of which none has been chosen"):
        ppo.train(FakeEnv(), without)
    found = ppo.train(FakeEnv(), dataclasses.replace(without, fresh=True))
    assert found.env_steps == 1920


def test_a_run_without_candidates_says_that_it_gets_none_later(tmp_path):
    config = dataclasses.replace(CONFIG, save_dir=str(tmp_path), num_candidates=1, num_seeds=1)
    ppo.train(FakeEnv(), config, on_log=lambda row, policy: True)
    says = Says()
    ppo.train(FakeEnv(), dataclasses.replace(config, num_candidates=4), says)
    assert "This run began with no candidates" in says.said[0]


def test_one_seed_of_several_candidates_is_a_plain_run(tmp_path):
    config = dataclasses.replace(CONFIG, num_seeds=1, save_dir=str(tmp_path))
    found = ppo.train(FakeEnv(), config)
    assert [seed.name for seed in found.seeds] == ["seed_3"]
    assert (tmp_path / "FakeReach-v0/policy.npz").is_file()
    assert [row["env_steps"] for row in found.curve] == [640, 960, 1600, 1920]


@pytest.mark.slow
def test_pairs_have_candidates_too(tmp_path):
    settings = SETTINGS | {"save_dir": str(tmp_path), "central_critic": True}
    found = coop.train(FakePairEnv(), CoopConfig(**settings, num_candidates=2))
    assert found.env_steps == 1920 and set(found.policies) == {"robot", "human"}
    assert (found.folder / "candidates/seed_3/candidate_2/human_policy.npz").is_file()


def test_a_candidate_that_diverges_is_not_chosen_while_another_is_sound():
    agents = Agents(CONFIG, FakeEnv(), ("robot",))
    side, whole = (SideBySide(agents, of(CONFIG)) for of in (candidates_of, lanes_of))
    learners = [agents.init(key) for key in np.arange(12, dtype=np.uint32).reshape(6, 2)]
    returns, lost = [5.0, 1.0, 2.0, 5.0, 9.0, 7.0], [True, False, False, True, True, True]
    seeds = [
        SeedResult(lane.name, lane.seed, {}, curve_of(x), "before step 320" if y else "")
        for lane, x, y in zip(side.lanes, returns, lost, strict=True)
    ]
    before = type("Result", (), {"seeds": seeds, "learner": stacked(learners)})
    manager = CheckpointManager(FakeEnv(), CONFIG, whole, None)
    learner = candidates.hand_over(before, CONFIG, agents, manager, str)
    assert manager.candidates["chosen"] == {"seed_3": 3, "seed_4": 2}
    assert manager.stopped == {"seed_4": "before step 320"}
    assert [curve[0]["return_per_step"] for curve in manager.curves] == [2.0, 9.0]
    for i, j in enumerate([2, 4]):
        np.testing.assert_array_equal(whole.of_seeds(learner)[i].key, learners[j].key)


def curve_of(*returns, success=0.0, **more):
    return [
        {
            "return_per_step": x,
            "success": success,
            "episodes": 1,
            "env_steps": 320 * i,
            "seconds": i,
        }
        | more
        for i, x in enumerate(returns, 1)
    ]


def test_the_newest_part_of_a_curve_counts():
    assert score(curve_of(100.0, 1.0, 3.0), 640 * 20) == (0.0, 2.0)
    assert score(curve_of(100.0, 1.0, 3.0), 320) == (0.0, 3.0)
    assert score([], 320) < score(curve_of(-1e9), 320) < score(curve_of(0.0), 320)


def test_success_counts_before_return():
    parked, starts = curve_of(10.0), curve_of(-20.0, success=0.1)
    assert score(parked, 320) < score(starts, 320)
    unknown = curve_of(0.0) + curve_of(0.0, success=None)  # no episode has ended
    assert score(unknown, 320) == (0.0, 0.0)


def test_rows_count_by_their_episodes():
    curve = [
        {"return_per_step": 0.0, "success": x, "episodes": n, "env_steps": 320}
        for x, n in ((1, 30), (0, 10))
    ]
    assert score(curve, 320) == (0.75, 0.0)


def test_under_a_cost_limit_gentle_successes_count_as_much():
    rough, gentle = curve_of(0.0, success=0.8, gentle=0.0), curve_of(0.0, success=0.6, gentle=0.5)
    assert score(rough, 320) > score(gentle, 320)
    assert score(rough, 320, limited=True) < score(gentle, 320, limited=True)


def test_a_seed_of_which_all_candidates_diverge_stays_stopped(monkeypatch):
    plain = SideBySide.hyper

    def hyper(self, total_steps):
        found = plain(self, total_steps)
        if self.count == 6:  # the candidates
            found.lr[:3] = np.nan
        return found

    monkeypatch.setattr(SideBySide, "hyper", hyper)
    found = ppo.train(FakeEnv(), dataclasses.replace(CONFIG, log_interval=1))
    assert [bool(seed.stopped) for seed in found.seeds] == [True, False]
    assert found.curve[-1]["num_seeds"] == 1 and found.env_steps == 1920


def test_curves_that_ended_early_are_combined_as_far_as_they_go():
    lanes = lanes_of(CONFIG)
    agents = SideBySide(Agents(CONFIG, FakeEnv(), ("robot",)), lanes)
    manager = CheckpointManager(FakeEnv(), CONFIG, agents, None, lanes)
    manager.continue_curves([curve_of(1.0), curve_of(3.0, 5.0)])
    assert [row["num_seeds"] for row in manager.combined] == [2, 1]
    assert [row["return_per_step"] for row in manager.combined] == [2.0, 5.0]
    assert manager.seconds == 2


def test_sweeps_and_stepwise_environments_have_no_candidates():
    with pytest.raises(ConfigError, match="does not work in a sweep, or with a StepwiseEnv"):
        ppo.train(StepwiseEnv(vectorize(FakeEnv(), 32)), CONFIG)


@pytest.mark.parametrize(
    "changes", [{"num_candidates": 0}, {"candidates_until": 0.0}, {"candidates_until": 1.5}]
)
def test_impossible_settings_are_refused(changes):
    with pytest.raises(ConfigError, match=next(iter(changes))):
        PPOConfig(**changes)
