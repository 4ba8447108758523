# ruff: noqa: D103 (a test's name says what it shows)
"""Restarts: whose moment is continued from, that it goes on as it did, and that new episodes alone are counted."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from fake_env import FakeEnv
from fake_pair_env import FakePairEnv

import agym_jax
from agym_jax.wrappers import shared_reset_interval, vectorize
from train import coop, ppo
from train.configs import CoopConfig, PPOConfig
from train.errors import ConfigError
from train.learning import restarts
from train.learning.agents import Agents
from train.learning.execution import StepwiseEnv
from train.learning.restarts import COPIES, RestartingVectorEnv, choose_sources
from train.learning.rollout import BEYOND, REMEMBERED, RESTARTED, collect, fold_in, init_rollout
from train.runs.session import resolve_config

N = 256
CONFIG = PPOConfig(
    env_name="FakeReach-v0", num_envs=32, num_env_steps=3200, num_steps=10, num_mini_batch=4, save_dir=None,
    restart_share=0.5, log_interval=1, lr=1e-3,
)  # fmt: skip


def choose(success, finished=None, own=None, eligible=None, share=0.5, seed=0):
    """The sources and who restarts, of ``N`` environments."""
    yes = jnp.ones(N, bool)
    rng = np.random.default_rng(seed)
    draws = [jnp.asarray(rng.random(N, dtype=np.float32)) for _ in range(3)]
    finished = yes if finished is None else finished
    own, eligible = (finished if x is None else x for x in (own, eligible))
    source, restart = choose_sources(finished, own, eligible, success, -draws[2], *draws[:2], share)
    return np.asarray(source), np.asarray(restart), np.asarray(draws[2])


def which(*places):
    """True at these places."""
    return jnp.zeros(N, bool).at[jnp.array(places, int)].set(True)


def test_rare_successes_and_the_best_returns_are_continued_from_a_few_times_each():
    counts = np.zeros(N)
    for seed in range(50):
        source, restart, minus_return = choose(which(3, 200), seed=seed)
        best = {3, 200} | set(np.argsort(minus_return)[: N // restarts.BEST])
        assert set(source[restart]) <= best
        assert abs(restart.sum() - COPIES * len(best)) < 4 * np.sqrt(N / 4)
        counts += np.bincount(source[restart], minlength=N)
    assert 0.5 < counts[3] / counts[200] < 2 and counts[3] / 50 == pytest.approx(COPIES, rel=0.25)


@pytest.mark.parametrize("rate", [0.25, 0.75, 1.0])
def test_restarts_become_fewer_as_new_episodes_succeed(rate):
    success = jnp.arange(N) < rate * N
    shares = [choose(success, seed=seed)[1].mean() for seed in range(50)]
    assert np.mean(shares) == pytest.approx(0.5 * (1 - rate), abs=0.02)
    # restarts that succeed do not make it seem easier than it is
    _, restart, _ = choose(success, own=~success if rate < 1 else None)
    assert restart.mean() == pytest.approx(0.5 if rate < 1 else 0.0, abs=0.1)


def test_only_ended_episodes_restart_and_only_from_eligible_ones():
    finished = jnp.arange(N) % 2 == 0
    eligible = which(4, 8)
    source, restart, _ = choose(which(4, 10), finished, eligible=eligible)
    assert restart.any() and not restart[1::2].any()
    assert set(source[restart]) <= {4, 8}
    _, restart, _ = choose(which(4), finished, eligible=which())
    assert not restart.any()


@pytest.mark.parametrize(
    "impl",
    [
        "native",
        pytest.param("jax", marks=pytest.mark.slow),
        pytest.param("warp", marks=[pytest.mark.slow, pytest.mark.warp]),
    ],
)
def test_a_restarted_episode_goes_on_as_the_other_did(impl, monkeypatch):
    if impl == "warp":
        pytest.importorskip("warp", reason='needs pip install "agym_jax[warp]"')
    monkeypatch.setattr(restarts, "BEST", 1)  # random actions never succeed
    venv = RestartingVectorEnv(vectorize(agym_jax.make("ReachingJaco-v0", impl=impl), 8), 1.0, 2)
    reset, step = (
        (venv.reset, venv.step) if impl == "native" else map(jax.jit, (venv.reset, venv.step))
    )
    state = venv.stagger(reset(jax.random.key(0)), jax.random.key(1))
    rng = np.random.default_rng(0)
    seen, actions, found, until = [], [], None, 150
    while found is None or len(seen) < until:
        seen.append(state)
        action = rng.uniform(-1, 1, (8, venv.action_size)).astype(np.float32)
        if found is not None:
            here, there, then = found
            action[here] = actions[then][there]
            found = here, there, then + 1
        state = step(state, action)
        actions.append(action)
        new = np.flatnonzero((state.done > 0) & (np.asarray(state.info[RESTARTED]) > 0))
        if found is None and len(new):
            here, clock = new[0], int(state.episode.step[new[0]])
            same = [
                (t, j) for t, past in enumerate(seen) for j in range(8)
                if past.episode.step[j] == clock and np.array_equal(past.obs[j], state.obs[here])
            ]  # fmt: skip
            assert len(same) == 1, "the moment is one that was seen"
            then, there = same[0]
            assert clock % 25 == 0 and there // 4 == here // 4, "of the same group"
            began = max(then - clock, 0)
            total = sum(float(x.reward[there]) for x in seen[began + 1 : then + 1])
            returned = state.info[REMEMBERED].episode_return[here]
            assert float(returned) == pytest.approx(total, rel=1e-4)
            found, until = (here, there, then), len(seen) + 20
            began, first = len(seen), then
    assert until < 400
    for i in range(20):
        np.testing.assert_allclose(seen[began + i].obs[here], seen[first + i].obs[there], atol=1e-5)


def restarting(num_envs=32, share=1.0, groups=1):
    """Points, some of which continue the way of others."""
    return RestartingVectorEnv(FakeEnv().vectorize(num_envs), share, groups)


def test_what_is_counted_are_new_episodes(monkeypatch):
    monkeypatch.setattr(restarts, "BEST", 2)
    venv = restarting()
    rollout = init_rollout(venv, jax.random.PRNGKey(0), stagger=True)
    state, seen = rollout.env_state, []
    action = jnp.full((32, 2), 0.1)
    known = np.zeros(32)  # begun at a reset, as a new episode
    ended = total = 0.0
    returns = np.zeros(32)
    for _ in range(60):
        state = venv.step(state, action)
        done, restarted = np.asarray(state.done), np.asarray(state.info[RESTARTED])
        returns += np.asarray(state.reward)
        ended += (done * known).sum()
        total += (done * known * returns).sum()
        known, returns = np.where(done > 0, 1 - restarted, known), returns * (1 - done)
        seen.append(restarted.mean())
    assert 0.1 < np.mean(seen) < 0.9

    def act(obs, key):
        return action, action, {"robot": jnp.zeros(32)}

    more = {"num_steps": 60, "gamma": 0.9, "reward_scaling": 1.0}
    _, batch, totals = collect(act, venv, rollout, jax.random.PRNGKey(1), **more)
    assert float(totals["episode/episodes"]) == ended > 20
    assert float(totals["episode/return"]) == pytest.approx(total, rel=1e-4)
    assert batch.obs.shape == (60, 32, 4)


@pytest.mark.slow
def test_a_seed_learns_as_it_would_alone(monkeypatch):
    monkeypatch.setattr(restarts, "BEST", 1)
    both = ppo.train(FakeEnv(), dataclasses.replace(CONFIG, num_seeds=2)).seeds
    for seed, beside in zip((1, 2), both, strict=True):
        alone = ppo.train(FakeEnv(), dataclasses.replace(CONFIG, seed=seed))
        own, other = (np.array([row["return"] for row in x.curve], float) for x in (alone, beside))
        assert np.isfinite(own).sum() > 5
        np.testing.assert_allclose(own, other, rtol=1e-3)
    without = ppo.train(FakeEnv(), dataclasses.replace(CONFIG, restart_share=0.0))
    first = ppo.train(FakeEnv(), CONFIG)
    assert without.curve[-1]["return"] != first.curve[-1]["return"]


def test_c_mujoco_trains_with_restarts():
    config = PPOConfig(
        env_name="ReachingJaco-v0", num_envs=8, num_env_steps=2400, num_steps=20, save_dir=None, restart_share=0.9,
        num_mini_batch=2, impl="native",
    )  # fmt: skip
    result = ppo.train(agym_jax.make("ReachingJaco-v0", impl="native"), config)
    assert result.env_steps == 2400
    assert all(np.isfinite(row["return"]) for row in result.curve if row["episodes"])


@pytest.mark.slow
def test_a_pair_trains_with_restarts():
    config = CoopConfig(
        num_envs=32, num_env_steps=3200, num_steps=10, num_mini_batch=4, save_dir=None, restart_share=0.9,
    )  # fmt: skip
    result = coop.train(FakePairEnv(), config)
    assert set(result.policies) == {"robot", "human"} and np.isfinite(result.curve[-1]["return"])


class WithoutABatch(FakeEnv):
    """Has no batch of its own, as an environment of agym_jax."""

    @property
    def vectorize(self):  # noqa: D102
        raise AttributeError


def test_restarted_episodes_may_end_sooner_than_others():
    def truncated_every(share: float) -> int | None:
        config = dataclasses.replace(CONFIG, restart_share=share)
        return Agents(config, WithoutABatch(), ("robot",)).truncated_every

    length = FakeEnv().episode_length
    assert truncated_every(0.0) == length
    # and once more before the next, where what they continue began anew after a divergence
    assert truncated_every(0.5) == shared_reset_interval(length) // 2 < length


def test_an_environment_whose_step_is_compiled_is_refused():
    with pytest.raises(ConfigError, match="--restart-share does not work with a StepwiseEnv"):
        ppo.train(StepwiseEnv(FakeEnv().vectorize(32)), CONFIG)
    with pytest.raises(ConfigError, match=r"end at different times.*--stagger"):
        resolve_config(FakeEnv(), dataclasses.replace(CONFIG, stagger=False))
    with pytest.raises(ConfigError, match="restart_share must be between 0 and 1, got 2"):
        dataclasses.replace(CONFIG, restart_share=2)


def test_no_key_that_an_environment_or_an_epoch_splits_off_is_used_again():
    key = jax.random.PRNGKey(3)
    others = np.asarray(jax.random.split(key, 1000))
    assert (others == np.asarray(fold_in(key, 1))).all(1).any()  # why not a small number
    assert not (others == np.asarray(fold_in(key, BEYOND))).all(1).any()
