# ruff: noqa: D103 (a test's name says what it shows)
"""Checkpoints: exact round trips, damage, and checkpoints of something else."""

from __future__ import annotations

import os
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from fake_env import FakeEnv

from agym_jax.data.npz import check_writable, read_npz, write_npz
from agym_jax.errors import DamagedFileError, SaveFolderError
from train.configs import PPOConfig
from train.errors import (
    CheckpointMismatchError,
    CheckpointWarning,
)
from train.learning.agents import Agents, LearnerState
from train.runs.checkpoint import (
    KEEP,
    checkpoint_files,
    load_checkpoint,
    load_newest,
    save_checkpoint,
)

CONFIG = PPOConfig(policy_hidden=(8,), value_hidden=(8,))
COMPATIBILITY = {"env": "FakeReach-v0", "layout": "fake-1"}


def agents_of(config):
    """The agent of the fake environment."""
    return Agents(config, FakeEnv(), ("robot",))


@pytest.fixture(scope="module")
def learner():
    """A learner with no leaf at its initial value."""
    learner = jax.jit(agents_of(CONFIG).init)(jax.random.PRNGKey(0))
    leaves, tree = jax.tree.flatten(learner)
    rng = np.random.default_rng(0)
    leaves = [
        jnp.asarray(rng.integers(1, 1000, leaf.shape), leaf.dtype)
        if jnp.issubdtype(leaf.dtype, jnp.integer)
        else jnp.asarray(rng.normal(size=leaf.shape), leaf.dtype)
        for leaf in leaves
    ]
    return jax.tree.unflatten(tree, leaves)


def at_step(learner, steps):
    """The learner as if it had made so many steps."""
    agents = {
        name: replace(agent, env_steps=jnp.uint32(steps)) for name, agent in learner.agents.items()
    }
    return LearnerState(agents, learner.key)


def save_steps(folder, learner, *steps):
    """Save checkpoints of some steps."""
    return [
        save_checkpoint(folder, at_step(learner, s), {"compatibility": COMPATIBILITY})
        for s in steps
    ]


def test_a_learner_comes_back_bit_for_bit_with_its_types(tmp_path, learner):
    (path,) = save_steps(tmp_path, learner, 700)
    template = jax.eval_shape(lambda: at_step(learner, 0))
    found = load_checkpoint(path, template, COMPATIBILITY)
    wanted = at_step(learner, 700)
    assert jax.tree.structure(found.learner) == jax.tree.structure(wanted)
    for have, want in zip(jax.tree.leaves(found.learner), jax.tree.leaves(wanted), strict=True):
        assert have.dtype == want.dtype and not have.weak_type
        assert np.asarray(have).tobytes() == np.asarray(want).tobytes()


def test_only_the_newest_few_are_kept_and_leftovers_of_a_kill_are_removed(tmp_path, learner):
    (tmp_path / ".step_000000000001.npz.abc").write_bytes(b"half")
    save_steps(tmp_path, learner, 1, 2, 3, 4, 5)
    assert [int(p.stem[5:]) for p in checkpoint_files(tmp_path)] == [5, 4, 3][:KEEP]
    assert len(list(tmp_path.iterdir())) == KEEP


