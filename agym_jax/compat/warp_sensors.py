"""One patch to MuJoCo Warp: contact sensors of pairs of geoms, read without lists and without sorting.

A contact sensor of MuJoCo Warp compares every contact with every sensor, lists the contacts that match (64 for each sensor
of each environment), and sorts the lists, with a block of threads for each. Of the time in which a GPU was busy with training
(8 x 1,024 environments, H100, ``benchmarks.training_profile``), this took 11 % in DressingJaco, whose scene has 76 sensors, and 35 % in DrinkingJaco, which
has 163. A sensor of two geoms that reports the deepest contact needs neither: each contact looks for its sensor and leaves its depth
there. Contacts are the same, and so is what is read. ``tests/compat/test_warp_sensors.py`` compares.

Models whose contact sensors are others are read as before. Import this module only where Warp is used.
"""

import functools
from typing import Any

import mujoco
import numpy as np
import warp as wp

from agym_jax.compat.switch import applies

DEEPEST = 1
"""``contact_sensor_maxmatch`` of models that are read so: of all contacts that match, one is considered, the deepest."""
FIELDS = 1 << int(mujoco.mjtConDataField.mjCONDATA_FORCE) | 1 << int(
    mujoco.mjtConDataField.mjCONDATA_POS
)
"""What a sensor reports: force in the contact's frame (3) and position (3)."""
CONSTRAINT = 1
"""Bit of contacts that the solver knows: MuJoCo Warp 3.17, types.ContactType."""
NONE = (1 << 62) - 1
"""Of sensors that no contact matches."""


def options(model: mujoco.MjModel) -> dict[str, int]:
    """MuJoCo Warp's options with which the contact sensors of a model are read without sorting.

    Args:
        model: any.

    Returns:
        Names and values; none where the repair is switched off, or where a contact sensor is another than that of
        the deepest contact of two geoms, its force and its position.
    """
    contact = model.sensor_type == mujoco.mjtSensor.mjSENS_CONTACT
    of_geoms = np.all(
        [
            x[contact] == mujoco.mjtObj.mjOBJ_GEOM
            for x in (model.sensor_objtype, model.sensor_reftype)
        ]
    )
    deepest = np.all(model.sensor_intprm[contact][:, :3] == (FIELDS, 1, 1))
    return {"contact_sensor_maxmatch": DEEPEST} if of_geoms and deepest and _patch() else {}


@functools.cache
def _patch() -> bool:
    """Patch MuJoCo Warp, once, where it is needed and not switched off; whether it is patched."""
    if not applies("warp_sensors", "mujoco", "3.17", "3.18"):
        return False
    from mujoco.mjx.third_party.mujoco_warp._src import sensor

    read_any = sensor._eval_sensor_contact

    def read(model: Any, data: Any, sensors: Any) -> None:
        chosen = read_deepest if model.opt.contact_sensor_maxmatch == DEEPEST else read_any
        chosen(model, data, sensors)

    sensor._eval_sensor_contact = read
    return True


def read_deepest(model: Any, data: Any, sensors: Any) -> None:
    """Write contact sensors of pairs of geoms into ``data.sensordata``.

    Args:
        model: MuJoCo Warp's.
        data: MuJoCo Warp's, after the solver.
        sensors: indices of contact sensors (n,).
    """
    from mujoco.mjx.third_party.mujoco_warp._src import support

    if not sensors.size:
        return
    deepest = wp.full((data.nworld, sensors.size), NONE, dtype=wp.int64)
    contact = data.contact
    wp.launch(
        _find_deepest,
        dim=data.naconmax,
        inputs=[
            model.sensor_objid, model.sensor_refid, sensors, data.nacon, contact.dist, contact.geom, contact.type,
            contact.worldid,
        ],
        outputs=[deepest],
    )  # fmt: skip
    wp.launch(
        _read_kernel(support.contact_force_fn),
        dim=(data.nworld, sensors.size),
        inputs=[
            model.opt.cone, model.sensor_adr, sensors, data.nacon, contact.frame, contact.friction, contact.dim,
            contact.efc_address, contact.adhesion, contact.pos, contact.geom, model.sensor_objid, data.efc.force, data.njmax,
            deepest,
        ],
        outputs=[data.sensordata],
    )  # fmt: skip


@wp.func
def _key(dist: float, contact: int) -> wp.int64:
    """Distance and number of a contact as one integer, which orders contacts by distance."""
    bits = wp.cast(dist, wp.int32)
    if bits < 0:
        bits = bits ^ wp.int32(0x7FFFFFFF)
    return wp.int64(bits) * wp.int64(4294967296) + wp.int64(contact)


@wp.kernel(module="unique", enable_backward=False)
def _find_deepest(
    sensor_objid: wp.array[int],
    sensor_refid: wp.array[int],
    sensors: wp.array[int],
    num_contacts: wp.array[int],
    contact_dist: wp.array[float],
    contact_geom: wp.array[wp.vec2i],
    contact_type: wp.array[int],
    contact_world: wp.array[int],
    deepest: wp.array2d[wp.int64],
):
    contact = wp.tid()
    if contact >= num_contacts[0] or not (contact_type[contact] & wp.static(CONSTRAINT)):
        return
    geom = contact_geom[contact]
    for i in range(sensors.shape[0]):
        a = sensor_objid[sensors[i]]
        b = sensor_refid[sensors[i]]
        if (geom[0] == a and geom[1] == b) or (geom[0] == b and geom[1] == a):
            wp.atomic_min(deepest, contact_world[contact], i, _key(contact_dist[contact], contact))


@functools.cache
def _read_kernel(contact_force: Any) -> Any:
    """The kernel that writes force and position of each sensor's contact."""

    @wp.kernel(module="unique", enable_backward=False)
    def read_sensors(
        cone: int,
        sensor_adr: wp.array[int],
        sensors: wp.array[int],
        num_contacts: wp.array[int],
        contact_frame: wp.array[wp.mat33],
        contact_friction: wp.array[wp.types.vector(5, float)],
        contact_dim: wp.array[int],
        contact_row: wp.array2d[int],
        contact_adhesion: wp.array[float],
        contact_pos: wp.array[wp.vec3],
        contact_geom: wp.array[wp.vec2i],
        sensor_objid: wp.array[int],
        row_force: wp.array2d[float],
        rows: int,
        deepest: wp.array2d[wp.int64],
        sensordata: wp.array2d[float],
    ):
        world, i = wp.tid()
        at = sensor_adr[sensors[i]]
        key = deepest[world, i]
        if key == wp.static(wp.int64(NONE)):
            for j in range(6):
                sensordata[world, at + j] = 0.0
            return
        contact = int(key & wp.int64(0xFFFFFFFF))
        force = contact_force(
            cone, contact_frame, contact_friction, contact_dim, contact_row, contact_adhesion, row_force, rows,
            num_contacts, world, contact, False,
        )  # fmt: skip
        turned = 1.0
        if contact_geom[contact][0] != sensor_objid[sensors[i]]:
            turned = -1.0
        sensordata[world, at] = force[0]
        sensordata[world, at + 1] = force[1]
        sensordata[world, at + 2] = turned * force[2]
        for j in range(3):
            sensordata[world, at + 3 + j] = contact_pos[contact][j]

    return read_sensors
