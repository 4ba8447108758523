"""What people sit or lie on. Geometry: reference furniture.md; drawn in our own MJCF."""

from agym_jax.spec import SeatSpec

WHEELCHAIR = SeatSpec(
    name="wheelchair",
    model="furniture/wheelchair.xml",
    geoms=("armrest_right_inner_collision", "armrest_right_outer_collision"),
    front=((0.82, -2.36, 1.86), (-0.35, -0.15, 0.85)),
)

BED = SeatSpec(
    name="bed",
    model="furniture/bed.xml",
    geoms=("mattress_collision", "skirt_collision"),
    front=((0.75, -1.75, 2.75), (-0.45, 0.0, 0.8)),
)
