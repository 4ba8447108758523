# ruff: noqa: D103
"""What food and water meet of the person is what MuJoCo has."""

from __future__ import annotations

import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from agym_jax.human import anthropometry
from agym_jax.human.body import LINKS, SHAPES, shapes_of
from agym_jax.human.capsules import link_capsules
from agym_jax.robots import ROBOTS
from agym_jax.sim.scene import compose
from agym_jax.tasks import TASKS

NAMES = tuple(x.name for x in LINKS)


@pytest.fixture(scope="module", params=[0.0, 1.0])
def posed(request: pytest.FixtureRequest):
    """A man or a woman who has turned the head, with all links; sizes too."""
    model = compose(TASKS["Reaching"], ROBOTS["Jaco"], sex=request.param, solid=True)
    data = mujoco.MjData(model)
    for joint, angle in (("neck_x", 0.2), ("head_y", -0.3), ("head_z", 0.5)):
        data.qpos[model.joint(f"human/{joint}").qposadr[0]] = angle
    mujoco.mj_forward(model, data)
    return model, data, anthropometry.dims(request.param)


def test_capsules_are_the_models(posed):
    model, data, d = posed
    pos = {x: jnp.asarray(data.body(f"human/{x}").xpos) for x in NAMES}
    rot = {x: jnp.asarray(data.body(f"human/{x}").xmat.reshape(3, 3)) for x in NAMES}
    a, b, radius = link_capsules(d, NAMES, pos, rot)
    assert len(radius) == len(SHAPES) == len(NAMES) + 2
    for i, name in enumerate(shapes_of(NAMES)):
        geom = model.geom(f"human/{name}")
        half = geom.size[1] if geom.type[0] == mujoco.mjtGeom.mjGEOM_CAPSULE else 0.0
        axis = data.geom(f"human/{name}").xmat.reshape(3, 3)[:, 2] * half
        middle = data.geom(f"human/{name}").xpos
        ends = {tuple(np.round(middle + s * axis, 4)) for s in (-1, 1)}
        found = {tuple(np.round(np.asarray(x, float), 4)) for x in (a[i], b[i])}
        np.testing.assert_allclose(sorted(found), sorted(ends), atol=2e-4, err_msg=name)
        np.testing.assert_allclose(radius[i], geom.size[0], rtol=1e-5, err_msg=name)


def test_a_motion_has_a_leading_axis(posed):
    _, data, d = posed
    pos = {x: jnp.asarray(data.body(f"human/{x}").xpos) for x in NAMES}
    rot = {x: jnp.asarray(data.body(f"human/{x}").xmat.reshape(3, 3)) for x in NAMES}
    shift = jnp.arange(4.0)[:, None] * jnp.array([0.0, 0.0, 0.1])
    moving = {k: v + shift for k, v in pos.items()}
    turned = {k: jnp.tile(v, (4, 1, 1)) for k, v in rot.items()}
    a, b, radius = link_capsules(d, ("head", "right_hand"), moving, turned)
    assert a.shape == b.shape == (4, 4, 3) and radius.shape == (4,)  # skull, face, nose and a hand
    still_a, still_b, _ = link_capsules(d, ("head", "right_hand"), pos, rot)
    np.testing.assert_allclose(a, still_a + shift[:, None], atol=1e-6)
    np.testing.assert_allclose(b, still_b + shift[:, None], atol=1e-6)
