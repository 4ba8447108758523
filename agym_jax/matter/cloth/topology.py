"""From a garment to the tables of the cloth solver: masses, coloured edges, bending pairs, tethers (NumPy).

Edges are coloured so that no two of a colour share a vertex: all edges of a colour are projected at once,
which converges several times faster than averaging over neighbours and conserves momentum exactly.
Tables have one row per colour (or neighbour) and one column per vertex: the solver only gathers. A vertex
without a partner in a row is its own partner.
"""

from __future__ import annotations

import heapq
import math
from dataclasses import dataclass

import jax
import numpy as np

from agym_jax.matter.cloth.garment import Garment, GarmentError, check, check_edges

SHEAR_RATIO = 1.2
"""An edge that is longer than every other side of its triangles by this factor is a diagonal of the weave."""
BENDING_SPRING = 15.0
"""Stiffness [N/m] of the spring between the two tips of a hinge, times their distance squared, over the bending
rigidity: gives a right-angled fold of a triangle lattice the moment of a plate that is bent as much."""
REFERENCE_EDGE = 0.52 / 22
"""Length of edges [m] for which ``BENDING_SPRING`` holds, the gown's. The moment of such a spring grows with the cube
of the fold, and finer cloth folds less per hinge, so its springs are stiffer by the square of the fineness: equal
curvature gives an equal moment at any resolution."""
REFERENCE_SUBSTEPS = 5
"""Substeps for such edges. Finer cloth needs more, by the square of the fineness, to be as stiff."""
UNTETHERED = 1e6
"""Length of the tethers while nothing holds the cloth [m]."""
MAX_SHARE = 1.0
"""Bound on the share of a vertex's bending errors that one substep corrects; above 4/3 they could grow."""


@dataclass(frozen=True, eq=False)
class Pairs:
    """Distance constraints between vertices: at most one per vertex and row.

    Attributes:
        partner: the other vertex, or the vertex itself if it has none, (r, n) int32.
        rest: distance at rest [m], 1 without a partner, (r, n).
        compliance: [m/N], (r, n).
        active: 1, or 0 without a partner, (r, n).
    """

    partner: np.ndarray
    rest: np.ndarray
    compliance: np.ndarray
    active: np.ndarray


@dataclass(frozen=True)
class Fabric:
    """Properties of cloth and of its solver. Hashable; ``build_cloth`` combines it with a garment.

    Attributes:
        stretch: compliance along the threads [m/N]: cotton stretches by a few percent at 100 N/m.
        shear: compliance of a diagonal [m/N].
        bending: rigidity [N m]: cotton of 0.2 kg/m^2 that bends under its own weight at 2.5 cm.
        thickness: distance at which vertices are kept from solids [m].
        give: length of the tethers over the distance along the cloth: how far the whole cloth may stretch.
        friction: coefficient.
        damping: of velocities, air drag [1/s].
        gravity: along world z [m/s^2].
        substeps: per physics step of 10 ms, of one sweep each. None: as many as the length of the edges needs.
        max_speed: bound on the speed of a vertex [m/s].
    """

    stretch: float = 1e-4
    shear: float = 0.02
    bending: float = 3e-5
    thickness: float = 0.008
    give: float = 1.0
    friction: float = 0.25
    damping: float = 1.0
    gravity: float = -9.81
    substeps: int | None = None
    max_speed: float = 6.0


GOWN_FABRIC = Fabric(stretch=0.02, shear=0.02, thickness=0.038, give=1.4, friction=0.125)
"""AG's gown. It is kept 38 mm off all solids (a gown on a box in AG; collision margin 40 mm), so that the cuff has to stretch
by a third on the forearm. Friction is kDF 0.25 times a limb's 0.5. Stretch and give are such that the hand's paths of
benchmarks/parity/gown.py bring the cuff as far as in AG."""


@dataclass(frozen=True, eq=False)
class ClothSpec:
    """A garment with the tables of the solver; a constant of compiled programs.

    Attributes:
        fabric: properties of the cloth.
        substeps: per physics step of 10 ms.
        garment: n vertices, at rest in their initial positions.
        mass: of the vertices [kg], (n,).
        held: index among the anchors, -1 for a free vertex, (n,).
        edges: distance constraints of the edges, one row per colour, (c, n).
        hinges: bending springs between the opposite tips of an edge's two triangles, one row per neighbour, (b, n).
        tether: index of the nearest anchor along the cloth, (n,).
        reach: greatest distance to it [m], (n,).
    """

    fabric: Fabric
    substeps: int
    garment: Garment
    mass: np.ndarray
    held: np.ndarray
    edges: Pairs
    hinges: Pairs
    tether: np.ndarray
    reach: np.ndarray

    @property
    def count(self) -> int:
        """n, vertices."""
        return len(self.mass)


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class PairTable:
    """Tables of distance constraints: while the cloth is held [0] and while it is not [1]."""

    partner: np.ndarray  # the other vertex                                 (2, r, n) int32
    rest: np.ndarray  # distance at rest [m]                                (2, r, n)
    share: np.ndarray  # of the pair's error that a vertex corrects         (2, r, n)


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class Tables:
    """Tables of a substep: while the cloth is held [0] and while it is not [1]."""

    hinges: PairTable
    edges: PairTable
    free: np.ndarray  # 1 for vertices that are not held, else 0            (2, 1, n)
    tether: np.ndarray  # the vertex's own anchor, or else the nearest      (2, 1, n) int32
    reach: np.ndarray  # greatest distance from it [m]                      (2, 1, n)


