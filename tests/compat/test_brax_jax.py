# ruff: noqa: D103
"""What JAX removed and Brax calls is given back by the adapter alone, can be switched off, and is still needed."""

from __future__ import annotations

import inspect
import json
import os
import subprocess
import sys

import jax
import numpy as np
import pytest
from brax.training import pmap
from brax.training.agents.ppo import train as ppo
from brax.training.agents.sac import train as sac
from paths import PROCESS_SECONDS
from xla_flags import with_devices

from agym_jax.compat import brax_jax

CHILD = """
import json, jax, agym_jax
before = hasattr(jax, "device_put_replicated")
from agym_jax.adapters.brax import wrap_for_brax_training
imported = hasattr(jax, "device_put_replicated")
from agym_jax.compat import brax_jax
applied = brax_jax.apply()
tree = brax_jax.device_put_replicated({"x": 3.0, "n": jax.numpy.arange(6).reshape(2, 3)}, jax.devices())
doubled = jax.pmap(lambda t: {k: 2 * v for k, v in t.items()})(tree)
print(json.dumps({
    "before": before, "imported": imported, "applied": applied, "after": hasattr(jax, "device_put_replicated"),
    "shapes": [list(s.data.shape) for s in tree["n"].addressable_shards],
    "devices": len(tree["n"].sharding.device_set), "n": doubled["n"].tolist(), "x": doubled["x"].tolist(),
}))
"""


def _in_a_fresh_process(**environment: str) -> dict:
    """What ``CHILD`` finds on two devices."""
    two = with_devices(2)
    done = subprocess.run(
        [sys.executable, "-c", CHILD],
        capture_output=True,
        text=True,
        check=True,
        timeout=PROCESS_SECONDS,
        env={**os.environ, **two, **environment},
    )
    return json.loads(done.stdout.splitlines()[-1])


def test_brax_still_calls_what_jax_removed():
    """If this fails, ``agym_jax/compat/brax_jax.py`` and its uses can be deleted."""
    calls = [name for name in (ppo, sac, pmap) if brax_jax.NAME in inspect.getsource(name)]
    assert calls, "Brax does without jax.device_put_replicated now"
    theirs = getattr(jax, brax_jax.NAME, brax_jax.device_put_replicated)
    assert theirs is brax_jax.device_put_replicated, "JAX has device_put_replicated again"


def test_the_repair_is_applied_by_the_adapter_alone_and_works_on_two_devices():
    found = _in_a_fresh_process(AGYM_JAX_COMPAT="")
    assert not found["before"] and not found["imported"]
    assert found["applied"] and found["after"]
    assert found["shapes"] == [[1, 2, 3]] * 2 and found["devices"] == 2
    assert found["n"] == [[[0, 2, 4], [6, 8, 10]]] * 2 and found["x"] == [6.0, 6.0]


def test_it_can_be_switched_off():
    found = _in_a_fresh_process(AGYM_JAX_COMPAT="-brax_jax")
    assert not found["applied"] and not found["after"]


def test_what_jax_has_is_left_alone(monkeypatch: pytest.MonkeyPatch):
    theirs = lambda x, devices: x  # noqa: E731
    monkeypatch.setattr(jax, brax_jax.NAME, theirs, raising=False)
    assert not brax_jax.apply()
    assert getattr(jax, brax_jax.NAME) is theirs


def test_types_are_kept():
    tree = {"half": np.float16(2), "count": np.uint32(7), "flag": True}
    put = brax_jax.device_put_replicated(tree, jax.local_devices()[:1])
    assert {k: (v.shape, v.dtype.name) for k, v in put.items()} == {
        "half": ((1,), "float16"),
        "count": ((1,), "uint32"),
        "flag": ((1,), "bool"),
    }
