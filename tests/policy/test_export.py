# ruff: noqa: D103
"""Policies as ONNX: the same actions, and a description that is true of the environment."""

from __future__ import annotations

import json
import subprocess
import sys
from itertools import pairwise
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from fake_env import FakeEnv
from paths import PROCESS_SECONDS, ROOT
from unshipped import hide_policies

import agym_jax
from agym_jax.data.assets import asset_path, asset_root
from agym_jax.errors import (
    ArgumentError,
    MissingExtraError,
    PolicyEnvironmentError,
    PolicyNotFoundError,
)
from agym_jax.policy import Policy, load_policy, save_policy
from agym_jax.policy.contract import contract
from agym_jax.policy.export import choose_policy, export_policy, main
from agym_jax.policy.networks import ACTIVATIONS, Architecture, init_policy, make_networks
from agym_jax.policy.onnx_graph import ACTIVATIONS as IN_ONNX
from agym_jax.policy.onnx_graph import PRECISIONS, build_model
from agym_jax.policy.policy import read_policy
from agym_jax.registry import active_id

runtime = pytest.importorskip("onnxruntime", reason='needs pip install "agym_jax[onnx]"')
FILES = sorted((asset_root() / "policies").rglob("*.npz"))
ROBOT, PAIR = "ReachingSawyer-v0", "ScratchItchPR2Human-v0"
HIDDEN = "DressingJaco-v0"


def session(model: Any) -> Any:
    """A model, or the path of one, in ONNX Runtime."""
    source = model if isinstance(model, str) else model.SerializeToString()
    return runtime.InferenceSession(source, providers=["CPUExecutionProvider"])


def run(session: Any, obs: np.ndarray) -> np.ndarray:
    return session.run(["action"], {"observation": obs})[0]


def observations(policy: Policy, count: int = 300) -> np.ndarray:
    """Near and far from those that it was trained with: what is beyond 10 deviations is clipped."""
    rng, mean, std = np.random.default_rng(0), np.asarray(policy.mean), np.asarray(policy.std)
    spread = rng.choice([1.0, 3.0, 20.0], (count, 1))
    return (mean + spread * std * rng.standard_normal((count, len(mean)))).astype(np.float32)


def exact(policy: Policy, obs: np.ndarray) -> np.ndarray:
    """The policy's actions in float64."""
    with jax.enable_x64(True):
        wide = jax.tree.map(lambda x: np.asarray(x, np.float64), policy)
        return np.asarray(wide(obs.astype(np.float64)))


def untrained(distribution: str, activation: str) -> Policy:
    arch = Architecture(4, 2, (8, 6), (8,), activation, distribution, policy_head_gain=2.0)
    weights = init_policy(make_networks(arch), arch, jax.random.PRNGKey(0))
    info = {"env": "FakeReach-v0", "layout": "fake-1", "agent": "robot"}
    return Policy(weights, jnp.arange(4.0), jnp.arange(1.0, 5.0), arch, info)


def same(policy: Policy, precision: str) -> None:
    obs = observations(policy)
    given = run(session(build_model(policy, {}, precision)), obs)
    assert given.dtype == np.float32 and np.ptp(given) > 0.1
    tight = precision == "float64"
    np.testing.assert_allclose(given, exact(policy, obs), rtol=0, atol=1e-6 if tight else 3e-5)
    # JAX's own rounding: the means of ArmManipulationJaco are far larger than any action before they are clipped
    np.testing.assert_allclose(given, policy(obs), rtol=0, atol=1e-4 if tight else 3e-5)


@pytest.mark.parametrize("file", FILES, ids=lambda file: f"{file.parent.name}-{file.stem}")
def test_every_shipped_policy_acts_the_same_in_onnx_runtime(file):
    same(read_policy(file), "float64")


@pytest.mark.parametrize("precision", PRECISIONS)
@pytest.mark.parametrize("distribution", ["normal", "tanh_normal"])
@pytest.mark.parametrize("activation", sorted(ACTIVATIONS))
def test_every_architecture_acts_the_same_in_onnx_runtime(activation, distribution, precision):
    assert set(IN_ONNX) == set(ACTIVATIONS)
    same(untrained(distribution, activation), precision)


@pytest.fixture(scope="module")
def envs() -> dict[str, Any]:
    return {name: agym_jax.make(name, impl="native") for name in (ROBOT, PAIR)}


