# ruff: noqa: D103 (a test's name says what it shows)
"""Policies: saved and loaded, by id, file or folder; what ships; what is refused."""

from __future__ import annotations

import dataclasses
import re
import shutil
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from fake_env import FakeEnv

import agym_jax
import agym_jax.policy
from agym_jax.data.assets import asset_root
from agym_jax.data.npz import read_npz, write_npz
from agym_jax.errors import (
    PolicyDamagedError,
    PolicyEnvironmentError,
    PolicyLayoutError,
    PolicyNotFoundError,
)
from agym_jax.observe import layout_version, size
from agym_jax.policy import Pair, Policy, load_policy, save_policy
from agym_jax.policy.agents import BASELINES, baseline_policy
from agym_jax.policy.files import (
    PolicyFiles,
    find_policies,
    find_policy,
    load_agent,
    load_policies,
)
from agym_jax.policy.networks import Architecture, init_policy, make_networks
from agym_jax.registry import parse, static_id
from agym_jax.tasks import TASKS

INFO = {"env": "FakeReach-v0", "layout": "fake-1", "commit": None, "versions": {}}


def make_policy(distribution="normal", head_gain=1.0):
    """An untrained policy for the fake environment."""
    arch = Architecture(4, 2, (8,), (8,), "tanh", distribution, policy_head_gain=head_gain)
    weights = init_policy(make_networks(arch), arch, jax.random.PRNGKey(0))
    return Policy(weights, jnp.zeros(4), jnp.ones(4), arch, INFO)


@pytest.fixture(scope="module")
def policy():
    """A policy."""
    return make_policy()


@pytest.mark.parametrize("distribution", ["normal", "tanh_normal"])
def test_a_policy_comes_back_and_acts_the_same(tmp_path, distribution):
    policy = make_policy(distribution)
    loaded = load_policy(save_policy(tmp_path / "new" / "p.npz", policy), FakeEnv())
    obs = 3 * jax.random.normal(jax.random.PRNGKey(1), (7, 4))
    assert np.array_equal(loaded(obs), policy(obs))
    key = jax.random.PRNGKey(2)
    sampled = loaded(obs, key, deterministic=False)
    assert np.array_equal(sampled, policy(obs, key, deterministic=False))
    assert not np.array_equal(sampled, loaded(obs))
    assert sampled.shape == (7, 2) and np.abs(sampled).max() <= 1
    assert loaded(obs[0]).shape == (2,)
    assert loaded.info["env"] == "FakeReach-v0" and loaded.arch == policy.arch
    with pytest.raises(ValueError, match="needs a key"):
        loaded(obs, deterministic=False)


def test_a_policy_can_be_jitted_itself(policy):
    obs = jnp.ones((3, policy.arch.observation_size))
    np.testing.assert_allclose(jax.jit(policy)(obs), policy(obs), atol=1e-6)
    pair = Pair(policy, policy, policy.arch.observation_size)
    both = jnp.concatenate([obs, obs], -1)
    np.testing.assert_allclose(jax.jit(pair)(both), pair(both), atol=1e-6)


def test_the_mode_of_a_gaussian_is_clipped_not_squashed():
    policy = make_policy(head_gain=50.0)
    obs = 3 * jax.random.normal(jax.random.PRNGKey(1), (50, 4))
    assert np.abs(policy(obs)).max() == 1.0


def test_a_missing_policy_lists_what_is_there(tmp_path, policy, monkeypatch):
    save_policy(tmp_path / "reach.npz", policy)
    with pytest.raises(PolicyNotFoundError, match=r"raech.npz.*Did you mean 'reach.npz'.*ship for"):
        load_policy(tmp_path / "raech.npz")
    save_policy(tmp_path / "FakeReach-v0" / "policy.npz", policy)
    assert find_policy("FakeReach-v0", tmp_path).is_file()
    with pytest.raises(PolicyNotFoundError, match=r"holds runs, not a policy.*/FakeReach-v0\."):
        load_policy(tmp_path)
    monkeypatch.chdir(tmp_path.parent)
    assert load_policy(tmp_path.name, FakeEnv()).info["env"] == "FakeReach-v0"
    with pytest.raises(PolicyNotFoundError, match="holds runs, not a policy"):
        load_policy(tmp_path.name)
    with pytest.raises(PolicyNotFoundError, match=r"holds runs, not a policy.*/FakeReach-v0\."):
        load_policy(tmp_path, FakeEnv(name="OtherReach-v0"))
    text = r"No policy for 'FakeReech-v0'.*Did you mean 'FakeReach-v0'.*agym-jax train"
    with pytest.raises(PolicyNotFoundError, match=text):
        find_policy("FakeReech-v0", tmp_path)
    with pytest.raises(
        PolicyNotFoundError, match=r"ships no policy for 'FakeReach-v0'.*agym-jax train"
    ):
        find_policy("FakeReach-v0")


