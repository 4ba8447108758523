# ruff: noqa: D103 (a test's name says what it shows)
"""Training from end to end on the fake environment."""

from __future__ import annotations

import dataclasses
import json

import jax
import numpy as np
import pytest
from fake_env import FakeEnv
from fake_pair_env import FakePairEnv
from train_runs import check_continued, check_restored, kill_in_training, listening

from agym_jax.errors import BufferOverflowError, SaveFolderError
from agym_jax.policy import load_policy
from agym_jax.policy.policy import read_policy
from train.configs import PPOConfig
from train.errors import ActiveHumanError, CheckpointMismatchError, DivergedError
from train.evaluate import Evaluator
from train.learning.agents import Agents
from train.ppo import main, train
from train.runs.checkpoint import checkpoint_files, load_newest
from train.runs.curve import make_row, refuse_diverged
from train.runs.result import summary

CONFIG = PPOConfig(
    env_name="FakeReach-v0",
    num_env_steps=45_000,
    num_envs=32,
    num_mini_batch=4,
    distribution="tanh_normal",
    policy_hidden=(32,),
    value_hidden=(64, 64),
    lr=1e-3,
    log_interval=8,
)
SMALL = dataclasses.replace(CONFIG, num_envs=4, num_env_steps=80, save_dir=None)


@pytest.fixture(scope="module")
def trained(tmp_path_factory):
    """A finished run: environment, result, folder and what was said."""
    env, (progress, said) = FakeEnv(), listening()
    folder = tmp_path_factory.mktemp("trained")
    result = train(env, dataclasses.replace(CONFIG, save_dir=str(folder)), progress)
    return env, result, folder / env.name, said


def test_training_improves_the_return(trained):
    _, result, _, _ = trained
    assert result.curve[0]["return"] < -12
    assert result.last("return") > -5
    assert result.last("success") > 0.15
    assert result.last("force") == pytest.approx(-2 * result.last("return") / 20, rel=1e-4)


def test_environment_is_traced_once_for_all_log_intervals(trained):
    env, result, _, _ = trained
    assert len(result.curve) > 5
    assert env.traces == {"reset": 1, "step": 1}


def test_steps_and_episodes_add_up(trained):
    _, result, _, _ = trained
    batch = 32 * 20
    assert result.env_steps == 71 * batch == int(result.learner.env_steps)
    assert [row["env_steps"] for row in result.curve[:2]] == [8 * batch, 16 * batch]
    # 20 steps an episode, staggered: each environment's first episode is partial and not counted
    episodes = sum(row["episodes"] for row in result.curve)
    assert result.env_steps / 20 - 2 * 32 <= episodes <= result.env_steps / 20
    assert all(row["length"] == 20 for row in result.curve)
    assert result.compile_seconds > 0 and result.train_seconds > 0


def test_the_folder_has_everything(trained):
    _, result, folder, said = trained
    names = {p.name for p in folder.iterdir()}
    assert names == {"config.json", "curve.jsonl", "curve.png", "checkpoints", "policy.npz"}
    assert len(checkpoint_files(folder / "checkpoints")) == 3
    config = json.loads((folder / "config.json").read_text())
    assert config["config"]["num_envs"] == 32 and config["versions"]["jax"] == jax.__version__
    rows = [json.loads(line) for line in (folder / "curve.jsonl").read_text().splitlines()]
    assert rows == result.curve
    assert (folder / "curve.png").read_bytes()[:4] == b"\x89PNG"
    assert "steps/s" in said[0] and "success" in said[0]
    assert "left" not in said[0] and "left 0:00" in said[-1]
    assert "Compiled in" in summary(result) and str(folder) in summary(result)


def test_the_saved_policy_acts_as_the_learner_does(trained):
    env, result, folder, _ = trained
    policy = load_policy(folder / "policy.npz", env)
    obs = jax.random.normal(jax.random.PRNGKey(0), (5, 4))
    assert np.array_equal(policy(obs), result.policy(obs))
    found = Evaluator(env, 64)(policy, jax.random.PRNGKey(5))
    assert found.returns.mean() > result.last("return") - 0.5
    assert policy.info["env_steps"] == result.env_steps


