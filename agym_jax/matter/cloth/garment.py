"""Garments: triangle meshes with two named parts, the loop of the cuff and the vertices that the gripper holds.

The frame of a garment has its origin where it is held (the mean of the anchors), y in the direction in which
it is pulled onto the arm, z up. ``load`` reads a file that ``agym_jax.offline.gown`` wrote, or a garment of your
own: a TOML description beside an OBJ file, of which the TOML file is loaded::

    mesh = "shirt.obj"          # in the same folder; faces with more than 3 corners are fanned
    scale = 0.01                # to metres; 1 if left out
    area_density = 0.209        # kg/m^2; AG's gown if left out
    cuff = [12]                 # one vertex of a boundary loop, or all of them in order; counted from 0
    anchors = [40, 41, 52]      # vertices that the gripper holds

Garments that could not be simulated are refused, with the edge, triangle or loop that is wrong.
"""

from __future__ import annotations

import tomllib
from collections import Counter, defaultdict
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

import numpy as np

from agym_jax.data.assets import asset_path
from agym_jax.data.npz import Shape, read_arrays, write_arrays
from agym_jax.errors import AgymError, did_you_mean

AG_AREA_DENSITY = 0.23 / 1.099
"""AG dressing.py reset: 0.23 kg on 1.099 m^2 [kg/m^2]."""
GOWN = "garments/gown.npz"
"""The hospital gown that is part of the package."""
MIN_CUFF = 6
"""Least vertices of a cuff: the sleeve test watches two triangles."""
PARTS = {"mesh", "scale", "area_density", "cuff", "anchors"}
"""Keys of a description."""


class GarmentError(AgymError, ValueError):
    """A garment that cannot be simulated."""


@dataclass(frozen=True, eq=False)
class Garment:
    """A triangle mesh in its undeformed shape, in its own frame.

    Attributes:
        name: for messages.
        vertices: [m], (n, 3).
        triangles: vertices of each, (t, 3).
        cuff: vertices of the loop that the sleeve test watches, in order, (c,).
        anchors: vertices that the gripper holds, (a,).
        area_density: [kg/m^2].
        hanging: vertices at rest when it hangs from its anchors [m] (n, 3), see ``hang.settle``; None if not
            computed.
    """

    name: str
    vertices: np.ndarray
    triangles: np.ndarray
    cuff: np.ndarray
    anchors: np.ndarray
    area_density: float = AG_AREA_DENSITY
    hanging: np.ndarray | None = None

    @property
    def areas(self) -> np.ndarray:
        """Areas of the triangles [m^2] (t,)."""
        a, b, c = (self.vertices[self.triangles[:, i]] for i in range(3))
        return 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=-1)

    @property
    def mass(self) -> float:
        """Mass of the garment [kg]."""
        return float(self.areas.sum() * self.area_density)

    @property
    def cuff_perimeter(self) -> float:
        """Length of the cuff's loop [m]."""
        loop = self.vertices[self.cuff]
        return float(np.linalg.norm(loop - np.roll(loop, -1, 0), axis=-1).sum())

    def edges(self) -> np.ndarray:
        """Vertices of each edge, the smaller one first (e, 2)."""
        return np.unique(np.sort(_sides(self.triangles), axis=1), axis=0)


def load(name: str = GOWN) -> Garment:
    """Read and check a garment.

    Args:
        name: an asset or an absolute path: .npz, or .toml beside an OBJ file.

    Raises:
        GarmentError: the file is not a garment; the message names the edge, triangle or loop that is wrong.
        MissingAssetError: no such file.
    """
    path = asset_path(name)
    readers = {".npz": _read_npz, ".toml": _read_description}
    if path.suffix not in readers:
        raise GarmentError(
            f"{path.name} is not a garment. {did_you_mean(path.suffix, readers)} An OBJ file needs a description: "
            "a .toml file beside it with mesh, cuff and anchors (agym_jax.matter.cloth.garment)."
        )
    garment = readers[path.suffix](path)
    check(garment)
    held = garment.anchors
    centred = replace(garment, vertices=garment.vertices - garment.vertices[held].mean(0))
    if garment.hanging is None:
        return centred
    return replace(centred, hanging=garment.hanging - garment.hanging[held].mean(0))


def save(garment: Garment, path: Path) -> None:
    """Write a checked garment as .npz."""
    check(garment)
    write_arrays(path, {k: v for k, v in vars(garment).items() if k != "name" and v is not None})


def _read_npz(path: Path) -> Garment:
    needed: dict[str, Shape] = {
        "vertices": ("vertices", 3), "triangles": ("triangles", 3), "cuff": ("vertices of the cuff",),
        "anchors": ("vertices held",), "area_density": (),
    }  # fmt: skip
    remedy = "agym_jax.matter.cloth.garment says what a garment needs."
    arrays = read_arrays(path, "garment", needed, GarmentError, remedy)
    density = float(arrays.pop("area_density"))
    known = {name: arrays[name] for name in (*needed, "hanging") if name in arrays}
    return Garment(name=path.name, area_density=density, **known)