def described(path: Path) -> dict[str, Any]:
    """What a file says of its inputs and outputs."""
    told = session(str(path)).get_modelmeta().custom_metadata_map
    structured = ("observation", "action", "action_meaning", "conventions", "trained")
    return {name: json.loads(x) if name in structured else x for name, x in told.items()}


def test_a_file_describes_every_column_and_joint(tmp_path, envs, capsys):
    path = tmp_path / "new" / "policy.onnx"
    assert main([ROBOT, str(path)]) == 0
    assert f"robot of {ROBOT}, 21 observations, 7 actions" in capsys.readouterr().out
    told, env = described(path), envs[ROBOT]
    assert (told["env"], told["agent"], told["control_rate_hz"]) == (ROBOT, "robot", "10")
    spans = [(x["start"], x["stop"]) for x in told["observation"]]
    assert spans[0][0] == 0 and spans[-1][1] == env.observation_size
    assert all(a[1] == b[0] for a, b in pairwise(spans))
    mouth = told["observation"][1]
    assert (mouth["name"], mouth["unit"], mouth["frame"]) == ("hand_pos_mouth", "m", "world axes, from the mouth")  # fmt: skip
    assert [x["joint"] for x in told["action"]] == [f"right_j{i}" for i in range(7)]
    assert told["action"][1]["joint_limits_rad"] == pytest.approx([-3.8183, 2.2824], abs=1e-4)
    assert told["trained"]["env"] == ROBOT and told["trained"]["layout"]
    assert set(told["action_meaning"]) == {"robot"}


def test_joints_aim_where_the_description_says(envs):
    env = envs[ROBOT]
    entry = json.loads(contract(env, "robot", {})["action"])[1]
    low, high = entry["joint_limits_rad"]
    for start, wanted in ((1.0, 1.0 + entry["full_action_rad"]), (high - 0.12, high - 0.02)):
        angles, action = np.full(7, start, np.float32), np.eye(7, dtype=np.float32)[1]
        goal = env.controller.robot_goal(angles, action)[1]
        assert goal == pytest.approx(wanted, abs=1e-5) and low < goal < high


def test_robot_and_person_of_a_pair(tmp_path, envs):
    env, whole = envs[PAIR], load_policy(PAIR)
    obs, start = observations_of_pair(whole), 0
    for agent in ("robot", "human"):
        path = tmp_path / f"{agent}.onnx"
        assert main([PAIR, str(path), "--agent", agent]) == 0
        told, policy = described(path), getattr(whole, agent)
        seen = env.observation_sizes[agent]
        assert told["agent"] == agent and told["observation"][-1]["stop"] == seen
        assert len(told["action"]) == env.action_sizes[agent] == policy.arch.action_size
        mine = obs[:, start : start + seen]
        start += seen
        np.testing.assert_allclose(run(session(str(path)), mine), exact(policy, mine), rtol=0, atol=1e-6)  # fmt: skip
    assert [x["joint"] for x in told["action"]] == list(env.scene.moving)
    assert "muscles" in told["action_meaning"]["human"]


def observations_of_pair(pair: Any) -> np.ndarray:
    return np.concatenate([observations(pair.robot), observations(pair.human)], axis=1)


def test_a_policy_of_both_at_once_reads_both_and_moves_both(envs):
    told = contract(envs[PAIR], "joint", {})
    columns, joints = json.loads(told["observation"]), json.loads(told["action"])
    assert columns[-1]["stop"] == envs[PAIR].observation_size
    assert len(joints) == envs[PAIR].action_size
    assert [x["agent"] for x in joints] == ["robot"] * 7 + ["human"] * 10


def test_a_trained_policy_is_found_in_its_run(tmp_path):
    save_policy(tmp_path / ROBOT / "policy.npz", load_policy(ROBOT))
    assert main([ROBOT, str(tmp_path / "p.onnx"), "--load-dir", str(tmp_path)]) == 0
    assert choose_policy(ROBOT, str(tmp_path)) == tmp_path / ROBOT / "policy.npz"