def tables(spec: ClothSpec, h: float) -> Tables:
    """Tables for substeps of h [s]."""
    anchored = spec.held >= 0
    cases = anchored, np.zeros_like(anchored)
    hinge, edge = zip(*(_all_shares(spec, held, h) for held in cases), strict=True)
    both = lambda x: np.stack([x, x])  # noqa: E731

    def sweep(pairs: Pairs, shares: tuple[np.ndarray, ...]) -> PairTable:
        rest, share = (x.astype(np.float32) for x in (both(pairs.rest), np.stack(shares)))
        return PairTable(partner=both(pairs.partner.astype(np.int32)), rest=rest, share=share)

    return Tables(
        hinges=sweep(spec.hinges, hinge),
        edges=sweep(spec.edges, edge),
        free=np.stack([~held[None] for held in cases]).astype(np.float32),
        tether=both(np.where(anchored, spec.held, spec.tether).astype(np.int32)[None]),
        reach=np.stack([spec.reach[None], np.full((1, spec.count), UNTETHERED)]).astype(np.float32),
    )


def _all_shares(spec: ClothSpec, held: np.ndarray, h: float) -> tuple[np.ndarray, np.ndarray]:
    """Shares of hinges and of edges, (r, n) each, while some vertices (n,) are held."""
    inverse = np.where(held, 0.0, 1.0 / spec.mass)
    hinge, edge = (_shares(p, inverse, h) for p in (spec.hinges, spec.edges))
    excess = np.maximum(hinge.sum(0), 1e-9) / MAX_SHARE
    # the same for both vertices of a pair, which conserves momentum
    excess = np.maximum(excess, excess[spec.hinges.partner])
    return hinge / np.maximum(excess, 1.0), edge


def _shares(pairs: Pairs, inverse: np.ndarray, h: float) -> np.ndarray:
    """Share of a pair's error that its first vertex corrects in a substep (r, n)."""
    both = inverse + inverse[pairs.partner] + pairs.compliance / h**2
    return pairs.active * inverse / np.maximum(both, 1e-12)


def build_cloth(garment: Garment, fabric: Fabric = Fabric(), thinnest: float = 0.027) -> ClothSpec:
    """Check a garment and build the tables of the solver.

    Args:
        garment: a triangle mesh.
        fabric: properties of its cloth.
        thinnest: radius of the thinnest limb [m]; by default the forearm of AG's woman.

    Raises:
        GarmentError: the garment, or its fabric, cannot be simulated.
    """
    check(garment)
    _check_fabric(fabric)
    check_edges(garment, thinnest, fabric.thickness)
    n = len(garment.vertices)
    corner = np.repeat(garment.areas * garment.area_density / 3, 3)
    mass = np.bincount(garment.triangles.ravel(), corner, n)
    held = np.full(n, -1)
    held[garment.anchors] = np.arange(len(garment.anchors))
    edges, hinges = garment.edges(), _hinges(garment.triangles)
    shears, lengths = _shears(garment, edges), _lengths(garment, edges)
    apart = _lengths(garment, hinges)
    fineness = REFERENCE_EDGE / float(np.median(lengths[~shears]))
    spring = BENDING_SPRING * fineness**2 * max(fabric.bending, 1e-12)
    tether, reach = _tethers(garment, np.concatenate([edges, hinges]))
    return ClothSpec(
        fabric=fabric,
        substeps=fabric.substeps or max(1, math.ceil(REFERENCE_SUBSTEPS * fineness**2 - 1e-6)),
        garment=garment,
        mass=mass,
        held=held,
        edges=_rows(
            n, edges, lengths, np.where(shears, fabric.shear, fabric.stretch), _colours(edges)
        ),
        hinges=_rows(n, hinges, apart, apart**2 / spring, None),
        tether=tether,
        reach=fabric.give * reach,
    )  # fmt: skip


def _check_fabric(fabric: Fabric) -> None:
    positive = ("thickness", "give", "substeps", "max_speed")
    for name, value in vars(fabric).items():
        if name == "gravity" or value is None:
            continue
        if not np.isfinite(value) or value < 0 or (name in positive and not value > 0):
            bound = "> 0" if name in positive else ">= 0"
            raise GarmentError(f"Fabric needs {name} {bound}, got {value}.")


def _lengths(garment: Garment, pairs: np.ndarray) -> np.ndarray:
    """Distances of pairs of vertices at rest [m] (p,)."""
    v = garment.vertices
    return np.linalg.norm(v[pairs[:, 0]] - v[pairs[:, 1]], axis=1)


