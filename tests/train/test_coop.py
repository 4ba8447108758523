# ruff: noqa: D103 (a test's name says what it shows)
"""Two learners on the fake pair of carts, from end to end."""

from __future__ import annotations

import dataclasses
import json

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from fake_pair_env import FakePairEnv
from products import full
from train_runs import check_continued, check_restored, kill_in_training, listening, same_bytes

import agym_jax
from agym_jax.errors import PolicyEnvironmentError, PolicyNotFoundError
from agym_jax.policy import Pair, baseline_policy, load_policy
from agym_jax.policy.agents import parts
from agym_jax.policy.files import load_agent
from train import coop, ppo
from train.configs import CoopConfig, PPOConfig
from train.errors import ActiveHumanError, CheckpointMismatchError, ConfigError
from train.evaluate import Evaluator
from train.learning.agents import Agents
from train.learning.ppo import Hyper
from train.learning.rollout import collect, critic_obs, init_rollout
from train.runs.checkpoint import checkpoint_files
from train.runs.result import summary

CONFIG = CoopConfig(
    env_name="FakeCarryHuman-v0",
    num_env_steps=60_000,
    num_envs=32,
    num_mini_batch=4,
    policy_hidden=(32,),
    value_hidden=(64, 64),
    lr=2e-3,
    log_interval=8,
)
SMALL = dataclasses.replace(CONFIG, num_envs=4, num_env_steps=80, save_dir=None)
PAIR = ("robot", "human")
HYPER = Hyper.of(SMALL, 800)
CRITICS = pytest.mark.parametrize("central", [False, True], ids=["own critic", "central critic"])


@pytest.fixture(scope="module")
def trained(tmp_path_factory):
    """A finished run: environment and result."""
    env = FakePairEnv()
    folder = tmp_path_factory.mktemp("trained")
    return env, coop.train(env, dataclasses.replace(CONFIG, save_dir=str(folder)))


def updated(config, env=None):
    """Two agents, their state, a rollout of theirs and what follows it."""
    env = env or FakePairEnv()
    venv, agents = env.vectorize(config.num_envs), Agents(config, env, PAIR)
    learner = jax.jit(agents.init)(jax.random.PRNGKey(0))
    rollout = jax.jit(lambda key: init_rollout(venv, key, True))(jax.random.PRNGKey(1))
    rollout, batch, _ = jax.jit(
        lambda rollout, key: collect(
            lambda obs, key: agents.act(learner, obs, key),
            venv,
            rollout,
            key,
            num_steps=config.num_steps,
            gamma=config.gamma,
            reward_scaling=1.0,
        )
    )(rollout, jax.random.PRNGKey(2))
    return agents, learner, batch, critic_obs(rollout.env_state)


def with_other_weights(learner, agent):
    """The learner with the networks of one agent replaced by noise."""
    state = learner.agents[agent]
    noise = jax.tree.map(lambda x: x + jnp.cos(jnp.arange(x.size)).reshape(x.shape), state.params)
    states = {**learner.agents, agent: dataclasses.replace(state, params=noise)}
    return dataclasses.replace(learner, agents=states)


def test_two_learn_together_what_neither_can_do_alone(trained):
    _, result = trained
    assert result.curve[0]["success"] < 0.5 and result.last("success") > 0.9
    measure, key = Evaluator(FakePairEnv(), 64), jax.random.PRNGKey(3)
    robot, human, idle = *result.policies.values(), baseline_policy("zero", 1)
    assert measure(Pair(robot, human, 2), key).success > 0.95
    assert measure(Pair(robot, idle, 2), key).success == 0
    assert measure(Pair(idle, human, 2), key).success == 0


def test_both_are_trained_in_one_compiled_program(trained):
    env, result = trained
    assert len(result.curve) > 5
    assert env.traces == {"reset": 1, "step": 1}