@pytest.mark.parametrize(
    ("words", "told"),
    [
        ([ROBOT, "policy.pt"], ("ends in .onnx", "'policy.pt'")),
        ([ROBOT, ""], ("ends in .onnx",)),
        ([ROBOT, "folder.onnx"], ("is a folder",)),
        (["ReechingSawyer-v0", "p.onnx"], ("Did you mean 'ReachingSawyer-v0'",)),
        ([HIDDEN, "p.onnx"], ("ships no policy", "agym-jax train")),
        ([ROBOT, "p.onnx", "--policy", "none.npz"], ("No policy 'none.npz'",)),
        ([ROBOT, "p.onnx", "--policy", "zero"], ("'zero'", "--policy")),
        ([ROBOT, "p.onnx", "--load-dir", "nowhere"], ("No policy for", "nowhere")),
        ([ROBOT, "p.onnx", "--agent", "human"], ("holds still", active_id(ROBOT))),
        (["FeedingPR2-v0", "p.onnx", "--policy", "REACHING"], (f"trained in '{ROBOT}'",)),
        ([PAIR, "p.onnx", "--policy", "PERSON", "--agent", "robot"], ("moves the person",)),
        ([PAIR, "p.onnx", "--load-dir", "robots", "--agent", "human"], ("no person's policy",)),
    ],
)  # fmt: skip
def test_bad_input(words, told, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    hide_policies(monkeypatch, HIDDEN)
    (tmp_path / "folder.onnx").mkdir()
    save_policy(tmp_path / "robots" / PAIR / "policy.npz", load_policy(PAIR).robot)
    files = {"REACHING": f"policies/{ROBOT}.npz", "PERSON": f"policies/human/{PAIR}.npz"}
    words = [str(asset_path(files[word])) if word in files else word for word in words]
    assert main(words) == 2
    said = capsys.readouterr().err
    assert all(part in said for part in told), said
    assert not (tmp_path / "p.onnx").exists()


def test_errors_in_python(tmp_path, monkeypatch, envs):
    policy = load_policy(ROBOT)
    with pytest.raises(ArgumentError, match=r"ends in \.onnx"):
        export_policy(policy, envs[ROBOT], tmp_path / "policy.npz")
    with pytest.raises(PolicyEnvironmentError, match="was trained in"):
        export_policy(policy, envs[PAIR], tmp_path / "policy.onnx")
    hide_policies(monkeypatch, HIDDEN)
    with pytest.raises(PolicyNotFoundError, match="ships no policy"):
        choose_policy(HIDDEN)
    monkeypatch.setitem(sys.modules, "onnx", None)
    with pytest.raises(MissingExtraError, match=r"agym_jax\[onnx\]"):
        export_policy(policy, envs[ROBOT], tmp_path / "policy.onnx")
    assert FakeEnv().name == untrained("normal", "elu").info["env"]
    assert not list(tmp_path.iterdir())


# -- docs/onnx.md --------------------------------------------------------------------------------

PAGE = (ROOT / "docs" / "onnx.md").read_text()


def block(name: str) -> str:
    """An example of the page."""
    return PAGE.partition(f'```python title="{name}"\n')[2].partition("```")[0]


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("onnx")
    assert f"agym-jax export {ROBOT} policy.onnx" in PAGE
    assert main([ROBOT, str(folder / "policy.onnx")]) == 0
    return folder


def test_the_acting_part_of_the_page_needs_no_jax(folder):
    code = block("act.py") + (
        "\nimport sys\nassert policy(np.zeros(21)).shape == (7,)\n"
        "assert not {'jax', 'agym_jax', 'mujoco', 'onnx'} & set(sys.modules)\n"
    )
    found = subprocess.run(
        [sys.executable, "-c", code], cwd=folder, capture_output=True, text=True, check=False, timeout=PROCESS_SECONDS
    )  # fmt: skip
    assert found.returncode == 0, found.stderr
    assert found.stdout.startswith(f"{ROBOT} 10 Hz; right_j0, ")


@pytest.mark.jit
def test_the_episode_of_the_page_succeeds(folder, monkeypatch, capsys):
    monkeypatch.chdir(folder)
    names: dict[str, Any] = {}
    exec(compile(block("act.py") + block("episode.py"), "docs/onnx.md", "exec"), names)
    assert "success: 1, hand " in capsys.readouterr().out
    assert names["distance"] < 0.03


def test_the_page_lists_what_is_in_the_file(folder):
    rows = PAGE.partition("| key | what |")[2].partition("Inside")[0]
    listed = {name for row in rows.splitlines() for name in row.split("|")[1:2] for name in name.replace("`", "").replace(",", " ").split()}  # fmt: skip
    assert listed - {"---"} == set(described(folder / "policy.onnx"))
