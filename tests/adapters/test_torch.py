# ruff: noqa: D103
"""Environments in PyTorch: the same numbers in the same memory, and the conventions of rsl_rl, skrl and Stable-Baselines3."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import gymnasium
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from fake_env import FakeEnv, FakeState

import agym_jax
from agym_jax import errors as e
from agym_jax.adapters.carried import Carried
from agym_jax.adapters.vector import GymnasiumVectorEnv

pytestmark = pytest.mark.torch
torch = pytest.importorskip("torch", reason='needs pip install "agym_jax[torch,rl]"')
from agym_jax.adapters.torch import TorchVectorEnv, packed  # noqa: E402

NAME = "ReachingJaco-v0"
B, T = 3, 200


@pytest.fixture(scope="module")
def core() -> agym_jax.Env:
    return agym_jax.make(NAME, impl="native")


@pytest.fixture(scope="module")
def envs(core) -> TorchVectorEnv:
    return TorchVectorEnv(core, B)


def random_actions(steps: int) -> Any:
    return torch.rand((steps, B, 7), generator=torch.Generator().manual_seed(0)) * 2 - 1


@pytest.mark.jit
def test_episodes_are_those_of_make_vec(envs):
    others = gymnasium.make_vec(NAME, num_envs=B, impl="native")
    np.testing.assert_array_equal(envs.reset(seed=4)[0], others.reset(seed=4)[0])
    np.testing.assert_array_equal(envs.reset()[0], others.reset()[0])
    for i, action in enumerate(random_actions(T + 2)):
        obs, reward, terminated, truncated, info = envs.step(action)
        theirs = others.step(action.numpy())
        np.testing.assert_array_equal(obs, theirs[0])
        np.testing.assert_array_equal(reward, np.float32(theirs[1]))
        assert truncated.all() == (i == T - 1) and not terminated.any()
        np.testing.assert_array_equal(truncated, theirs[3])
        success = theirs[4]["task_success"]
        np.testing.assert_array_equal(info["metrics"]["success"] > 0, success > 0)
        last = np.stack(theirs[4]["final_obs"]) if truncated.all() else theirs[0]
        np.testing.assert_array_equal(info["final_observation"], last)
    assert reward.dtype == obs.dtype == torch.float32 and truncated.dtype == torch.bool
    assert set(info["metrics"]) == set(envs.core.metric_names) and len(info["metrics"]) > 10
    others.close()


@pytest.mark.jit
def test_tensors_lie_where_the_state_does(envs):
    envs.reset(seed=0)
    obs = envs.step(random_actions(1)[0])[0]
    assert obs.data_ptr() == envs.state.obs.ctypes.data
    action = random_actions(1)[0]
    assert envs.array(action).ctypes.data == action.data_ptr()
    envs.clocks = torch.tensor([5, 198, 0])
    assert envs.clocks.tolist() == [5, 198, 0]
    assert not envs.step(action)[3].any()
    assert envs.step(action)[3].tolist() == [False, True, False]


def test_what_an_accelerator_packs_is_told_apart_again():
    n = 5  # not a multiple of the four ends that share a word
    envs: Any = SimpleNamespace(num_envs=n, core=SimpleNamespace(observation_size=3))
    rng = np.random.default_rng(0)
    told = [
        rng.normal(size=(n, 3)).astype(np.float32),
        np.full((n, 3), [np.nan, 1e-42, -0.0], np.float32),
        rng.normal(size=n).astype(np.float32),
        np.array([True, False, False, True, True]),
        np.array([False, True, False, False, True]),
    ]
    array = jax.jit(packed)([jnp.asarray(x) for x in told])
    for mine, theirs in zip(
        TorchVectorEnv._unpacked(envs, torch.from_dlpack(array)), told, strict=True
    ):
        assert mine.is_contiguous() and mine.numpy().dtype == theirs.dtype
        np.testing.assert_array_equal(mine.numpy().view(np.uint8), theirs.view(np.uint8))


def test_what_is_empty_is_not_carried():
    state = {"a": jnp.ones(2), "b": jnp.ones((3, 0)), "c": (jnp.zeros(()), jnp.zeros(0, int))}
    carried = Carried(state)
    arrays = carried.arrays(jax.tree.map(lambda x: x + 1, state))
    assert [x.tolist() for x in arrays] == [[2, 2], 1]
    back = carried.state(arrays)
    assert jax.tree.structure(back) == jax.tree.structure(state)
    assert back["b"].shape == (3, 0) and back["c"][1].dtype == state["c"][1].dtype


@dataclass
class Points(FakeEnv):
    """What ``vectorize`` takes, traced by JAX."""

    privileged_obs_size: int = 0

    def sized_for(self, num_envs: int) -> Points:
        """The same."""
        return self

    def reset_where(self, state: FakeState, where: Any) -> FakeState:
        """A new episode where it holds."""
        fresh = self._first(state.key).replace(
            reward=state.reward, done=state.done, metrics=state.metrics
        )
        return jax.tree.map(lambda a, b: jnp.where(where, a, b), fresh, state)


def test_arrays_of_jax_are_shared_as_well():
    points: Any = Points()
    envs = TorchVectorEnv(points, 4)
    obs, _ = envs.reset(seed=0)
    assert envs.device == torch.device("cpu")
    assert obs.data_ptr() == envs.state.obs.unsafe_buffer_pointer()
    wide = torch.zeros(4, 16)  # JAX takes over memory that begins at a multiple of 64 bytes
    assert wide.data_ptr() % 64 or envs.array(wide).unsafe_buffer_pointer() == wide.data_ptr()
    first = obs.clone()
    with torch.inference_mode():  # as in runners
        for i in range(points.episode_length):
            obs, reward, _, truncated, info = envs.step(torch.ones(4, 2, requires_grad=True))
            assert truncated.all() == (i == points.episode_length - 1)
    assert torch.allclose(info["final_observation"][:, :2], torch.tensor(4.0))
    assert (obs[:, :2] == 0).all() and not torch.equal(obs[:, 2:], first[:, 2:])
    assert (reward < 0).all() and points.traces["step"] == 1


def never(*_: Any, **__: Any) -> Any:
    raise AssertionError("it went on")


@pytest.mark.parametrize(
    ("arguments", "error", "told"),
    [
        (("JacoReaching-v0",), e.UnknownNameError, "Did you mean 'ReachingJaco-v0'"),
        ((NAME, 0), e.ArgumentError, "num_envs must be a whole number of at least 1, got 0"),
        ((NAME, 2.5), e.ArgumentError, "got 2.5"),
        ((NAME, 2, "mjx"), e.ImplementationError, "'mjx'"),
        ((None, 2), e.ArgumentError, "takes an environment"),
    ],
)
def test_what_does_not_exist_is_refused(arguments, error, told):
    with pytest.raises(error, match=told):
        TorchVectorEnv(*arguments)


def test_settings_belong_to_make(core):
    with pytest.raises(e.ArgumentError, match=r"humans, impl: pass settings to agym_jax\.make"):
        TorchVectorEnv(core, 2, impl="jax", humans=None)
    with pytest.raises(e.ArgumentError, match="Population"):
        TorchVectorEnv(NAME, 2, humans="children")


@pytest.mark.parametrize(
    ("action", "told"),
    [
        (lambda: np.zeros((B, 7)), "takes a tensor of actions, got ndarray.*torch.as_tensor"),
        (lambda: torch.zeros(B, 6), r"of shape \(3, 7\), got \(3, 6\)"),
        (lambda: torch.zeros(7), r"of shape \(3, 7\), got \(7,\)"),
        (lambda: torch.zeros((B, 7), device="meta"), r"on cpu, got them on meta: actions\.to"),
        (lambda: torch.full((B, 7), torch.nan), "finite actions"),
    ],
)
@pytest.mark.jit
def test_actions_that_do_not_fit_are_refused(envs, action, told):
    envs.reset(seed=0)
    with pytest.raises(e.ActionError, match=told):
        envs.step(action())
    assert (envs.clocks == 0).all()


def test_nothing_is_stepped_before_it_begins(core):
    fresh = TorchVectorEnv(core, B)
    with pytest.raises(gymnasium.error.ResetNeeded, match="before reset"):
        fresh.step(torch.zeros(B, 7))
    with pytest.raises(gymnasium.error.ResetNeeded):
        _ = fresh.observations


def test_a_device_that_pytorch_cannot_use_is_named(monkeypatch):
    monkeypatch.setattr(jax, "default_backend", lambda: "gpu")
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    points: Any = Points()
    with pytest.raises(e.ImplementationError, match=r"'gpu'.*PyTorch with CUDA.*JAX_PLATFORMS=cpu"):
        TorchVectorEnv(points, 2)


@pytest.mark.parametrize("module", ["rsl_rl", "skrl", "stable_baselines3", "torch"])
def test_a_missing_library_is_named(module, monkeypatch):
    ours = f"agym_jax.adapters.{module}"
    for name in [x for x in sys.modules if x == module or x.startswith(f"{module}.")]:
        monkeypatch.setitem(sys.modules, name, None)
    monkeypatch.setitem(sys.modules, module, None)
    monkeypatch.delitem(sys.modules, ours, raising=False)
    with pytest.raises(e.MissingExtraError, match=r'pip install .*agym_jax\[(rl|torch)\]"'):
        __import__(ours)


# -- rsl_rl, skrl, Stable-Baselines3 ---------------------------------------------------------------


@pytest.mark.jit
def test_rsl_rl_is_told_of_groups_time_outs_and_successes(core, monkeypatch):
    pytest.importorskip("rsl_rl")
    from rsl_rl.env import VecEnv

    from agym_jax.adapters.rsl_rl import RslRlVecEnv

    env = RslRlVecEnv(core, B, seed=4)
    assert isinstance(env, VecEnv) and (env.num_actions, env.max_episode_length) == (7, T)
    obs = env.get_observations()
    assert set(obs.keys()) == {"policy"} and obs.batch_size == torch.Size([B])
    np.testing.assert_array_equal(obs["policy"], TorchVectorEnv(core, B).reset(seed=4)[0])
    env.episode_length_buf = torch.tensor([199, 0, 0])
    obs, reward, dones, extras = env.step(random_actions(1)[0])
    assert dones.tolist() == extras["time_outs"].tolist() == [True, False, False]
    assert reward.shape == (B,) and extras["log"]["/success"].shape == ()
    assert env.episode_length_buf.tolist() == [0, 1, 1]
    assert "log" not in env.step(random_actions(1)[0])[3]
    hidden = torch.ones(B, 2)
    monkeypatch.setattr(TorchVectorEnv, "privileged", hidden)
    assert torch.equal(env.get_observations()["privileged"], hidden)
    assert (env.reset()[0]["policy"] != obs["policy"]).any() and env.cfg["env"] == NAME


@pytest.mark.jit
def test_skrl_gets_columns_and_one_beginning(core, monkeypatch):
    pytest.importorskip("skrl")
    from skrl.envs.wrappers.torch import Wrapper

    from agym_jax.adapters.skrl import SkrlEnv

    env = SkrlEnv(core, B, seed=4)
    assert isinstance(env, Wrapper) and env.num_envs == B and env.device == torch.device("cpu")
    assert env.action_space.shape == (7,) and env.observation_space.shape == (21,)
    assert env.state_space is None
    first = env.reset()[0]
    np.testing.assert_array_equal(first, TorchVectorEnv(core, B).reset(seed=4)[0])
    env.envs.clocks = torch.tensor([199, 0, 0])
    obs, reward, terminated, truncated, info = env.step(random_actions(1)[0])
    assert reward.shape == terminated.shape == truncated.shape == (B, 1)
    assert truncated[:, 0].tolist() == [True, False, False]
    assert info["episode"]["success"].numel() == 1 and env.state() is None
    assert torch.equal(env.reset()[0], obs)
    monkeypatch.setattr(TorchVectorEnv, "privileged", torch.ones(B, 2))
    assert env.state().shape == (B, 23)


@pytest.fixture(scope="module")
def vector() -> Iterator[GymnasiumVectorEnv]:
    envs = gymnasium.make_vec(
        NAME, num_envs=B, impl="native", render_mode="rgb_array", width=32, height=24
    )
    yield envs
    envs.close()


@pytest.mark.jit
def test_stable_baselines_gets_infos_of_what_ended(vector, raycast):
    pytest.importorskip("stable_baselines3")
    from stable_baselines3.common.vec_env import VecMonitor

    from agym_jax.adapters.stable_baselines3 import StableBaselinesVecEnv

    env = StableBaselinesVecEnv(vector)
    env.seed(4)
    obs = env.reset()
    np.testing.assert_array_equal(obs, vector.reset(seed=4)[0])
    assert not np.array_equal(env.reset(), obs)  # seeds hold once
    assert env.render().shape == (48, 64, 3)
    monitor = VecMonitor(env)
    monitor.reset()
    for i in range(T):
        obs, reward, dones, infos = monitor.step(random_actions(1)[0].numpy())
        assert dones.all() == (i == T - 1) and reward.dtype == np.float32
    for i, info in enumerate(infos):
        assert info["episode"]["l"] == T and info["TimeLimit.truncated"] is True
        assert info["is_success"] in (True, False)
        assert not np.array_equal(info["terminal_observation"], obs[i])
    assert env.get_attr("num_envs", [0, 1]) == [B, B] and env.env_is_wrapped(object) == [False] * B
    for call in (lambda: env.set_attr("width", 3), lambda: env.env_method("jump")):
        with pytest.raises(AttributeError, match="stepped together"):
            call()
    for wrong in (gymnasium.wrappers.vector.ClipReward(vector, 0, 1), SimpleNamespace(), None):
        with pytest.raises(e.ArgumentError, match=r"gymnasium\.make_vec"):
            StableBaselinesVecEnv(wrong)


@pytest.mark.jit
def test_the_overhead_is_measured_of_both_loops(tmp_path, capsys):
    from benchmarks import torch_overhead

    words = ["--num-envs", "2", "--steps", "2", "--repeats", "2"]
    assert torch_overhead.main([*words, "--json", str(tmp_path / "x.jsonl")]) == 0
    assert "overhead_percent" in capsys.readouterr().out
    assert '"impl": "native"' in (tmp_path / "x.jsonl").read_text()
    assert torch_overhead.main([*words, "--repeats", "0"]) == 2
    assert "--repeats must be" in capsys.readouterr().err
