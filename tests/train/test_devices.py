# ruff: noqa: D103 (a test's name says what it shows)
"""Several devices and several hosts: the same training as on one, in processes with two CPU devices."""

from __future__ import annotations

import json
import re
import socket
import subprocess

import pytest
from paths import PROCESS_SECONDS
from train_runs import start_python
from xla_flags import with_devices

from train.errors import ConfigError
from train.learning.hosts import join_hosts, parse_hosts

TWO = with_devices(2)

# One rollout, learned from whole on one device and in two halves on two devices.
SAME_UPDATE = """
import dataclasses, json
import jax, jax.numpy as jnp, numpy as np
from jax.sharding import PartitionSpec as P
from fake_pair_env import FakePairEnv
from fake_press_env import FakePairPressEnv
from train.configs import CoopConfig, PPOConfig
from train.learning.agents import Agents
from train.learning.ppo import Hyper
from train.learning.constraint import record_comfort
from train.learning.rollout import collect, critic_obs, init_rollout, record_step
from train.learning.seeds import SideBySide, lane_keys, lanes_of
from train.learning.sharding import AXIS, device_mesh

SETTINGS = dict(num_mini_batch=1, ppo_epoch=3, policy_hidden=(16,), value_hidden=(16,), lr=1e-2,
                distribution="normal", entropy_coef=0.01)
env = FakePairEnv()
PAIR = ("robot", "human")
cases = {
    "one agent": Agents(PPOConfig(**SETTINGS), env, ("joint",)),
    "central critic": Agents(CoopConfig(**SETTINGS, central_critic=True), env, PAIR),
}
press = FakePairPressEnv()
cases["cost limit"] = Agents(CoopConfig(**SETTINGS, cost_limit=0.5), press, PAIR)
two = Agents(CoopConfig(**SETTINGS), env, PAIR)
cases["two agents, two seeds"] = SideBySide(two, lanes_of(dataclasses.replace(two.config, num_seeds=2)))
found = {}
for name, agents in cases.items():
    seeds = getattr(agents, "count", 1)

    def keys(number):
        several = jax.random.split(jax.random.PRNGKey(number), seeds)
        return several if seeds > 1 else several[0]

    def by_device(x, axis):
        # of each seed, one half of the environments after the other; now of each half, one seed after the other
        shape = x.shape
        x = x.reshape(*shape[:axis], seeds, 2, -1, *shape[axis + 1:])
        return jnp.swapaxes(x, axis, axis + 1).reshape(shape)

    limited = agents.config.cost_limit is not None
    venv = (press if limited else env).vectorize(8 * seeds)
    learner = jax.jit(agents.init)(keys(0))
    rollout = init_rollout(venv, keys(1), True)
    rollout, batch, _ = jax.jit(lambda rollout: collect(
        lambda obs, key: agents.act(learner, obs, key), venv, rollout, keys(2),
        num_steps=30, gamma=0.99, reward_scaling=1.0,
        record=record_comfort if limited else record_step))(rollout)
    key = keys(3)
    hyper = agents.hyper(1000)

    def learn(learner, batch, last, axis=None):
        return agents.learn(learner, batch, last, key, hyper, axis)

    last = critic_obs(rollout.env_state)
    whole, losses = jax.jit(learn)(learner, batch, last)
    shared = jax.shard_map(
        lambda *x: learn(*x, axis=AXIS), mesh=device_mesh(0), check_vma=False,
        in_specs=(P(), P(None, AXIS), P(AXIS)), out_specs=P())
    split, last = jax.tree.map(lambda x: by_device(x, 1), batch), by_device(last, 0)
    halves, losses_of_two = jax.jit(shared)(learner, split, last)
    count = 4 * seeds
    own_half, _ = jax.jit(learn)(learner, jax.tree.map(lambda x: x[:, :count], split), last[:count])

    def apart(a, b):
        pairs = zip(jax.tree.leaves(a), jax.tree.leaves(b), strict=True)
        pairs = [(np.asarray(x, float), np.asarray(y, float)) for x, y in pairs]
        return max(float((np.abs(x - y) / np.maximum(1, np.abs(x))).max()) for x, y in pairs)

    params = lambda state: [agent.params for agent in state.agents.values()]
    found[name] = {
        "all": apart(whole, halves), "losses": apart(losses, losses_of_two),
        "moved": apart(params(whole), params(learner)),
        "half": apart(params(whole), params(own_half)),
        "steps": int(halves.env_steps.max()),
    }
print(json.dumps(found))
"""