def _read_description(path: Path) -> Garment:
    with path.open("rb") as file:
        try:
            said = tomllib.load(file)
        except tomllib.TOMLDecodeError as error:
            raise GarmentError(f"{path.name} is not TOML: {error}.") from error
        except UnicodeDecodeError as error:
            raise GarmentError(f"{path.name} is not TOML: it is not UTF-8.") from error
    for key in said:
        if key not in PARTS:
            raise GarmentError(f"{path.name} names {key!r}. {did_you_mean(key, PARTS)}")
    for key in ("mesh", "cuff", "anchors"):
        if key not in said:
            raise GarmentError(
                f"{path.name} does not specify {key}; a garment needs mesh, cuff and anchors."
            )
    for key in [x for x in ("scale", "area_density") if x in said]:
        if isinstance(said[key], bool) or not isinstance(said[key], int | float):
            raise GarmentError(f"{path.name}: {key} must be a number, got {said[key]!r}.")
    if not isinstance(said["mesh"], str):
        raise GarmentError(f"{path.name}: mesh must be the name of a file, got {said['mesh']!r}.")
    vertices, triangles = _read_obj(asset_path(str((path.parent / said["mesh"]).absolute())))
    cuff = _indices(path.name, "cuff", said["cuff"], len(vertices))
    if len(cuff) == 1:
        cuff = boundary_loop(path.name, triangles, int(cuff[0]))
    return Garment(
        name=path.name,
        vertices=vertices * float(said.get("scale", 1.0)),
        triangles=triangles,
        cuff=cuff,
        anchors=_indices(path.name, "anchors", said["anchors"], len(vertices)),
        area_density=float(said.get("area_density", AG_AREA_DENSITY)),
    )