@pytest.mark.parametrize("damage", ["cut", "flip", "empty", "other"])
def test_a_damaged_checkpoint_is_skipped_with_a_warning(tmp_path, learner, damage):
    before, newest = save_steps(tmp_path, learner, 100, 200)
    content, robot = bytearray(newest.read_bytes()), learner.agents["robot"]
    kernel = np.asarray(robot.params.value["params"]["hidden_0"]["kernel"]).tobytes()
    content[content.index(kernel) + 9] ^= 0x40
    other = np.random.default_rng(0).bytes(500)
    newest.write_bytes(
        {"cut": content[: len(content) // 3], "flip": content, "empty": b"", "other": other}[damage]
    )
    with pytest.warns(CheckpointWarning, match=r"step_000000000200.*Using the one before it"):
        found = load_newest(tmp_path, learner, COMPATIBILITY)
    assert found.path == before and int(found.learner.env_steps) == 100


def test_no_flipped_byte_goes_unnoticed(tmp_path):
    path = tmp_path / "x.npz"
    write_npz(path, {"a": np.arange(5.0), "b": np.ones((2, 3), np.int32)}, {"n": 1})
    content = path.read_bytes()
    arrays, meta = read_npz(path)
    for i in range(0, len(content), 7):
        path.write_bytes(content[:i] + bytes([content[i] ^ 0xFF]) + content[i + 1 :])
        try:  # a byte that carries no content (a time stamp) may change, the content may not
            again, meta_again = read_npz(path)
        except DamagedFileError:
            continue
        assert meta_again == meta and again.keys() == arrays.keys()
        assert all(np.array_equal(again[k], arrays[k]) for k in arrays)


def test_when_all_are_damaged_the_error_says_what_to_do(tmp_path, learner):
    for path in save_steps(tmp_path, learner, 1, 2):
        path.write_bytes(b"nothing")
    with (
        pytest.warns(CheckpointWarning),
        pytest.raises(DamagedFileError, match=r"All 2 checkpoints.*--fresh"),
    ):
        load_newest(tmp_path, learner, COMPATIBILITY)


def test_a_folder_without_checkpoints_gives_none(tmp_path, learner):
    assert load_newest(tmp_path / "nowhere", learner, COMPATIBILITY) is None


def test_a_checkpoint_of_another_environment_or_layout_is_refused_by_name(tmp_path, learner):
    save_steps(tmp_path, learner, 1)
    text = r"env is 'FakeReach-v0', this run has 'Other-v0'.*--save-dir.*--fresh"
    with pytest.raises(CheckpointMismatchError, match=text):
        load_newest(tmp_path, learner, {**COMPATIBILITY, "env": "Other-v0"})
    with pytest.raises(CheckpointMismatchError, match="layout is 'fake-1', this run has 'fake-2'"):
        load_newest(tmp_path, learner, {**COMPATIBILITY, "layout": "fake-2"})


def test_a_checkpoint_of_another_network_names_the_sizes(tmp_path, learner):
    save_steps(tmp_path, learner, 1)
    config = PPOConfig(policy_hidden=(16,), value_hidden=(8,))
    wider = jax.eval_shape(agents_of(config).init, jax.random.PRNGKey(0))
    text = r"agents/robot/params/policy/params/.* is float32\[4, 8\], not float32\[4, 16\]"
    with pytest.raises(CheckpointMismatchError, match=text):
        load_newest(tmp_path, wider, COMPATIBILITY)


def test_a_checkpoint_from_before_layer_normalisation_fits_a_run_without_it(tmp_path):
    plain, normalised = (agents_of(replace(CONFIG, value_layer_norm=x)) for x in (False, True))
    known = plain.compatibility()
    before = {name: x for name, x in known.items() if not name.endswith("value_layer_norm")}
    assert len(before) == len(known) - 1
    learner = jax.jit(plain.init)(jax.random.PRNGKey(0))
    path = save_checkpoint(tmp_path, learner, {"compatibility": before})
    load_checkpoint(path, learner, known)
    text = r"robot.value_layer_norm is False, this run has True\. Its networks were made with --no-value-layer-norm\. Continue"
    with pytest.raises(CheckpointMismatchError, match=text):
        load_checkpoint(path, learner, normalised.compatibility())
    wider = agents_of(replace(CONFIG, value_layer_norm=False, value_hidden=(32, 16)))
    sizes = " ".join(map(str, CONFIG.value_hidden))
    with pytest.raises(CheckpointMismatchError, match=rf"made with --value-hidden {sizes}\. Cont"):
        load_checkpoint(path, learner, wider.compatibility())


def test_a_write_that_fails_leaves_the_old_file_and_no_rubbish(tmp_path, monkeypatch):
    path = tmp_path / "x.npz"
    write_npz(path, {"a": np.zeros(2)}, {})

    def fail(*_):
        raise OSError("disk full")

    monkeypatch.setattr(os, "replace", fail)
    with pytest.raises(OSError, match="disk full"):
        write_npz(path, {"a": np.ones(2)}, {})
    assert [p.name for p in tmp_path.iterdir()] == ["x.npz"]
    assert read_npz(path)[0]["a"].tolist() == [0.0, 0.0]


def test_an_unwritable_folder_is_named(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(SaveFolderError, match=r"file/below.*Not a directory.*--save-dir"):
        check_writable(tmp_path / "file" / "below")


def test_files_hold_no_pickle(tmp_path):
    path = tmp_path / "x.npz"
    np.savez(path, a=np.array([{"evil": 1}], dtype=object))
    with pytest.raises(DamagedFileError, match="not a file of this project"):
        read_npz(path)