def test_a_run_is_known_by_its_folder_or_the_one_around_it(tmp_path, policy):
    run = tmp_path / "FakeReach-v0"
    save_policy(run / "policy.npz", policy)
    for folder in (tmp_path, run):
        assert find_policy("FakeReach-v0", folder) == run / "policy.npz"
    assert load_policy(run).arch == policy.arch
    assert load_policy(tmp_path, FakeEnv()).arch == policy.arch


def test_a_run_of_several_seeds_says_that_one_is_to_be_chosen(tmp_path, policy):
    run = tmp_path / "FakeReach-v0"
    for seed in (1, 2):
        save_policy(run / f"seed_{seed}" / "policy.npz", policy)
    text = rf"2 seeds, .*agym-jax select {run}; .*--policy {run}/seed_1/policy.npz"
    with pytest.raises(PolicyNotFoundError, match=text):
        find_policy("FakeReach-v0", tmp_path)
    with pytest.raises(PolicyNotFoundError, match=text):
        load_policy(run)


def test_a_policy_says_what_it_is_and_what_it_takes(policy):
    said = repr(policy)
    assert re.fullmatch(r"Policy\(FakeReach-v0, \d+ -> 2\)", said), said
    size = policy.arch.observation_size
    with pytest.raises(ValueError, match=rf"\(\.\.\., {size}\), got \({size + 1},\)"):
        policy(jnp.zeros(size + 1))


SHIPPED = sorted((asset_root() / "policies").glob("*.npz"))


def test_every_environment_ships_with_a_policy():
    assert {file.stem for file in SHIPPED} == set(agym_jax.list_envs())


@pytest.mark.parametrize("file", SHIPPED, ids=lambda file: file.stem)
def test_every_shipped_policy_loads_for_its_agents_of_today(file):
    task, policy = parse(file.stem).task, agym_jax.load_policy(file.stem)
    pair = isinstance(policy, Pair)
    assert pair == parse(file.stem).active
    members = {"robot": policy.robot, "human": policy.human} if pair else {"robot": policy}
    for agent, one in members.items():
        record = task.robot_obs if agent == "robot" else task.human_obs
        # a pair's robot may have learned with the passive person
        origins = {file.stem, static_id(file.stem)} if agent == "robot" else {file.stem}
        assert one.info["agent"] == agent and one.info["env"] in origins
        known = layout_version(record), layout_version(record, former=True)
        assert one.info["layout"] in known
        assert one.arch.observation_size == size(record)
    sizes = [(one.arch.observation_size, one.arch.action_size) for one in members.values()]
    seen, moved = map(sum, zip(*sizes, strict=True))
    action = policy(jnp.zeros((3, seen)))
    assert action.shape == (3, moved) and np.isfinite(action).all()


FORMER = {
    "ScratchItch": ("abbc19169540", "fa72ed9f808e", "5c7dd27aa3c8"),
    "BedBathing": ("ce0c90227def", "8865741e8731", "eae8135dcfc6"),
    "Feeding": ("a29fbe638cea", "5bddeb2eed80", "49b38c6ea370"),
    "Drinking": ("a29fbe638cea", "5bddeb2eed80", "49b38c6ea370"),
    "Reaching": ("3a615b5fc44a", "5e311a9ce5d5", "44887518fcbe"),
}
"""Layouts of robot, human and both, as files say that were written before columns were renamed. The forces in the
observations of Dressing and ArmManipulation have changed since."""


@pytest.mark.parametrize("name", FORMER)
def test_layouts_from_before_columns_were_renamed_are_known(name):
    robot, human = TASKS[name].robot_obs, TASKS[name].human_obs
    former = [
        layout_version(*records, former=True) for records in ((robot,), (human,), (robot, human))
    ]
    assert tuple(former) == FORMER[name]
    assert layout_version(human) != former[1] and set(FORMER) == {*TASKS} - {
        "Dressing",
        "ArmManipulation",
    }


