"""What people sit or lie on. Geometry: reference furniture.md; drawn in our own MJCF."""

from agym_jax.spec import SeatSpec

WHEELCHAIR = SeatSpec(
    name="wheelchair",
    model="furniture/wheelchair.xml",
    geoms=("armrest_right_inner_collision", "armrest_right_outer_collision"),
)

BED = SeatSpec(
    name="bed",
    model="furniture/bed.xml",
    geoms=("mattress_collision", "skirt_collision"),
)
