# ruff: noqa: D103 (a test's name says what it shows)
"""Several candidates of each seed: the one with the largest return goes on, with what it has learned and its curve."""

from __future__ import annotations

import dataclasses
import json

import numpy as np
import pytest
from fake_env import FakeEnv
from test_seeds import SETTINGS

from train import ppo
from train.configs import PPOConfig
from train.errors import ConfigError
from train.learning.agents import Agents
from train.learning.seeds import SideBySide, candidates_of, lanes_of, stacked
from train.runs import candidates
from train.runs.candidates import score
from train.runs.progress import Silent
from train.runs.result import SeedResult

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
        curves = [
            rows(folder / f"candidates/{seed.name}/candidate_{i}/curve.jsonl") for i in (1, 2, 3)
        ]
        best = max(curves, key=score)
        assert (
            seed.curve[: len(best)] == best == rows(folder / seed.name / "curve.jsonl")[: len(best)]
        )
        assert [row["env_steps"] for row in seed.curve] == [640, 960, 1600, 1920]
        number = curves.index(best) + 1
        assert f"{number} of {seed.name}" in says.said[-1]
    assert [row["num_seeds"] for row in result.curve] == [2, 2, 2, 2]
    assert result.curve[-1]["seconds"] > result.curve[1]["seconds"]


def test_candidates_learn_as_seeds_do(run):
    _, folder, _ = run
    half = dataclasses.replace(CONFIG, num_candidates=1, num_env_steps=1920)
    stop = lambda row, policy: row["env_steps"] >= 960  # noqa: E731
    alone = ppo.train(FakeEnv(), dataclasses.replace(half, log_interval=1), on_log=stop)
    for seed in alone.seeds:
        kept = rows(folder / f"candidates/{seed.name}/candidate_1/curve.jsonl")
        assert kept[-1]["env_steps"] == seed.curve[-1]["env_steps"] == 960
        np.testing.assert_allclose(
            kept[-1]["loss/noise_std"], seed.curve[-1]["loss/noise_std"], rtol=1e-4
        )


def test_a_run_is_resumed_in_either_part(tmp_path):
    config = dataclasses.replace(CONFIG, save_dir=str(tmp_path))
    for steps in (640, 1600):
        stop = lambda row, policy, steps=steps: row["env_steps"] >= steps  # noqa: E731
        found = ppo.train(FakeEnv(), config, on_log=stop)
        assert found.interrupted and found.env_steps == steps
    says = Says()
    found = ppo.train(FakeEnv(), config, says)
    assert found.env_steps == 1920 and says.parts == [(1600, 1920)]
    assert [row["env_steps"] for row in found.seeds[0].curve] == [640, 960, 1600, 1920]


def test_one_seed_of_several_candidates_is_a_plain_run(tmp_path):
    config = dataclasses.replace(CONFIG, num_seeds=1, save_dir=str(tmp_path))
    found = ppo.train(FakeEnv(), config)
    assert [seed.name for seed in found.seeds] == ["seed_3"]
    assert (tmp_path / "FakeReach-v0/policy.npz").is_file()
    assert [row["env_steps"] for row in found.curve] == [640, 960, 1600, 1920]


def test_a_candidate_that_diverges_is_not_chosen_while_another_is_sound():
    agents = Agents(CONFIG, FakeEnv(), ("robot",))
    side = SideBySide(agents, candidates_of(CONFIG))
    learners = [agents.init(key) for key in np.arange(12, dtype=np.uint32).reshape(6, 2)]
    returns, lost = [5.0, 1.0, 2.0, 5.0, 9.0, 7.0], [True, False, False, True, True, True]
    seeds = [
        SeedResult(lane.name, lane.seed, {}, curve_of(x), "before step 320" if y else "")
        for lane, x, y in zip(side.lanes, returns, lost, strict=True)
    ]
    result = type("Result", (), {"seeds": seeds, "learner": stacked(learners)})
    chosen = candidates.choose(result, CONFIG, agents)
    assert chosen.numbers == {"seed_3": 3, "seed_4": 2}
    assert chosen.stopped == {"seed_4": "before step 320"}
    for i, j in enumerate([2, 4]):
        np.testing.assert_array_equal(
            SideBySide(agents, lanes_of(CONFIG)).of_seeds(chosen.learner)[i].key, learners[j].key
        )


def curve_of(*returns, success=0.0):
    return [{"return_per_step": x, "success": success} for x in returns]


def test_of_a_curve_the_newest_rows_count():
    assert score(curve_of(100.0, 1.0, 2.0, 3.0, 4.0)) == (0.0, 2.5)
    assert score([]) < score(curve_of(-1e9)) < score(curve_of(0.0))


def test_success_counts_before_return():
    parked, starts = curve_of(10.0), curve_of(-20.0, success=0.1)
    assert score(parked) < score(starts)
    unknown = [{"return_per_step": 0.0, "success": None}]  # no episode has ended
    assert score(unknown) == (0.0, 0.0)


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


@pytest.mark.parametrize(
    "changes", [{"num_candidates": 0}, {"candidates_until": 0.0}, {"candidates_until": 1.5}]
)
def test_impossible_settings_are_refused(changes):
    with pytest.raises(ConfigError, match=next(iter(changes))):
        PPOConfig(**changes)