def test_the_folder_has_both_policies(trained):
    env, result = trained
    names = {p.name for p in result.folder.iterdir()}
    assert names >= {"config.json", "curve.jsonl", "curve.png", "checkpoints"}
    assert {n for n in names if n.endswith(".npz")} == {"policy.npz", "human_policy.npz"}
    obs = jax.random.normal(jax.random.PRNGKey(0), (5, 3))
    for agent, name in (("robot", "policy.npz"), ("human", "human_policy.npz")):
        policy = load_agent(result.folder / name, env, agent)
        assert policy.info["agent"] == agent and policy.info["env_steps"] == result.env_steps
        seen = obs[:, : env.observation_sizes[agent]]
        assert np.array_equal(policy(seen), result.policies[agent](seen))
    config = json.loads((result.folder / "config.json").read_text())["config"]
    assert config["central_critic"] is False and config["env_name"] == "FakeCarryHuman-v0"
    assert {"loss/robot/kl", "loss/human/kl", "loss/human/value_loss"} <= result.curve[0].keys()
    assert "Policies" in summary(result)


@CRITICS
@pytest.mark.parametrize("agent", ["robot", "human"])
def test_an_action_does_not_depend_on_what_the_other_sees_by_one_bit(central, agent):
    config = dataclasses.replace(SMALL, central_critic=central)
    agents = Agents(config, FakePairEnv(), PAIR)
    learner = jax.jit(agents.init)(jax.random.PRNGKey(0))
    act = jax.jit(agents.act)
    own, other = ([0, 1], [2, 3, 4]) if agent == "robot" else ([2, 3, 4], [0, 1])
    obs, key = jax.random.normal(jax.random.PRNGKey(1), (64, 5)), jax.random.PRNGKey(2)
    pair = Pair(*agents.policies(learner, {}).values(), robot_columns=2)
    acting = jax.jit(pair.__call__, static_argnames="deterministic")
    column = 0 if agent == "robot" else 1

    def actions(obs):
        action, raw, log_prob = act(learner, obs, key)
        mode, sample = acting(obs, key), acting(obs, key, deterministic=False)
        return [x[:, column] for x in (action, raw, mode, sample)] + [log_prob[agent]]

    before = actions(obs)
    assert same_bytes(before, actions(obs.at[:, jnp.array(other)].multiply(-7.0)))
    after = actions(obs.at[:, jnp.array(own)].multiply(-7.0))
    assert not any(same_bytes(x, y) for x, y in zip(before, after, strict=True))


def test_acting_never_rounds_to_tf32_and_learning_only_in_gradients():
    agents, learner, batch, last = updated(SMALL)
    found = full(agents.learn, learner, batch, last, jax.random.PRNGKey(3), HYPER)
    assert any(found) and not all(found)
    agents, learner, batch, last = updated(dataclasses.replace(SMALL, gradient_precision="float32"))
    key, obs = jax.random.PRNGKey(3), batch.obs[0]
    policy = agents.policies(learner, {})["robot"]
    programs = [
        full(agents.act, learner, obs, key),
        full(agents.learn, learner, batch, last, key, HYPER),
        full(lambda obs: policy(obs), obs[:, :2]),
    ]
    assert all(found and all(found) for found in programs)


@pytest.mark.slow
@CRITICS
@pytest.mark.parametrize(
    ("agent", "other"),
    [("robot", "human"), pytest.param("human", "robot", marks=pytest.mark.slow)],
)
def test_given_the_batch_learning_does_not_depend_on_the_other_networks(central, agent, other):
    agents, learner, batch, last = updated(dataclasses.replace(SMALL, central_critic=central))
    learn = jax.jit(agents.learn)
    key = jax.random.PRNGKey(3)
    after, losses = learn(learner, batch, last, key, HYPER)
    disturbed, changed = learn(with_other_weights(learner, other), batch, last, key, HYPER)
    assert same_bytes(after.agents[agent], disturbed.agents[agent])
    assert not same_bytes(after.agents[other].params, disturbed.agents[other].params)
    assert not same_bytes(after.agents[agent].params, learner.agents[agent].params)
    own = [name for name in losses if name.startswith(agent)]
    assert same_bytes([losses[n] for n in own], [changed[n] for n in own])


@pytest.mark.slow
def test_a_central_critic_reads_both_and_a_policy_never_does():
    agents, learner, batch, last = updated(dataclasses.replace(SMALL, central_critic=True))
    for agent in agents.agents:
        state = learner.agents[agent.name]
        assert state.critic_normalizer.mean.shape == (5,)
        assert state.normalizer.mean.shape == (agent.part.sizes[0],)
        value = agent.networks.value_network.apply
        seen = agent.critic_view(batch.critic_obs)
        assert seen.shape[-1] == 5
        moved = value(state.critic_normalizer, state.params.value, seen + 1.0)
        assert not np.allclose(moved, value(state.critic_normalizer, state.params.value, seen))
    after, _ = jax.jit(agents.learn)(learner, batch, last, jax.random.PRNGKey(3), HYPER)
    statistics = after.agents["human"].critic_normalizer
    assert np.allclose(statistics.mean, batch.obs.mean((0, 1)), atol=1e-5)
    run = coop.train(FakePairEnv(), dataclasses.replace(SMALL, central_critic=True))
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(run.learner.agents))


