"""What people sit or lie on. Geometry: reference furniture.md; drawn in our own MJCF.

DEVIATION(bed-shape): the mattress is a slab and a capsule for its rounded edge, fitted to rays on AG's triangle mesh: within
5 mm of it for 95 % of the points where arm, wiper and hand go (root mean square 3 mm; the mesh has folds of up to 2 cm).
AG's mesh consists of 58 convex pieces with gaps between them; one of them, 29 mm deep, runs along the mattress's edge, 70 degrees above the
horizontal. Their walls hold a tool that presses on the edge. In ten recorded episodes of ArmManipulation with each robot, 67 (PR2), 82 (Baxter), 34 (Sawyer) and 18 % (Jaco) of the force between
scooper and bed act more than 20 degrees away from the normal of our surface, which has no gaps (pieces, gap and forces were measured by programs outside the repository). PR2's last two policies help in 8 and 12 of 20 episodes in AG, and in 13 and 16 of the same 20 with these shapes in place of
AG's mesh (``python benchmarks/in_assistive_gym.py --smooth-bed``).
Pillows bear head and girdle, but not arms. In BedBathing, the wiper and robots meet the side and the slope of the pillow on the robot's side: two capsules, which with the mattress are 4.5 mm from
AG's surface there (root mean square of 325 points, x -0.55 to -0.30, y 0.20 to 0.44 m; ``benchmarks.parity.bed``); without them, 22 mm, as until 27 November 2026, 07:25 UTC.
"""

from dataclasses import replace

from agym_jax.spec import Pose, Prop, SeatSpec

WHEELCHAIR = SeatSpec(
    name="wheelchair",
    model="furniture/wheelchair.xml",
    geoms=("armrest_right_inner_collision", "armrest_right_outer_collision"),
    front=((0.82, -2.36, 1.86), (-0.35, -0.15, 0.85)),
)

BED = SeatSpec(
    name="bed",
    model="furniture/bed.xml",
    geoms=("mattress_collision", "edge_collision"),
    pillow=("pillow_a_front_collision",),
    stops_arm=True,
    front=((0.75, -1.75, 2.75), (-0.45, 0.0, 0.8)),
)

WHEELCHAIR_UP_CLOSE = replace(WHEELCHAIR, front=((0.72, -1.45, 1.5), (-0.25, -0.25, 1.02)))
"""Seen from nearer: hand, head and what is between them."""

# AG v0.1 world_creation.py, feeding.py reset; the bowl's place is drawn about this one
TABLE = Prop("table", "furniture/table.xml", Pose((0.35, -0.9, 0.0)))
BOWL = Prop("bowl", "furniture/bowl.xml", Pose((-0.15, -0.55, 0.725)))

WHEELCHAIR_AT_TABLE = replace(WHEELCHAIR_UP_CLOSE, props=(TABLE, BOWL))