def test_a_finished_run_is_not_run_again(trained):
    _, result, folder, _ = trained
    env, (progress, said) = FakeEnv(), listening()
    again = train(env, dataclasses.replace(CONFIG, save_dir=str(folder.parent)), progress)
    assert env.traces == {"reset": 0, "step": 0}
    assert again.session_steps == 0 and again.curve == result.curve
    assert any("raise --num-env-steps" in text for text in said)


def test_what_is_known_of_a_finished_run_stays(trained):
    _, _, folder, _ = trained
    names = ("config.json", "policy.npz", "curve.jsonl")
    before = [(folder / name).read_bytes() for name in names]
    config = dataclasses.replace(CONFIG, save_dir=str(folder.parent))
    train(FakeEnv(), dataclasses.replace(config, lr=1.0))  # other settings trained nothing
    assert [(folder / name).read_bytes() for name in names] == before
    with pytest.raises(CheckpointMismatchError, match=r"is of seed \d+, this run has seed 77"):
        train(FakeEnv(), dataclasses.replace(config, seed=77))
    with pytest.raises(
        CheckpointMismatchError, match=r"began without --robot-policy. Leave --robot-policy \S+ out"
    ):
        train(FakeEnv(), dataclasses.replace(config, robot_policy=str(folder / "policy.npz")))
    (folder / "policy.npz").unlink()  # lost: the checkpoint has it
    train(FakeEnv(), config)
    assert (folder / "policy.npz").is_file()
    (folder / "policy.npz").write_bytes(before[1])


def test_another_network_in_the_same_folder_is_refused_before_compiling(trained):
    _, _, folder, _ = trained
    env = FakeEnv()
    config = dataclasses.replace(CONFIG, save_dir=str(folder.parent), policy_hidden=(16,))
    with pytest.raises(
        CheckpointMismatchError, match=r"policy_hidden is \[32\], this run has \[16\]"
    ):
        train(env, config)
    assert env.traces["step"] == 0


def test_a_run_that_began_with_a_policy_is_resumed_with_it(trained, tmp_path):
    start = str(trained[2] / "policy.npz")
    began = dataclasses.replace(SMALL, save_dir=str(tmp_path), robot_policy=start)
    before, after = read_policy(start), train(FakeEnv(), began).policy
    assert np.array_equal(before.mean, after.mean) and np.array_equal(before.std, after.std)
    with pytest.raises(
        CheckpointMismatchError,
        match=r"began with --robot-policy \S+. Add --robot-policy \S+policy.npz,",
    ):
        train(FakeEnv(), dataclasses.replace(began, robot_policy=None, num_env_steps=160))


def test_fresh_moves_the_old_run_aside(tmp_path):
    other = tmp_path / "runs"
    (other / "FakeReach-v0").mkdir(parents=True)
    (other / "FakeReach-v0" / "curve.jsonl").write_text("old")
    train(FakeEnv(), dataclasses.replace(SMALL, save_dir=str(other), fresh=True))
    moved = [p for p in other.iterdir() if ".before-" in p.name]
    assert len(moved) == 1 and (moved[0] / "curve.jsonl").read_text() == "old"


def test_a_restored_learner_learns_on_exactly_as_one_that_was_never_saved(tmp_path):
    env = FakeEnv()
    restored = check_restored(env, SMALL, Agents(SMALL, env, ("robot",)), tmp_path)
    moments = jax.tree.leaves(restored.agents["robot"].optimizer)
    assert len(moments) > 8 and any(np.abs(np.asarray(m)).max() > 0 for m in moments)


@pytest.mark.slow
def test_a_killed_run_goes_on_from_its_last_checkpoint(tmp_path):
    config = dataclasses.replace(
        CONFIG, save_dir=str(tmp_path), log_interval=1, save_interval=2, num_env_steps=50_000
    )
    kill_in_training(FakeEnv(), "ppo", config)
    progress, said = listening()
    check_continued(train(FakeEnv(), config, progress), said, config, updates=79)


