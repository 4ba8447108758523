# ruff: noqa: D103 (a test's name says what it shows)
"""Contact sensors on MuJoCo Warp read as it reads them itself, on the CPU."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

import agym_jax
from agym_jax.compat.switch import VARIABLE

warp = pytest.importorskip("warp", reason='needs pip install "agym_jax[warp]"')
pytestmark = pytest.mark.warp
TOUCHING = """
<mujoco>
  <option cone="pyramidal"/>
  <worldbody>
    <geom name="floor" type="plane" size="1 1 1"/>
    <body name="box" pos="0 0 0.098"><freejoint/><geom name="box" type="box" size="0.1 0.1 0.1" mass="1"/></body>
    <body name="ball" pos="0.3 0 0.249"><freejoint/><geom name="ball" size="0.25" mass="1"/></body>
  </worldbody>
  <contact>
    <pair geom1="floor" geom2="box"/>
    <pair geom1="floor" geom2="ball"/>
    <pair geom1="ball" geom2="box"/>
  </contact>
  <sensor>
    <contact geom1="box" geom2="floor" reduce="mindist" num="1" data="force pos"/>
    <contact geom1="floor" geom2="ball" reduce="mindist" num="1" data="force pos"/>
    <contact geom1="ball" geom2="box" reduce="mindist" num="1" data="force pos"/>
  </sensor>
</mujoco>
"""


def readings(model: mujoco.MjModel, qpos: np.ndarray) -> tuple[np.ndarray, np.ndarray, int]:
    """Sensors of several environments as MuJoCo Warp reads them and as we do (n, nsensordata), and contacts."""
    from mujoco.mjx.third_party import mujoco_warp
    from mujoco.mjx.third_party.mujoco_warp._src import sensor

    from agym_jax.compat import warp_sensors

    with warp.ScopedDevice("cpu"):
        put = mujoco_warp.put_model(model)
        data = mujoco_warp.make_data(model, len(qpos), naconmax=100 * len(qpos), njmax=400)
        data.qpos.assign(qpos.astype(np.float32))
        mujoco_warp.forward(put, data)
        theirs = data.sensordata.numpy()
        for name, value in warp_sensors.options(model).items():
            assert getattr(put.opt, name) != value
            setattr(put.opt, name, value)
        data.sensordata.fill_(np.nan)
        sensor._eval_sensor_contact(put, data, put.sensor_contact_acc_adr)
        assert not data.overflow.numpy().any()
        return theirs.copy(), data.sensordata.numpy(), int(data.nacon.numpy()[0])


def test_sensors_of_geoms_report_what_they_do_without_the_patch():
    model = mujoco.MjModel.from_xml_string(TOUCHING)
    turned = np.array([np.cos(0.1), 0.0, np.sin(0.1), 0.0])  # stands on an edge
    qpos = np.stack([model.qpos0] * 3)
    qpos[1, 3:7], qpos[2, [2, 9]] = turned, (5.0, 9.0)  # the last: nothing touches
    theirs, ours, contacts = readings(model, qpos)
    assert contacts > 6  # four of them where the box stands on its face: one is reported
    assert (theirs[0].reshape(3, 6)[:, 0] > 0).all() and not ours[2].any()
    # of four contacts that are equally deep, which one is reported does not matter
    assert ours[0, 0] == pytest.approx(theirs[0, 0], rel=1e-4) and ours[0, 5] == theirs[0, 5]
    np.testing.assert_array_equal(ours[0, 6:], theirs[0, 6:])
    assert ours[1, 0] == pytest.approx(theirs[1, 0], rel=1e-4)
    # and what C MuJoCo reports of the ball
    c = mujoco.MjData(model)
    mujoco.mj_forward(model, c)
    np.testing.assert_allclose(ours[0, 6:12], c.sensordata[6:12], rtol=1e-2, atol=1e-4)


@pytest.mark.slow
def test_sensors_of_a_scene_report_what_they_do_without_the_patch():
    model = agym_jax.make("ArmManipulationJaco-v0", impl="native").scene.model
    spread = np.random.default_rng(0).normal(scale=0.6, size=(30, model.nq))
    theirs, ours, contacts = readings(model, model.qpos0 + spread)
    assert contacts > 300 and np.count_nonzero(theirs) > 300
    np.testing.assert_array_equal(ours, theirs)


@pytest.mark.parametrize(
    "other",
    [
        ('reduce="mindist"', 'reduce="maxforce"'),
        ('num="1"', 'num="2"'),
        ('data="force pos"', 'data="force"'),
        ('geom1="box"', 'body1="box"'),
    ],
)
def test_a_model_with_other_contact_sensors_is_read_as_before(other):
    from agym_jax.compat import warp_sensors

    assert warp_sensors.options(mujoco.MjModel.from_xml_string(TOUCHING))
    xml = TOUCHING.replace("<contact " + other[0], "<contact " + other[1])
    xml = xml if xml != TOUCHING else TOUCHING.replace(*other)
    assert warp_sensors.options(mujoco.MjModel.from_xml_string(xml)) == {}


def test_the_patch_can_be_switched_off(monkeypatch):
    from agym_jax.compat import warp_sensors

    monkeypatch.setenv(VARIABLE, "-warp_sensors")
    warp_sensors._patch.cache_clear()
    model = mujoco.MjModel.from_xml_string(TOUCHING)
    assert warp_sensors.options(model) == {}
    monkeypatch.delenv(VARIABLE)
    warp_sensors._patch.cache_clear()
    assert warp_sensors.options(model) == {"contact_sensor_maxmatch": 1}