def _read_obj(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Vertices (n, 3) and triangles (t, 3), counted from 0."""
    vertices, triangles = [], []
    text = path.read_text(errors="replace")  # comments may have any encoding
    for number, line in enumerate(text.splitlines(), 1):
        kind, *words = line.split() or [""]
        if kind not in ("v", "f"):
            continue
        try:
            if kind == "v":
                vertices.append([float(word) for word in words[:3]])
                continue
            corners = [int(word.split("/")[0]) for word in words]
        except ValueError as error:
            raise GarmentError(
                f"{path.name}, line {number}: {line!r} cannot be read: {error}."
            ) from error
        corners = [c - 1 if c > 0 else len(vertices) + c for c in corners]
        triangles += [[corners[0], b, c] for b, c in pairwise(corners[1:])]
    if not triangles or any(len(v) != 3 for v in vertices):
        raise GarmentError(f"{path.name} has no triangles, or vertices without three coordinates.")
    return np.array(vertices), np.array(triangles)


def check(garment: Garment) -> None:
    """Check that a mesh is one piece of cloth with a cuff and anchors.

    Raises:
        GarmentError: the message says what is wrong, and where.
    """
    name, n = garment.name, len(garment.vertices)
    if garment.vertices.shape != (n, 3) or not np.isfinite(garment.vertices).all():
        raise GarmentError(f"{name}: the vertices must be finite and of shape (n, 3).")
    if not garment.area_density > 0:
        raise GarmentError(f"{name}: area_density must be > 0 kg/m^2, got {garment.area_density}.")
    triangles = _indices(name, "triangles", garment.triangles, n)
    if triangles.ndim != 2 or triangles.shape[1] != 3:
        raise GarmentError(f"{name}: triangles must have shape (t, 3), got {triangles.shape}.")
    flat = np.flatnonzero(garment.areas < 1e-9)
    if len(flat):
        where = triangles[flat[0]].tolist()
        raise GarmentError(
            f"{name}: triangle {flat[0]} of vertices {where} has no area. Remove it."
        )
    if garment.hanging is not None and (
        garment.hanging.shape != (n, 3) or not np.isfinite(garment.hanging).all()
    ):
        raise GarmentError(
            f"{name}: hanging must be finite and of the shape of the vertices, ({n}, 3)."
        )
    _check_manifold(garment)
    _check_cuff(garment)
    anchors = _indices(name, "anchors", garment.anchors, n)
    if anchors.ndim != 1 or not len(anchors) or len(set(anchors.tolist())) < len(anchors):
        raise GarmentError(f"{name}: anchors must be a list of different vertices, at least one.")


def check_edges(garment: Garment, thinnest: float, thickness: float) -> None:
    """Refuse edges so long that the tip of a limb could pass between the vertices.

    Only vertices are kept off a limb, by the thickness of the cloth. A sphere of radius r + thickness that
    rests on three vertices of an equilateral triangle sinks below their plane; it must not sink by more than
    the thickness.

    Args:
        garment: a checked garment.
        thinnest: radius of the thinnest limb [m].
        thickness: of the cloth [m].

    Raises:
        GarmentError: with the longest edge and the limit.
    """
    edges = garment.edges()
    lengths = np.linalg.norm(garment.vertices[edges[:, 0]] - garment.vertices[edges[:, 1]], axis=1)
    limit = longest_edge(thinnest, thickness)
    worst = int(lengths.argmax())
    if lengths[worst] > limit:
        a, b = edges[worst].tolist()
        raise GarmentError(
            f"{garment.name}: the edge between vertices {a} and {b} is {1e3 * lengths[worst]:.1f} mm long; a limb of "
            f"radius {1e3 * thinnest:.1f} mm could come through edges longer than {1e3 * limit:.1f} mm. Use a finer "
            "mesh, or thicker cloth."
        )


def longest_edge(thinnest: float, thickness: float) -> float:
    """Longest edge [m] between whose vertices a limb of this radius [m] cannot pass, at a thickness of cloth [m]."""
    return float(np.sqrt(3.0 * ((thinnest + thickness) ** 2 - thinnest**2)))


def _check_manifold(garment: Garment) -> None:
    """Check that every edge has one or two triangles, and that the mesh is one piece without loose vertices."""
    name, n = garment.name, len(garment.vertices)
    count = Counter(map(tuple, np.sort(_sides(garment.triangles), axis=1).tolist()))
    for (a, b), times in count.items():
        if times > 2:
            raise GarmentError(
                f"{name}: the edge between vertices {a} and {b} belongs to {times} triangles. Cloth is a manifold: "
                "an edge has one or two."
            )
    near = defaultdict(list)
    for a, b in count:
        near[a].append(b)
        near[b].append(a)
    seen, front = {0}, [0]
    while front:
        for vertex in near[front.pop()]:
            if vertex not in seen:
                seen.add(vertex)
                front.append(vertex)
    if len(seen) < n:
        loose = min(set(range(n)) - seen)
        raise GarmentError(
            f"{name} is not one piece: vertex {loose} is not connected to the {len(seen)} vertices around "
            "vertex 0. Join the pieces (merge doubled vertices), or remove what is left over."
        )


def _check_cuff(garment: Garment) -> None:
    """Check that the cuff is a closed loop of edges with different vertices."""
    name = garment.name
    cuff = _indices(name, "cuff", garment.cuff, len(garment.vertices)).tolist()
    if len(cuff) < MIN_CUFF or len(set(cuff)) < len(cuff):
        raise GarmentError(
            f"{name}: the cuff must have {MIN_CUFF} different vertices or more, got {cuff}."
        )
    edges = set(map(tuple, garment.edges().tolist()))
    for a, b in zip(cuff, [*cuff[1:], cuff[0]], strict=True):
        if (min(a, b), max(a, b)) not in edges:
            raise GarmentError(
                f"{name}: the cuff is not a closed loop of edges: vertices {a} and {b} follow each other in it, but no "
                "edge joins them. List its vertices in order, or one vertex of a boundary."
            )


def boundary_loop(name: str, triangles: np.ndarray, vertex: int) -> np.ndarray:
    """Vertices of the boundary loop through a vertex, in order.

    Args:
        name: of the garment, for messages.
        triangles: (t, 3).
        vertex: first vertex of the loop.
    """
    sides = np.sort(_sides(triangles), axis=1)
    edges, times = np.unique(sides, axis=0, return_counts=True)
    near = defaultdict(list)
    for a, b in edges[times == 1].tolist():
        near[a].append(b)
        near[b].append(a)
    if len(near[vertex]) != 2:
        raise GarmentError(
            f"{name}: vertex {vertex} lies on {len(near[vertex])} edges of the boundary; a vertex of the cuff lies on 2."
        )
    loop, last = [vertex], vertex
    here = near[vertex][0]
    while here != vertex:
        loop.append(here)
        if len(near[here]) != 2:
            raise GarmentError(
                f"{name}: the boundary of the cuff meets another one at vertex {here}."
            )
        last, here = here, next(v for v in near[here] if v != last)
    return np.array(loop)


def _indices(name: str, what: str, values: object, n: int) -> np.ndarray:
    """Integer array of vertices; refuses vertices that do not exist."""
    array = np.asarray(values)
    if array.size == 0 or not np.issubdtype(array.dtype, np.integer):
        raise GarmentError(f"{name}: {what} must be numbers of vertices, got {values!r}.")
    wrong = array[(array < 0) | (array >= n)]
    if wrong.size:
        raise GarmentError(
            f"{name}: {what} name vertex {wrong.flat[0]}; there are {n}, counted from 0."
        )
    return array


def _sides(triangles: np.ndarray) -> np.ndarray:
    """Sides of triangles (3 t, 2)."""
    return np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]])
