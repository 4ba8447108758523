# ruff: noqa: D103 (a test's name says what it shows)
"""Robots and people of different runs together: in evaluation, replay and the matrix of all pairs."""

from __future__ import annotations

import dataclasses
import json
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from fake_pair_env import FakePairEnv, RobotSees

from agym_jax import observe
from agym_jax.errors import PolicyEnvironmentError, PolicyLayoutError, PolicyNotFoundError
from agym_jax.observe import column
from agym_jax.policy import Pair, baseline_policy, load_policy, save_policy
from agym_jax.policy.files import find_policies, load_agent, load_policies
from train import crossplay, enjoy, evaluate
from train.configs import CoopConfig, PPOConfig
from train.crossplay import STILL
from train.errors import ActiveHumanError, ConfigError
from train.evaluate import Evaluator
from train.evaluation.gentleness import Gentleness
from train.evaluation.score import EvaluationResult
from train.learning.agents import Agents
from train.runs.folder import RunFolder

NAME, STILL_NAME = "FakeCarryHuman-v0", "FakeCarry-v0"
PAIR = ("robot", "human")
SMALL = {"policy_hidden": (8,), "value_hidden": (8,), "policy_head_gain": 1.0}


@observe.observation
class LaterHumanSees:
    """What the person sees in a later version."""

    cart: jax.Array = column(1, "m", "world", "")
    left: jax.Array = column(1, "m", "world", "")
    speed: jax.Array = column(1, "m/s", "world", "")


def make(name: str, impl: str = "auto", **changes) -> FakePairEnv:
    """The fake environment of an id, as ``train.envs.make_env``."""
    return FakePairEnv(active=name.endswith("Human-v0"), **changes)


def policies(agents, env, seed):
    learner = jax.jit(agents.init)(jax.random.PRNGKey(seed))
    return agents.policies(learner, {"env": env.name, "versions": {"agym_jax": "0.1.0"}})


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    """Folders as training leaves them, of untrained policies: coop twice, ppo still and joint."""
    root = tmp_path_factory.mktemp("runs")
    active, still = make(NAME), make(STILL_NAME)
    made = {
        "a": (Agents(CoopConfig(**SMALL), active, PAIR), active, 0),
        "b": (Agents(CoopConfig(**SMALL), active, PAIR), active, 1),
        "joint": (Agents(PPOConfig(**SMALL), active, ("joint",)), active, 2),
        "still": (Agents(PPOConfig(**SMALL), still, ("robot",)), still, 3),
    }
    for name, (agents, env, seed) in made.items():
        RunFolder(str(root / name), env.name).save_policies(policies(agents, env, seed))
    other = make(NAME, task_name="FakePull")
    found = policies(Agents(CoopConfig(**SMALL), other, PAIR), other, 4)
    RunFolder(str(root / "other"), other.name).save_policies(found)
    return SimpleNamespace(
        root=root,
        robot=root / "a" / NAME / "policy.npz",
        human=root / "a" / NAME / "human_policy.npz",
        joint=root / "joint" / NAME / "policy.npz",
        still=root / "still" / STILL_NAME / "policy.npz",
        other=root / "other" / other.name,
    )


def returns_of(policy, env=None, seed=1001, episodes=6):
    return Evaluator(env or make(NAME), episodes)(policy, jax.random.PRNGKey(seed)).returns


def test_each_of_a_pair_is_asked_with_its_own_columns(runs):
    env = make(NAME)
    robot = load_agent(runs.robot, env, "robot")
    human = load_agent(runs.human, env, "human")
    obs = jax.random.normal(jax.random.PRNGKey(0), (7, 5))
    both = Pair(robot, human, robot_columns=2)(obs)
    assert np.array_equal(both, jnp.concatenate([robot(obs[:, :2]), human(obs[:, 2:])], -1))
    with pytest.raises(ValueError, match="needs a key"):
        Pair(robot, baseline_policy("random", 1), 2)(obs)