@pytest.mark.slow
@pytest.mark.parametrize(
    "central",
    [
        pytest.param(False, id="own critic", marks=pytest.mark.slow),
        pytest.param(True, id="central critic"),
    ],
)
def test_value_functions_read_what_is_hidden_and_policies_never_do(central):
    env = FakePairEnv(privileged_obs_size=1)
    config = dataclasses.replace(SMALL, central_critic=central)
    agents, learner, batch, last = updated(config, env)
    assert batch.critic_obs.shape[-1] == last.shape[-1] == 6
    after, _ = jax.jit(agents.learn)(learner, batch, last, jax.random.PRNGKey(3), HYPER)
    for agent in agents.agents:
        state, own = after.agents[agent.name], agent.part.sizes[0]
        assert state.normalizer.mean.shape == (own,)
        assert state.critic_normalizer.mean.shape == (6 if central else own + 1,)
        clock = batch.critic_obs[..., -1]
        assert np.isclose(state.critic_normalizer.mean[-1], clock.mean(), atol=1e-5)
        view = agent.view(batch)
        assert view.obs.shape[-1] == own and np.array_equal(view.critic_obs[..., -1], clock)
        ended = batch.done > 0
        assert (view.final_critic_obs[..., -1][ended] == 1.0).all() and (clock < 1.0).all()
    blind = Agents(dataclasses.replace(config, privileged_critic=False), env, PAIR)
    assert [agent.critic_size for agent in blind.agents] == ([5, 5] if central else [None, None])
    run = coop.train(env, dataclasses.replace(config, privileged_critic=False))
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(run.learner.agents))


@pytest.mark.slow
def test_one_learner_reads_what_is_hidden_too():
    env = FakePairEnv(active=False, privileged_obs_size=1)
    config = PPOConfig(**{k: getattr(SMALL, k) for k in ("num_envs", "num_mini_batch")})
    config = dataclasses.replace(config, num_env_steps=80, save_dir=None)
    run = ppo.train(env, config)
    assert run.learner.agents["robot"].critic_normalizer.mean.shape == (
        3,
    ) and run.policy.mean.shape == (2,)
    plain = ppo.train(env, dataclasses.replace(config, privileged_critic=False))
    assert plain.learner.agents["robot"].critic_normalizer is None
    assert not same_bytes(plain.policy.weights, run.policy.weights)


@pytest.mark.slow
@CRITICS
def test_restored_learners_learn_on_exactly_as_those_that_were_never_saved(tmp_path, central):
    config, env = dataclasses.replace(SMALL, central_critic=central), FakePairEnv()
    restored = check_restored(env, config, Agents(config, env, PAIR), tmp_path)
    assert int(restored.env_steps) == 3 * 80


@pytest.mark.slow
def test_a_killed_run_of_two_goes_on_from_its_last_checkpoint(tmp_path):
    config = dataclasses.replace(
        CONFIG, save_dir=str(tmp_path), log_interval=1, save_interval=2, num_env_steps=60_000
    )
    kill_in_training(FakePairEnv(), "coop", config)
    progress, said = listening()
    result = coop.train(FakePairEnv(), config, progress)
    check_continued(result, said, config, updates=94)
    success = [row["success"] for row in result.curve if row["success"] is not None]
    assert np.mean(success[:5]) < 0.3  # few episodes end in one update, so that one row says little
    assert np.mean(success[-10:]) > 0.9