def _hinges(triangles: np.ndarray) -> np.ndarray:
    """The two vertices opposite to every edge that has two triangles (h, 2)."""
    tips: dict[tuple[int, int], list[int]] = {}
    for a, b, c in triangles.tolist():
        for u, v, tip in ((a, b, c), (b, c, a), (c, a, b)):
            tips.setdefault((min(u, v), max(u, v)), []).append(tip)
    return np.array([sorted(t) for t in tips.values() if len(t) == 2]).reshape(-1, 2)


def _shears(garment: Garment, edges: np.ndarray) -> np.ndarray:
    """Which edges are diagonals of the weave: the longest of their triangles by far (e,) bool."""
    key = {tuple(e): i for i, e in enumerate(edges.tolist())}
    length = _lengths(garment, edges)
    shears = np.ones(len(edges), bool)
    for a, b, c in garment.triangles.tolist():
        sides = [key[min(u, v), max(u, v)] for u, v in ((a, b), (b, c), (c, a))]
        for i, side in enumerate(sides):
            others = max(length[sides[i - 1]], length[sides[i - 2]])
            shears[side] &= length[side] > SHEAR_RATIO * others
    return shears


def _colours(edges: np.ndarray) -> np.ndarray:
    """Colours of edges (e,): no two edges of a colour share a vertex.

    As many colours as the greatest degree of a vertex, or few more. Where no colour is free at both ends of an edge,
    two colours are swapped along a chain of edges (Kempe chain).
    """
    at: list[dict[int, int]] = [{} for _ in range(int(edges.max()) + 1)]  # vertex: colour -> edge
    most = int(np.bincount(edges.ravel()).max())
    colour = np.full(len(edges), -1)

    def paint(edge: int, c: int) -> None:
        colour[edge] = c
        for v in edges[edge]:
            at[v][c] = edge

    def free(vertex: int, count: int) -> list[int]:
        return [c for c in range(count) if c not in at[vertex]]

    def chain(vertex: int, c: int, other: int) -> tuple[list[int], int]:
        """Edges of alternating colours from a vertex, and where they end."""
        path: list[int] = []
        while c in at[vertex]:
            path.append(at[vertex][c])
            a, b = edges[path[-1]].tolist()
            vertex, c, other = (b if vertex == a else a), other, c
        return path, vertex

    def make_room(a: int, b: int) -> int | None:
        for mine in free(a, most):
            for its in free(b, most):
                path, end = chain(b, mine, its)
                if end == a:
                    continue
                for edge in path:
                    for v in edges[edge]:
                        at[v].pop(colour[edge], None)
                for edge in path:
                    paint(edge, mine + its - colour[edge])
                return mine
        return None

    for i, (a, b) in enumerate(edges.tolist()):
        both = [c for c in free(a, most) if c not in at[b]]
        c = both[0] if both else make_room(a, b)
        if c is None:
            c = next(c for c in range(most, 2 * most) if c not in at[a] and c not in at[b])
        paint(i, c)
    return colour


def _rows(
    n: int, pairs: np.ndarray, rest: np.ndarray, compliance: np.ndarray, colour: np.ndarray | None
) -> Pairs:
    """Tables of pairs: one row per colour; without colours, each vertex's pairs fill the first free rows."""
    if colour is None:
        places, filled = [], np.zeros(n, int)
        for a, b in pairs.tolist():
            places.append((filled[a], filled[b]))
            filled[a] += 1
            filled[b] += 1
        place = np.array(places, int).reshape(-1, 2)
    else:
        place = np.stack([colour, colour], -1)
    rows = int(place.max(initial=0)) + 1
    table = Pairs(
        partner=np.tile(np.arange(n, dtype=np.int32), (rows, 1)),
        rest=np.ones((rows, n)),
        compliance=np.zeros((rows, n)),
        active=np.zeros((rows, n)),
    )
    for own, other in ((0, 1), (1, 0)):
        at = place[:, own], pairs[:, own]
        table.partner[at] = pairs[:, other]
        table.rest[at], table.compliance[at], table.active[at] = rest, compliance, 1.0
    return table


def _tethers(garment: Garment, links: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Nearest anchor along the cloth, as an index among the anchors, and the distance to it [m], each (n,).

    The path follows edges and hinges, so it is at most a few percent longer than the shortest one.
    """
    n = len(garment.vertices)
    near: list[list[tuple[int, float]]] = [[] for _ in range(n)]
    for (a, b), d in zip(links.tolist(), _lengths(garment, links).tolist(), strict=True):
        near[a].append((b, d))
        near[b].append((a, d))
    reach, tether = np.full(n, np.inf), np.zeros(n, int)
    queue = [(0.0, v, slot) for slot, v in enumerate(garment.anchors.tolist())]
    while queue:
        d, vertex, slot = heapq.heappop(queue)
        if d >= reach[vertex]:
            continue
        reach[vertex], tether[vertex] = d, slot
        for other, step in near[vertex]:
            if d + step < reach[other]:
                heapq.heappush(queue, (d + step, other, slot))
    return tether, reach
