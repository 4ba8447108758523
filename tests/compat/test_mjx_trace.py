# ruff: noqa: D103
"""MJX's kinematics are traced once in a program, with the values they have without the repair."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from agym_jax.compat import mjx_trace
from agym_jax.sim.mjx import mjx  # applies the repair

PENDULUM = """
<mujoco><worldbody><body><joint axis="0 1 0"/><geom type="capsule" size="0.02 0.1"/>
<body pos="0 0 0.2"><joint axis="1 0 0"/><geom type="capsule" size="0.02 0.1"/><site name="tip"/></body>
</body></worldbody></mujoco>
"""


def _counted(monkeypatch: pytest.MonkeyPatch, repaired: bool) -> tuple[jax.Array, int]:
    """Pose of the tip after a step and once more kinematics, and how often these were traced."""
    traces = []

    def original(model, data):
        traces.append(None)
        return mjx_trace._original(model, data)

    once = jax.jit(original)
    chosen = once if repaired else original
    monkeypatch.setattr(mjx_trace.smooth, "kinematics", chosen)
    model = mjx.put_model(mujoco.MjModel.from_xml_string(PENDULUM))

    def run(qpos):
        data = mjx.make_data(model).replace(qpos=qpos)
        return chosen(model, mjx.step(model, data)).site_xpos

    return jax.jit(jax.vmap(run))(jnp.linspace(-1.0, 1.0, 6).reshape(3, 2)), len(traces)


def test_kinematics_are_traced_once_and_have_the_same_values(monkeypatch):
    plain, without = _counted(monkeypatch, repaired=False)
    once, count = _counted(monkeypatch, repaired=True)
    assert (without, count) == (2, 1), "MJX may trace once by itself now: mjx_trace.py could go"
    np.testing.assert_array_equal(plain, once)


def test_the_repair_is_applied_and_can_be_switched_off(monkeypatch):
    assert mjx_trace.smooth.kinematics is mjx_trace.kinematics is mjx.kinematics
    monkeypatch.setattr(mjx_trace.smooth, "kinematics", mjx_trace._original)
    monkeypatch.setenv("AGYM_JAX_COMPAT", "-mjx_trace")
    mjx_trace.apply()
    assert mjx_trace.smooth.kinematics is mjx_trace._original
    monkeypatch.delenv("AGYM_JAX_COMPAT")
    mjx_trace.apply()
    assert mjx_trace.smooth.kinematics is mjx_trace.kinematics