@pytest.mark.slow
def test_the_matrix_has_every_pair_and_the_person_who_holds_still(runs, tmp_path, capsys):
    out, envs = tmp_path / "new" / "lines.jsonl", []

    def kept(name, impl):
        envs.append(make(name))
        return envs[-1]

    words = ["--env-name", NAME, "--num-episodes", "6", "--json", str(out)]
    words += ["--runs", str(runs.root / "a"), str(runs.root / "b")]
    words += ["--robots", str(runs.still), "zero", "--humans", "zero"]
    assert crossplay.main(words, kept) == 0
    text = capsys.readouterr().out
    assert all(name in text for name in (str(runs.robot), str(runs.still), "R4", "P4", STILL))
    lines = [json.loads(line) for line in out.read_text().splitlines()]
    cells = {(line["robot_policy"], line["human_policy"]): line for line in lines}
    assert len(lines) == len(cells) == 4 * 4
    assert {line["env"] for line in lines if line["human_policy"] is None} == {STILL_NAME}
    assert {line["kind"] for line in lines} == {"crossplay"}

    second = load_policy(runs.root / "b" / NAME / "human_policy.npz")
    crossed = returns_of(Pair(load_policy(runs.robot), second, 2))
    cell = cells[str(runs.robot), str(runs.root / "b" / NAME / "human_policy.npz")]
    assert cell["return_mean"] == pytest.approx(crossed.mean(), rel=1e-5)
    alone = returns_of(load_policy(runs.still), make(STILL_NAME))
    assert cells[str(runs.still), None]["return_mean"] == pytest.approx(alone.mean(), rel=1e-5)
    # one compilation for all pairs of networks, and one for each kind with a baseline in it
    assert [env.traces["step"] for env in envs] == [4, 2]


def test_the_columns_can_be_left_out(runs, capsys):
    words = f"--env-name {NAME} --num-episodes 2 --robots {runs.robot} --humans {runs.human}"
    assert crossplay.main([*words.split(), "--no-still-human"], make) == 0
    assert STILL not in capsys.readouterr().out
    assert crossplay.main(f"--env-name {NAME} --num-episodes 2 --robots zero".split(), make) == 0
    assert "P2" not in capsys.readouterr().out


@pytest.mark.parametrize(
    ("words", "error", "text"),
    [
        ("", ConfigError, "--runs DIR"),
        ("--humans zero", ConfigError, "--robots FILE"),
        ("--robots zero --no-still-human", ConfigError, "--humans FILE"),
        ("--robots nowhere.npz", PolicyNotFoundError, "nowhere.npz"),
        ("--runs nowhere", PolicyNotFoundError, "nowhere"),
        ("--robots {human}", PolicyEnvironmentError, "moves the person"),
        ("--robots zero --humans {robot}", PolicyEnvironmentError, "moves the robot"),
        ("--robots {joint}", PolicyEnvironmentError, "robot and person together"),
        ("--robots {other}/policy.npz", PolicyEnvironmentError, "'FakePullHuman-v0'"),
        ("--robots zero --humans {other}/human_policy.npz", PolicyEnvironmentError, "FakePull"),
    ],
)
def test_what_cannot_be_crossed_is_refused_by_name(runs, capsys, words, error, text):
    arguments = f"--env-name {NAME} {words}".format(**vars(runs)).split()
    assert crossplay.main(arguments, make) == 2
    said = capsys.readouterr().err
    assert said.startswith(error.__name__) and text in said


def test_a_matrix_needs_people_who_act(capsys):
    assert crossplay.main(f"--env-name {STILL_NAME} --robots zero".split(), make) == 2
    said = capsys.readouterr().err
    assert said.startswith(ActiveHumanError.__name__) and f"Both act in '{NAME}'" in said


def test_the_table_tells_gentle_success_where_it_is_measured():
    length = np.full(4, 20.0)
    done, over = np.array([True, True, True, False]), np.array([0.0, 3.0, 0.0, 0.0])
    gentleness = Gentleness(np.full(4, 30.0), over, np.zeros(4), length)
    plain = EvaluationResult(NAME, np.full(4, 2.0), np.ones(4), done, np.zeros(4, bool), 0, 1.0)
    told = crossplay.table({("a", "b"): dataclasses.replace(plain, gentleness=gentleness)})
    assert "success, gentle success, and return" in told and " 75.0%  50.0%       2.0" in told
    assert "success, and return" in crossplay.table({("a", "b"): plain})


def loaded(name, load_dir=None, policy=None, human=None, env=None):
    """What the command lines of evaluate and enjoy load."""
    files = find_policies(name, *(x and str(x) for x in (load_dir, policy, human)))
    return load_policies(files, env or make(name))


def test_a_run_of_coop_is_loaded_with_both_policies(runs):
    pair = loaded(NAME, runs.root / "a")
    assert isinstance(pair, Pair)
    assert [p.info["agent"] for p in (pair.robot, pair.human)] == ["robot", "human"]
    assert loaded(NAME, runs.root / "joint").info["agent"] == "joint"