def test_policies_from_before_columns_were_renamed_fit(tmp_path):
    """Their agents are called "person"; a run of that time has person_policy.npz."""
    static_env, active_env = (agym_jax.make(f"ScratchItchPR2{x}-v0") for x in ("", "Human"))
    pair = agym_jax.load_policy(active_env.name, active_env)
    run = tmp_path / active_env.name
    run.mkdir()
    human = tmp_path / "human.npz"
    for policy, layout, agent, file in (
        (pair.robot, 0, "robot", run / "policy.npz"),
        (pair.human, 1, "person", human),
    ):
        former = {"agent": agent, "layout": FORMER["ScratchItch"][layout]}
        save_policy(file, dataclasses.replace(policy, info={**policy.info, **former}))
        assert read_npz(file)[1]["agent"] == agent
    shutil.copy(human, run / "person_policy.npz")
    obs = jnp.linspace(-1, 1, active_env.observation_size)
    for source in (run, str(run)):
        assert np.array_equal(agym_jax.load_policy(source, active_env)(obs), pair(obs))
    assert find_policies(active_env.name, str(tmp_path)).human == str(run / "person_policy.npz")
    shutil.copy(human, run / "human_policy.npz")  # of a session since then
    assert find_policies(active_env.name, str(tmp_path)).human == str(run / "human_policy.npz")
    with pytest.raises(PolicyEnvironmentError, match="moves the person"):
        agym_jax.load_policy(human, static_env)


def test_a_policy_is_loaded_by_id_file_or_folder(tmp_path, monkeypatch, policy):
    shipped = agym_jax.load_policy("ReachingJaco-v0")
    file = asset_root() / "policies" / "ReachingJaco-v0.npz"
    obs = jnp.linspace(-1, 1, shipped.arch.observation_size)
    for source in (file, str(file), "agym_jax:ReachingJaco-v0", "agym_jax/ReachingJaco-v0"):
        assert np.array_equal(agym_jax.load_policy(source)(obs), shipped(obs))
    monkeypatch.chdir(tmp_path)
    save_policy("ReachingJaco-v0/policy.npz", policy)
    assert agym_jax.load_policy("./ReachingJaco-v0").arch == policy.arch  # a slash: a path
    assert agym_jax.load_policy("ReachingJaco-v0").arch == shipped.arch  # none: an id
    assert agym_jax.load_policy(Path("ReachingJaco-v0")).arch == policy.arch
    with pytest.raises(PolicyNotFoundError, match=r"Did you mean 'ReachingJaco-v0'"):
        agym_jax.load_policy("ReachingJako-v0")
    with pytest.raises(PolicyNotFoundError, match="holds runs, not a policy"):
        agym_jax.load_policy(tmp_path)


def test_names_that_users_import_are_kept():
    """Frozen: a name here is in somebody's code. To rename one, leave the old one working."""
    assert sorted(agym_jax.__all__) == [
        "AgymError", "Env", "Population", "RobotVariation", "State", "list_envs", "load_policy", "make", "register_envs",
    ]  # fmt: skip
    assert sorted(agym_jax.policy.__all__) == [
        "Baseline", "Pair", "Policy", "baseline_policy", "check_policy", "load_policy",
        "save_policy",
    ]  # fmt: skip
    for module in (agym_jax, agym_jax.policy):
        assert all(hasattr(module, name) for name in module.__all__)


def test_a_shipped_robot_goes_with_the_person_who_acts_too(static_env, active_env):
    shipped = find_policy(static_env.name)
    robot = load_policy(shipped, static_env)
    pair = load_policies(PolicyFiles(str(shipped), "zero"), active_env)
    obs = jnp.linspace(-1, 1, active_env.observation_size)
    assert np.array_equal(pair(obs)[:7], robot(obs[:30])) and not pair(obs)[7:].any()


def test_a_damaged_policy_is_refused(tmp_path, policy):
    path = save_policy(tmp_path / "p.npz", policy)
    path.write_bytes(path.read_bytes()[:-200])
    with pytest.raises(PolicyDamagedError, match=r"p.npz is damaged.*again"):
        load_policy(path)


def test_a_checkpoint_is_not_a_policy(tmp_path):
    write_npz(tmp_path / "c.npz", {"params/x": np.zeros(2)}, {"format": 1})
    with pytest.raises(PolicyDamagedError, match="is not a policy"):
        load_policy(tmp_path / "c.npz")


def test_a_policy_of_another_environment_or_layout_is_refused(tmp_path, policy):
    path = save_policy(tmp_path / "p.npz", policy)
    other = FakeEnv(name="FakePush-v0")
    with pytest.raises(
        PolicyEnvironmentError, match=r"trained in 'FakeReach-v0', not in 'FakePush-v0'"
    ):
        load_policy(path, other)
    assert load_agent(path, other, "robot", any_env=True).arch == policy.arch
    with pytest.raises(PolicyLayoutError, match=r"layout 'fake-1'.*'fake-2'.*Train it again"):
        load_policy(path, FakeEnv(layout_version="fake-2"))
    with pytest.raises(
        PolicyLayoutError, match=r"4 observations and gives 2 actions.* has 4 and 3"
    ):
        load_policy(path, FakeEnv(action_sizes={"robot": 3}))


def test_baselines_are_named():
    assert BASELINES == ("zero", "random")
    assert baseline_policy("zero", 3)(jnp.ones((4, 9))).shape == (4, 3)
