# ruff: noqa: D103
"""The example in ``docs/brax.md`` trains: with small numbers, on a real environment."""

from __future__ import annotations

import re
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from paths import ROOT

import agym_jax
from agym_jax.adapters import brax
from agym_jax.compat import switch
from agym_jax.errors import WrapperError

PAGE = ROOT / "docs" / "brax.md"
TEXT = PAGE.read_text()
SIZES, TRAINING = re.findall(r"^```python\n(.*?)^```$", TEXT, re.S | re.M)
SMALL = dict(
    num_timesteps=880, num_evals=1, num_eval_envs=4, num_envs=4, batch_size=2, num_minibatches=2
)
STEPS = SMALL["num_timesteps"] // SMALL["num_envs"]


def test_names_and_links_exist():
    names = set(re.findall(r"`(?:agym_jax\.)?errors\.(\w+)`", TEXT))
    assert names == {WrapperError.__name__}
    assert f"{switch.VARIABLE}=-brax_jax" in TEXT and switch.enabled("brax_jax")
    links = re.findall(r"\]\(([^)#]+)", TEXT)
    assert links and all((PAGE.parent / link).is_file() for link in links)
    ids = set(re.findall(r"\b[A-Z]\w+-v\d+\b", TEXT))
    assert ids and ids <= set(agym_jax.list_envs())


def test_the_sizes_fit_together():
    sizes = _sizes()["sizes"]
    assert sizes.keys() == SMALL.keys()
    for numbers in (sizes, SMALL):
        assert numbers["batch_size"] * numbers["num_minibatches"] == numbers["num_envs"]


def _sizes() -> dict[str, Any]:
    names: dict[str, Any] = {}
    exec(compile(SIZES, "sizes", "exec"), names)
    return names


@pytest.mark.slow
@pytest.mark.jit
def test_the_example_trains_with_a_new_human_after_every_200_steps(monkeypatch, capsys):
    envs: list[Any] = []  # of training, then of evaluation
    seen: dict[int, list[tuple]] = {0: [], 1: []}
    step = brax.BraxTrainingEnv.step

    def watched(env: Any, state: Any, action: jax.Array) -> Any:
        after = step(env, state, action)
        if env not in envs:
            envs.append(env)
        human = state.episode.human
        who = jnp.column_stack([human.sex, human.limit_scale, state.episode.human_angles])
        told = who, after.info["steps"], after.info["truncation"], after.done
        jax.debug.callback(lambda *x: seen[envs.index(env)].append(x), *told)
        return after

    monkeypatch.setattr(brax.BraxTrainingEnv, "step", watched)
    names = _sizes() | {"sizes": SMALL}
    exec(compile(TRAINING, "training", "exec"), names)
    jax.effects_barrier()

    episodes: dict[bytes, list[tuple[float, ...]]] = {}
    for who, *told in seen[0]:
        for row, *values in zip(who, *told, strict=True):
            episodes.setdefault(np.asarray(row).tobytes(), []).append(tuple(map(float, values)))
    whole = [(float(i), float(i == 200), float(i == 200)) for i in range(1, 201)]
    lengths = sorted(len(rows) for rows in episodes.values())
    assert STEPS == 220 and lengths == [20] * 4 + [200] * 4
    assert all(sorted(rows) == whole[: len(rows)] for rows in episodes.values())

    metrics = names["metrics"]
    assert metrics["eval/avg_episode_length"] == 200
    assert all(np.isfinite(value) for value in metrics.values())
    assert metrics["training/policy_loss"] != 0
    assert f"{SMALL['num_timesteps']:,} steps  success" in capsys.readouterr().out
    action, _ = names["policy"](jnp.zeros((1, names["env"].observation_size)), jax.random.key(0))
    assert action.shape == (1, names["env"].action_size) and np.isfinite(action).all()