# Environments, and a constant, with arrays that have no elements, on two devices.
EMPTY = """
import json
import jax, jax.numpy as jnp
from train.learning.sharding import AXIS, device_mesh, shard, shardings

nothing, three = jnp.zeros((0, 2)), jnp.arange(3.0)

def first(key):
    return {"none": jnp.zeros((2, 0), jnp.int32), "x": jax.random.normal(key, (2,)) + nothing.sum()}

def run(learner, rollout, count, hyper):
    assert rollout["none"].shape == (2, 0) and rollout["none"].dtype == jnp.int32
    moved = rollout["x"] + three.sum() + learner + nothing.sum()
    return learner, rollout | {"x": moved}, {"sum": jax.lax.psum(moved.sum(), AXIS)}

mesh = device_mesh(0)
common, own = shardings(mesh)
first, run = shard(mesh, first, run)
begin = jax.jit(first, out_shardings=own).lower(jax.random.PRNGKey(0))
rollout = begin.compile()(jax.random.PRNGKey(0))
go = jax.jit(run, out_shardings=(common, own, common)).lower(jnp.float32(1), rollout, 1, 1.0)
_, after, totals = go.compile()(jnp.float32(1), rollout, 1, 1.0)
print(json.dumps({
    "empty": str(rollout["none"]), "moved": (after["x"] - rollout["x"]).tolist(),
    "apart": float(abs(rollout["x"][0] - rollout["x"][1]).min()),
    "sum": float(totals["sum"]), "is": float(after["x"].sum()), "text": begin.as_text() + go.as_text()}))
"""

# Two seeds on two devices, a robot alone and a pair, with a run that goes on with another number of them; what is refused.
SEEDS = """
import dataclasses, json, tempfile
import jax
from pathlib import Path
from fake_pair_env import FakePairEnv
from train.configs import CoopConfig, PPOConfig
from train.errors import ConfigError
from train import coop, ppo

BASE = dict(num_env_steps=60_000, num_envs=32, num_mini_batch=4, policy_hidden=(32,), num_seeds=2,
            value_hidden=(32,), lr=2e-3, log_interval=8, save_dir=None,
            recompute_advantages=False)  # 32 environments: values would learn so few steps by heart
found = {"devices": jax.device_count(), "refused": []}
for fields in ({"devices": 3}, {"num_envs": 33}):
    try:
        coop.train(FakePairEnv(), CoopConfig(**BASE | fields))
    except ConfigError as error:
        found["refused"].append(str(error))
result = ppo.train(FakePairEnv(active=False), PPOConfig(**BASE, restart_share=0.5, num_candidates=2, candidates_until=0.3))
found["restarts"] = [seed.curve[-1]["success"] for seed in result.seeds], result.config.devices
with tempfile.TemporaryDirectory() as folder:
    config, sessions = CoopConfig(**BASE | {"save_dir": folder}), []
    for devices, rounds in ((2, 8), (1, 16), (2, 24)):
        part = dataclasses.replace(config, num_env_steps=640 * rounds, devices=devices)
        result = coop.train(FakePairEnv(), part)
        sessions.append([result.session_steps, result.config.devices])
    found["sessions"] = sessions
    run = Path(folder) / "FakeCarryHuman-v0"
    for seed in ("seed_1", "seed_2"):
        rows = [json.loads(line) for line in (run / seed / "curve.jsonl").read_text().splitlines()]
        found[seed] = [row["env_steps"] for row in rows]
    found["files"] = sorted(path.name for path in run.glob("seed_*/*.npz"))
    found["combined"] = [[row["env_steps"], row["num_seeds"]] for row in result.curve]
print(json.dumps(found))
"""

# One of two hosts, each with one device.
HOST = """
import json, sys
import jax
from fake_pair_env import FakePairEnv
from train import coop
words = {words!r}
made = []
train = coop.train
def kept(*arguments):
    made.append(train(*arguments))
    return made[0]
coop.train = kept
status = coop.main(words, lambda *_: FakePairEnv())
result = made[0]
weights = sum(float(abs(x).sum()) for x in jax.tree.leaves(result.learner.agents["human"].params))
print(json.dumps({{"status": status, "hosts": jax.process_count(), "devices": jax.device_count(),
    "returns": [row["return"] for row in result.curve], "weights": weights, "steps": result.env_steps,
    "writes": result.folder is not None}}))
"""


def last_line(process: subprocess.Popen) -> dict:
    """What a process printed last, as JSON."""
    try:
        out, err = process.communicate(timeout=PROCESS_SECONDS)
    finally:  # also where this fails: the process must not outlive the test
        process.kill()
    assert process.returncode == 0, err[-3000:]
    return json.loads(out.splitlines()[-1])