@pytest.mark.parametrize(("frozen", "learns"), [("robot", "human"), ("human", "robot")])
def test_a_frozen_agent_stays_as_it_is_and_the_other_learns(trained, tmp_path, frozen, learns):
    env, result = trained
    file = result.folder / {"robot": "policy.npz", "human": "human_policy.npz"}[frozen]
    config = dataclasses.replace(
        CONFIG,
        num_env_steps=30_000,
        save_dir=str(tmp_path),
        **{f"{frozen}_policy": str(file), f"freeze_{frozen}": True},
    )
    second = coop.train(FakePairEnv(), config)
    kept = load_policy(tmp_path / env.name / file.name)
    given = result.policies[frozen]
    assert same_bytes(kept, given) and kept.info == load_policy(file).info
    assert same_bytes(second.learner.agents[frozen].params.policy, given.weights)
    assert second.last("success") > 0.9
    assert {name.split("/")[1] for name in second.curve[0] if name.startswith("loss/")} == {learns}
    assert int(second.learner.env_steps) == second.env_steps

    other = dataclasses.replace(config, num_env_steps=40_000, **{f"freeze_{frozen}": False})
    with pytest.raises(CheckpointMismatchError, match=f"{frozen}.frozen_policy is '.*', this run"):
        coop.train(FakePairEnv(), other)


def test_a_frozen_agent_acts_by_its_mode(trained):
    _, result = trained
    file = result.folder / "human_policy.npz"
    config = dataclasses.replace(SMALL, human_policy=str(file), freeze_human=True)
    agents = Agents(config, FakePairEnv(), PAIR)
    learner = jax.jit(agents.init)(jax.random.PRNGKey(0))
    obs = jax.random.normal(jax.random.PRNGKey(1), (64, 5))
    action, _, _ = agents.act(learner, obs, jax.random.PRNGKey(2))
    human = result.policies["human"](obs[:, 2:])
    assert np.allclose(action[:, 1:], human, atol=1e-5)


@pytest.mark.slow
def test_a_robot_can_start_from_what_it_learned_with_a_person_who_holds_still(tmp_path):
    settings = dataclasses.asdict(SMALL)
    same = {f.name: settings[f.name] for f in dataclasses.fields(PPOConfig) if f.name in settings}
    still = ppo.train(
        FakePairEnv(active=False), PPOConfig(**{**same, "save_dir": str(tmp_path), "lr": 0.01})
    )
    start = str(still.folder / "policy.npz")
    config = dataclasses.replace(SMALL, robot_policy=start, value_warm_up=0.0)  # only one update
    agents = Agents(config, FakePairEnv(), PAIR)
    learner = jax.jit(agents.init)(jax.random.PRNGKey(0))
    robot = learner.agents["robot"]
    assert same_bytes(robot.params.policy, still.policy.weights)
    assert same_bytes(
        (robot.normalizer.mean, robot.normalizer.std), (still.policy.mean, still.policy.std)
    )
    result = coop.train(FakePairEnv(), config)
    learned = result.policies["robot"]
    assert not same_bytes(learned.weights, still.policy.weights)
    # what it observes is normalised as before; by other statistics, the same weights act otherwise
    assert same_bytes((learned.mean, learned.std), (still.policy.mean, still.policy.std))
    assert not same_bytes(result.policies["human"].std, np.ones_like(result.policies["human"].std))


def test_someone_has_to_learn_and_a_frozen_agent_needs_a_policy():
    with pytest.raises(ConfigError, match=r"--freeze-human keeps .* needs --human-policy FILE"):
        CoopConfig(freeze_human=True)
    with pytest.raises(ConfigError, match=r"leaves nothing to train.*agym-jax evaluate"):
        CoopConfig(robot_policy="r", human_policy="p", freeze_robot=True, freeze_human=True)


def test_a_person_who_holds_still_is_refused():
    env = FakePairEnv(active=False)
    text = r"holds still.*agym-jax train --env-name FakeCarry-v0.*'FakeCarryHuman-v0'"
    with pytest.raises(ActiveHumanError, match=text):
        coop.train(env, SMALL)
    assert env.traces["step"] == 0


def test_one_trainer_does_not_continue_a_run_of_the_other(trained, tmp_path):
    _, result = trained
    joint = PPOConfig(
        num_env_steps=80,
        num_envs=4,
        save_dir=str(result.folder.parent),
        allow_joint_observation=True,
    )
    with pytest.raises(
        CheckpointMismatchError, match=r"train\.coop, but this is train\.ppo.*--fresh"
    ):
        ppo.train(FakePairEnv(), joint)
    assert len(checkpoint_files(result.folder / "checkpoints")) == 3
    ppo.train(FakePairEnv(), dataclasses.replace(joint, save_dir=str(tmp_path)))
    with pytest.raises(
        CheckpointMismatchError, match=r"train\.ppo, but this is train\.coop.*--fresh"
    ):
        coop.train(FakePairEnv(), dataclasses.replace(SMALL, save_dir=str(tmp_path)))