def test_any_robot_goes_with_any_person_of_its_task(runs):
    obs = jnp.ones((3, 5))
    for robot in (runs.robot, runs.still, "zero"):
        for human in (runs.human, "random"):
            pair = loaded(NAME, None, robot, human)
            assert pair(obs, jax.random.PRNGKey(0)).shape == (3, 2)
    assert loaded(NAME, runs.root / "a", None, "zero").human.name == "zero"
    assert loaded(STILL_NAME, None, runs.robot)(obs[:, :2]).shape == (3, 1)
    assert loaded(NAME, None, "zero")(obs).shape == (3, 2)


@pytest.mark.parametrize(
    ("name", "policy", "human", "error", "text"),
    [
        (STILL_NAME, "zero", "zero", PolicyEnvironmentError, f"Leave it out, .*{NAME}"),
        (STILL_NAME, "{human}", None, PolicyEnvironmentError, "moves the person.*--human-policy"),
        (NAME, "{robot}", None, PolicyEnvironmentError, "Use it with --policy, and a --human-pol"),
        (NAME, "{still}", None, PolicyEnvironmentError, "Use it with --policy, and a --human-pol"),
        (NAME, "{joint}", "zero", PolicyEnvironmentError, "Use it with --policy alone"),
        (NAME, "{human}", "{human}", PolicyEnvironmentError, "not the robot of"),
        (NAME, "zero", "{robot}", PolicyEnvironmentError, "not the person of"),
        (NAME, "zero", "{other}/human_policy.npz", PolicyEnvironmentError, "trained in 'FakePull"),
        (NAME, "{other}/policy.npz", "zero", PolicyEnvironmentError, f"'{STILL_NAME}' or '{NAME}'"),
        (NAME, "zero", "nowhere.npz", PolicyNotFoundError, "nowhere.npz"),
    ],
)
def test_policies_that_do_not_fit_are_refused_with_what_would(
    runs, name, policy, human, error, text
):
    policy, human = (x and x.format(**vars(runs)) for x in (policy, human))
    with pytest.raises(error, match=text):
        loaded(name, None, policy, human)


def test_a_person_of_another_layout_or_version_is_refused(runs):
    later = SimpleNamespace(robot_obs=RobotSees, human_obs=LaterHumanSees)
    env = make(NAME, task=later)
    pair = (runs.robot, runs.human)
    with pytest.raises(PolicyLayoutError, match=r"human_policy.npz reads .*agym_jax.*0\.1\.0"):
        loaded(NAME, None, *pair, env=env)
    env = make(NAME)
    env.name = "FakeCarryHuman-v1"
    with pytest.raises(PolicyEnvironmentError, match=r"'FakeCarry-v1' or 'FakeCarryHuman-v1'"):
        loaded("FakeCarryHuman-v1", None, *pair, env=env)


def test_a_policy_of_before_there_were_two_learners_is_a_robots(runs, tmp_path):
    policy = load_policy(runs.still)
    info = {k: v for k, v in policy.info.items() if k not in ("agent", "algorithm")}
    old = save_policy(tmp_path / "old.npz", dataclasses.replace(policy, info=info))
    assert loaded(STILL_NAME, None, old)(jnp.ones(2)).shape == (1,)
    assert loaded(NAME, None, old, "zero")(jnp.ones(5)).shape == (2,)


def test_the_command_lines_evaluate_and_show_a_pair(runs, tmp_path, capsys):
    out = tmp_path / "lines.jsonl"
    words = f"--env-name {NAME} --policy {runs.still} --human-policy {runs.human}".split()
    assert evaluate.main([*words, "--num-episodes", "4", "--json", str(out)], make) == 0
    assert f"{NAME}, 4 episodes" in capsys.readouterr().out
    line = json.loads(out.read_text())
    assert (line["policy"], line["human_policy"]) == (str(runs.still), str(runs.human))

    sheet = tmp_path / "a.png"
    drawing = f"--sheet {sheet} --width 32 --height 24 --backend raycast".split()
    assert enjoy.main([*words, *drawing], make) == 0
    assert "episode 1, seed 1001: 20 steps" in capsys.readouterr().out
    assert sheet.read_bytes()[:4] == b"\x89PNG"
    assert evaluate.main(f"--env-name {STILL_NAME} {' '.join(words[2:])}".split(), make) == 2
    assert "holds still and needs no --human-policy" in capsys.readouterr().err