def piped(code: str, **options) -> subprocess.Popen:
    return start_python(code, stdout=subprocess.PIPE, stderr=subprocess.PIPE, **options)


@pytest.mark.slow
def test_an_update_on_two_devices_is_the_update_on_one():
    found = last_line(piped(SAME_UPDATE, env=TWO))
    assert len(found) == 4
    for name, gaps in found.items():
        assert gaps["all"] < 2e-4 and gaps["losses"] < 2e-4, (name, gaps)
        assert gaps["moved"] > 1e-2 and gaps["half"] > 1e-3, (name, gaps)
        assert gaps["steps"] == 8 * 30


@pytest.mark.slow
def test_what_is_empty_is_not_given_from_device_to_device():
    found = last_line(piped(EMPTY, env=TWO))
    given = re.findall(r"sdy.manual_computation.*?manual_axes=\S+ \((.*?)\) \{", found["text"])
    assert len(given) == 2 and not any(re.search(r"<(\d+x)*0x", text) for text in given)
    assert found["empty"] == "Empty(shape=(2, 0), dtype=dtype('int32'))"
    assert found["moved"] == [[pytest.approx(4.0, abs=1e-5)] * 2] * 2
    assert found["sum"] == pytest.approx(found["is"], abs=1e-5) and found["apart"] > 1e-3


@pytest.mark.slow
def test_two_seeds_on_two_devices_learn_and_are_resumed_whole():
    found = last_line(piped(SEEDS, env=TWO))
    success, devices = found["restarts"]
    assert len(success) == devices == found["devices"] == 2 and min(success) > 0.9
    too_many, odd = found["refused"]
    assert "--devices 3 were asked for; JAX sees 2 (cpu)" in too_many
    assert (
        "33 environments cannot be divided evenly among 2 devices" in odd and "--num-envs 32" in odd
    )
    assert found["sessions"] == [[2 * 640 * 8, devices] for devices in (2, 1, 2)]
    assert found["seed_1"] == found["seed_2"] == [640 * 8, 640 * 16, 640 * 24]
    assert found["combined"] == [[640 * rounds, 2] for rounds in (8, 16, 24)]
    assert found["files"] == ["human_policy.npz"] * 2 + ["policy.npz"] * 2


def free_port() -> int:
    with socket.socket() as server:
        server.bind(("127.0.0.1", 0))
        return server.getsockname()[1]


@pytest.mark.slow
def test_two_hosts_train_one_policy_and_one_of_them_writes(tmp_path):
    words = "--env-name FakeCarryHuman-v0 --num-env-steps 10240 --num-envs 32 --lr 3e-3 "
    words += "--policy-hidden 32 --value-hidden 32 --num-mini-batch 4 --log-interval 4 "
    words += f"--save-dir {tmp_path} --hosts 127.0.0.1:{free_port()},2,"
    hosts = [piped(HOST.format(words=f"{words}{i}".split())) for i in (0, 1)]
    first, second = (last_line(process) for process in hosts)
    assert first["hosts"] == first["devices"] == 2
    assert first["status"] == second["status"] == 0 and first["steps"] == 10240
    assert first["returns"][-1] > first["returns"][0] + 1
    assert (first["writes"], second["writes"]) == (True, False)
    same = ("returns", "weights", "steps", "devices")
    assert [first[name] for name in same] == [second[name] for name in same]
    assert (tmp_path / "FakeCarryHuman-v0" / "human_policy.npz").is_file()


def test_hosts_are_named_by_address_count_and_index():
    assert parse_hosts("10.0.0.1:8476,2,1") == ("10.0.0.1:8476", 2, 1)
    assert parse_hosts("[::1]:8476,2,0") == ("[::1]:8476", 2, 0)
    assert parse_hosts("auto") is None
    join_hosts(None)


@pytest.mark.parametrize(
    ("hosts", "text"),
    [
        ("", "names no machines"),
        ("10.0.0.1:8476", "names no machines"),
        ("10.0.0.1,2,0", "names no machines"),
        (":8476,2,0", "names no machines"),
        ("10.0.0.1:8476,2,-1", "names no machines"),
        ("10.0.0.1:8476,2,2", "indices are 0 to 1"),
        ("10.0.0.1:8476,0,0", "names no machines"),
    ],
)
def test_hosts_that_make_no_sense_are_refused(hosts, text):
    with pytest.raises(ConfigError, match=rf"{text}.*--hosts auto"):
        parse_hosts(hosts)