def test_ppo_sends_people_who_act_to_this_trainer():
    with pytest.raises(ActiveHumanError, match=r"agym-jax coop --env-name FakeCarryHuman"):
        ppo.train(FakePairEnv(), PPOConfig(save_dir=None))


def test_a_real_pair_is_cut_where_the_robot_of_the_still_person_ends(static_env, active_env):
    agents, alone = parts(active_env), parts(static_env)
    assert agents["robot"] == alone["robot"] and list(alone) == ["robot"]
    assert (agents["robot"].sizes, agents["human"].sizes) == ((30, 7), (34, 10))
    assert agents["human"].observed == slice(30, 64) and agents["human"].acted == slice(7, 17)
    assert agents["joint"].sizes == (64, 17)
    assert len({part.layout for part in agents.values()}) == 3


@pytest.mark.slow
def test_the_command_line_trains_two(tmp_path, capsys, restored_settings):
    words = f"--env-name FakeCarryHuman-v0 --num-env-steps 640 --num-envs 4 --save-dir {tmp_path}"
    words += " --num-mini-batch 4 --policy-hidden 32 --value-hidden 32 --central-critic"
    assert coop.main(words.split(), lambda *_: FakePairEnv()) == 0
    out = capsys.readouterr().out
    assert "FakeCarryHuman-v0: trained 640 steps" in out and str(tmp_path) in out
    with pytest.raises(SystemExit):
        coop.main([*words.split(), "--freeze-robot"], lambda *_: FakePairEnv())
    assert "--freeze-robot keeps a policy as it is" in capsys.readouterr().err


def test_training_starts_from_the_policy_that_ships(static_env, active_env):
    ships = load_policy(static_env.name)
    for env, config, names in (
        (static_env, PPOConfig(robot_policy="shipped"), ("robot",)),
        (active_env, CoopConfig(robot_policy="shipped"), PAIR),
    ):
        agents = Agents(config, env, names)
        learner = jax.eval_shape(agents.init, jax.random.PRNGKey(0))
        start = agents.agents[0].start
        assert same_bytes(start.weights, ships.weights)
        shapes = jax.tree.map(lambda x: x.shape, learner.agents["robot"].params.policy)
        assert shapes == jax.tree.map(lambda x: x.shape, ships.weights)
    pair = load_policy(active_env.name)
    both = Agents(
        CoopConfig(robot_policy="shipped", human_policy="shipped"), active_env, PAIR
    ).agents
    for agent, of_pair in zip(both, (pair.robot, pair.human), strict=True):
        assert same_bytes(agent.start.weights, of_pair.weights)
    assert not same_bytes(pair.robot.weights, ships.weights)
    _, by_id = Agents(CoopConfig(human_policy=active_env.name), active_env, PAIR).agents
    assert same_bytes(by_id.start.weights, pair.human.weights)
    with pytest.raises(
        PolicyNotFoundError, match=f"for '{static_env.name}'. Use --human-policy {active_env.name}"
    ):
        Agents(CoopConfig(human_policy=static_env.name), active_env, PAIR)
    named = PPOConfig(robot_policy=static_env.name)
    (by_id,) = Agents(named, static_env, ("robot",)).agents
    assert same_bytes(by_id.start.weights, ships.weights)
    other = agym_jax.make(static_env.name, impl="jax", config={"scratch": 3.0})
    (further,) = Agents(named, other, ("robot",)).agents  # training may go on with other settings
    assert same_bytes(further.start.weights, ships.weights)
    frozen = CoopConfig(robot_policy="shipped", freeze_robot=True)
    other = agym_jax.make(active_env.name, impl="jax", config={"scratch": 3.0})
    with pytest.raises(PolicyEnvironmentError, match=r"task.scratch"):
        Agents(frozen, other, PAIR)
    with pytest.raises(PolicyNotFoundError, match=r"ships no policy for 'FakeCarry-v0'"):
        Agents(CoopConfig(robot_policy="shipped"), FakePairEnv(), PAIR)