def test_on_log_can_stop_a_run_which_then_goes_on(tmp_path):
    config = dataclasses.replace(
        SMALL, save_dir=str(tmp_path), log_interval=1, num_env_steps=80 * 6
    )
    seen = []

    def stop_at_third(row, policy):
        seen.append(policy().info["env_steps"])
        return len(seen) == 3

    result = train(FakeEnv(), config, on_log=stop_at_third)
    assert result.interrupted and seen == [80, 160, 240] and result.env_steps == 240
    assert "stopped at 240" in summary(result) and "(at step" not in summary(result)

    def interrupt(row, policy):
        raise KeyboardInterrupt

    again = train(FakeEnv(), config, on_log=interrupt)
    assert again.interrupted and again.env_steps == 320
    assert again.curve[-1]["return"] is None and " N (at step 240). Compiled" in summary(again)
    kept = load_newest(
        tmp_path / "FakeReach-v0" / "checkpoints", jax.eval_shape(lambda: again.learner), {}
    )
    assert int(kept.learner.env_steps) == 320


def test_lost_contacts_stop_the_run():
    with pytest.raises(BufferOverflowError, match=r"FakeReach-v0.*4 environments.*buffers"):
        train(FakeEnv(overflow=1.0), SMALL)


def test_environments_that_go_nan_are_counted_and_training_goes_on():
    config = dataclasses.replace(SMALL, num_env_steps=800, stagger=False)
    result = train(FakeEnv(nan_at=5), config)
    assert result.nan_steps == 800 / 5
    assert "160 environment steps went NaN" in summary(result)
    assert all(
        np.isfinite(leaf).all() for leaf in jax.tree.leaves(result.learner.agents["robot"].params)
    )


def test_a_loss_that_is_not_finite_stops_the_run():
    totals = {f"episode/{n}": 0.0 for n in ("episodes", "return", "success", "force", "length")}
    totals |= {
        "step/reward": -3.0,
        "step/nan": 0.0,
        "step/overflow": 0.0,
        "step/force/on_human": 8.0,
    }
    totals["episode/return_squared"] = 0.0
    row = make_row({**totals, "loss/kl": 2.0}, updates=2, samples=4, episode_length=20)
    assert row["return"] is None and row["return_per_step"] == -15.0 and row["loss/kl"] == 1.0
    assert row["force/on_human"] == 2.0
    row = make_row({**totals, "loss/kl": np.nan}, 2, 4, 20) | {"env_steps": 80, "nan_total": 0}
    with pytest.raises(DivergedError, match=r"before step 80: loss/kl not finite.*--lr"):
        refuse_diverged(row, "FakeReach-v0")


def test_an_active_human_is_refused_with_the_reason():
    env = FakePairEnv(task_name="ScratchItchJaco")
    text = (
        r"robot \(1 actions\) and human \(1 actions\).*read the person's observation.*agym-jax coop"
        r".*ScratchItchJaco-v0.*--allow-joint-observation"
    )
    with pytest.raises(ActiveHumanError, match=text):
        train(env, SMALL)
    assert env.traces["step"] == 0
    train(env, dataclasses.replace(SMALL, allow_joint_observation=True))


def test_an_unwritable_folder_is_refused_before_anything_compiles(tmp_path, capsys):
    (tmp_path / "file").write_text("")
    below = str(tmp_path / "file" / "runs")
    env = FakeEnv()
    with pytest.raises(SaveFolderError, match="Cannot write to the folder"):
        train(env, dataclasses.replace(CONFIG, save_dir=below))
    made = []
    status = main(["--env-name", "FakeReach-v0", "--save-dir", below], lambda *_: made.append(1))
    assert status == 2 and not made and env.traces["reset"] == 0
    assert "SaveFolderError: Cannot write to the folder" in capsys.readouterr().err


def test_the_command_line_trains(tmp_path, capsys, restored_settings):
    words = f"--env-name FakeReach-v0 --num-env-steps 6.4e2 --num-envs 4 --save-dir {tmp_path}"
    words += " --num-mini-batch 4 --policy-hidden 32 --value-hidden 32 --lr 1e-3"
    assert main(words.split(), lambda name, impl: FakeEnv(name=name)) == 0
    out = capsys.readouterr().out
    assert "FakeReach-v0: trained 640 steps" in out and str(tmp_path) in out
