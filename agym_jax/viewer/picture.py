"""The picture in the browser: robots, people and furniture, gown, food and water, forces.

A few instanced meshes hold all geoms of all environments (``shapes``). What does not move is sent once an episode.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import mujoco
import numpy as np
import viser

from agym_jax.math3d import quat_mul
from agym_jax.spec import Surface
from agym_jax.viewer import shapes
from agym_jax.viewer.moments import Marks, Moment

FLOOR, LINES = (236, 236, 234), (205, 206, 208)
LEVEL = (1.0, 0.0, 0.0, 0.0)  # wxyz
PRESSED, OTHER = (222, 45, 38), (244, 160, 40)
"""Colours of forces: on the person, and elsewhere."""
LENGTH_OF_10_N = 0.15  # of an arrow [m]
LONGEST = 0.6  # arrow [m]
LABEL_AT, MIDDLE = np.array([0.0, -1.0, 0.0]), np.array([0.0, 0.0, 0.6])
"""Of an environment [m]: where its label is, and where one looks at."""
OVERVIEW = np.array([-0.28, -1.06, 0.9])
"""From where one looks at several, in their width."""
FEW = 4  # environments that are drawn with shadows and all detail
AMBIENT = 0.35  # light from everywhere, beside viser's lamps
FIELD_OF_VIEW = np.radians(42.0)  # vertical, that of the camera "front"
VIEWS = ("front", "side", "close")
"""Cameras of ``assets/scene.xml``."""


@dataclass
class Place:
    """One environment in the picture.

    Attributes:
        model: with everything that people look at.
        shift: where it stands in the picture [m] (3,).
        label: what is written above it; empty for nothing.
    """

    model: mujoco.MjModel
    shift: np.ndarray
    label: str = ""
    data: mujoco.MjData = field(init=False)

    def __post_init__(self) -> None:
        self.data = mujoco.MjData(self.model)

    def pose(self, qpos: np.ndarray) -> None:
        """Move the joints [rad] (nq,)."""
        self.data.qpos[:] = qpos
        mujoco.mj_kinematics(self.model, self.data)


@dataclass(frozen=True)
class Forces:
    """Forces to draw."""

    points: np.ndarray  # where they act, world [m]                            (n, 3)
    vectors: np.ndarray  # [N]                                                 (n, 3)
    on_person: np.ndarray  # whether on the person                              (n,)


class Picture:
    """Draws environments into the scene of a viser server.

    Args:
        server: of the page.
    """

    def __init__(self, server: viser.ViserServer):
        self.server, self._scene = server, server.scene
        self.places: list[Place] = []
        self._handles: dict[str, Any] = {}
        self._moving: list[tuple[str, list[tuple[Place, shapes.Copies]]]] = []
        self._marks: tuple[Marks, ...] = ()
        self._scene.set_up_direction("+z")
        self._scene.configure_environment_map("studio", environment_intensity=AMBIENT)
        self._scene.add_grid(
            "/floor", infinite_grid=True, cell_size=0.5, section_size=1.0, cell_color=LINES, section_color=LINES,
            cell_thickness=0.6, section_thickness=1.0, plane_color=FLOOR, plane_opacity=1.0, shadow_opacity=0.35,
            fade_distance=30.0,
        )  # fmt: skip

    # -- once an episode --------------------------------------------------------------------------

    def show(
        self,
        places: Sequence[Place],
        moment: Moment,
        marks: Sequence[Marks] = (),
        surfaces: Sequence[Surface] = (),
    ) -> None:
        """Draw environments in which an episode begins.

        Args:
            places: of the environments.
            moment: as it begins.
            marks: kinds of balls in the moment.
            surfaces: sheets in the moment.
        """
        self.places, self._marks = list(places), tuple(marks)
        self._sheets = len(surfaces)
        for place, qpos in zip(self.places, moment.qpos, strict=True):
            place.pose(qpos)
        wanted = {"/floor"}
        with self.server.atomic():
            still = self._copies(moving=False)
            self._moving = self._copies(moving=True)
            for name, parts in (*still, *self._moving):
                self._instances(name, parts)
                wanted.add(name)
            for i, mark in enumerate(self._marks):
                wanted.add(self._balls(i, mark, moment.points[i]))
            for i, surface in enumerate(surfaces):
                for j in range(len(self.places)):
                    wanted.add(self._sheet(i, j, surface, moment.sheets[i][j]))
            for j, place in enumerate(self.places):
                if place.label:
                    wanted.add(self._label(j, place))
            for name in set(self._handles) - wanted - {"/forces"}:
                self._handles.pop(name).remove()
            self.forces(None)

    def _copies(self, moving: bool) -> list[tuple[str, list[tuple[Place, shapes.Copies]]]]:
        """The instanced meshes of what moves or does not: name and copies in each place."""
        found: dict[str, list[tuple[Place, shapes.Copies]]] = {}
        for place in self.places:
            geoms = shapes.drawn_geoms(place.model, moving)
            for key, copies in shapes.copies_of(place.model, geoms).items():
                found.setdefault(key, []).append((place, copies))
        kind = "moving" if moving else "still"
        return [(f"/{kind}/{key}", parts) for key, parts in found.items()]

    def _instances(self, name: str, parts: list[tuple[Place, shapes.Copies]]) -> None:
        """Add or change an instanced mesh."""
        positions, quats = poses(parts)
        joined = lambda what: np.concatenate([getattr(copies, what) for _, copies in parts])  # noqa: E731
        opacities = joined("opacities")
        props = {
            "batched_positions": positions,
            "batched_wxyzs": quats,
            "batched_scales": joined("scales"),
            "batched_colors": linear(joined("colours")),
            "batched_opacities": None if (opacities == 1.0).all() else opacities,
        }
        handle = self._handles.get(name)
        if handle is not None and len(handle.batched_positions) == len(positions):
            assign(handle, props)
            return
        few = len(self.places) <= FEW
        sides = shapes.FINE if few else shapes.COARSE
        mesh = shapes.mesh_of(parts[0][0].model, name.rpartition("/")[2], sides)
        self._handles[name] = self._scene.add_batched_meshes_simple(
            name, mesh.vertices, mesh.faces, lod="off", cast_shadow=few, receive_shadow=few, **props
        )

    def _balls(self, i: int, mark: Marks, points: np.ndarray) -> str:
        name, (positions, scales) = f"/marks/{i}", self._spread(points, mark.radius)
        handle = self._handles.get(name)
        if handle is not None and len(handle.batched_positions) == len(positions):
            assign(handle, {"batched_positions": positions, "batched_scales": scales})
            return name
        mesh = shapes.unit("ball")
        self._handles[name] = self._scene.add_batched_meshes_simple(
            name, mesh.vertices, mesh.faces, np.tile(LEVEL, (len(positions), 1)), positions,
            batched_scales=scales, batched_colors=linear(np.array(colour(mark.rgba))), opacity=mark.rgba[3] if mark.rgba[3] < 1 else None,
            lod="off", cast_shadow=False,
        )  # fmt: skip
        return name

    def _spread(self, points: np.ndarray, radius: float) -> tuple[np.ndarray, np.ndarray]:
        """Positions and scales of balls in all places (m, 3); what is not drawn has no size."""
        shifts = np.stack([place.shift for place in self.places])[:, None]
        at = (points + shifts).reshape(-1, 3).astype(np.float32)
        there = np.isfinite(at).all(axis=1, keepdims=True)
        size = np.where(there, np.float32(radius), 0.0) * np.ones((1, 3), np.float32)
        return np.where(there, at, 0.0).astype(np.float32), size.astype(np.float32)

    def _sheet(self, i: int, j: int, surface: Surface, vertices: np.ndarray) -> str:
        name = f"/sheets/{i}/{j}"
        at = (vertices + self.places[j].shift).astype(np.float32)
        if name in self._handles:
            self._handles[name].vertices = at
        else:
            self._handles[name] = self._scene.add_mesh_simple(
                name, at, np.asarray(surface.triangles, np.uint32), color=colour(surface.rgba),
                opacity=surface.rgba[3] if surface.rgba[3] < 1 else None, side="double",
            )  # fmt: skip
        return name

    def _label(self, j: int, place: Place) -> str:
        name = f"/labels/{j}"
        at = place.shift + LABEL_AT
        if name in self._handles:
            self._handles[name].text = place.label
        else:
            self._handles[name] = self._scene.add_label(
                name, place.label, position=at, anchor="top-center", font_screen_scale=0.8
            )
        return name

    # -- every frame ------------------------------------------------------------------------------

    def move(self, moment: Moment) -> None:
        """Draw the same environments at another time."""
        for place, qpos in zip(self.places, moment.qpos, strict=True):
            place.pose(qpos)
        with self.server.atomic():
            for name, parts in self._moving:
                positions, quats = poses(parts)
                assign(
                    self._handles[name], {"batched_positions": positions, "batched_wxyzs": quats}
                )
            for i, mark in enumerate(self._marks):
                positions, scales = self._spread(moment.points[i], mark.radius)
                assign(
                    self._handles[f"/marks/{i}"],
                    {"batched_positions": positions, "batched_scales": scales},
                )
            for i, sheet in enumerate(moment.sheets):
                for j, place in enumerate(self.places):
                    at = (sheet[j] + place.shift).astype(np.float32)
                    self._handles[f"/sheets/{i}/{j}"].vertices = at
        self.server.flush()

    def forces(self, forces: Forces | None) -> None:
        """Draw forces in the first place; None for nothing."""
        handle = self._handles.get("/forces")
        if forces is None or not len(forces.points):
            if handle is not None:
                handle.visible = False
            return
        length = np.linalg.norm(forces.vectors, axis=1, keepdims=True)
        drawn = np.minimum(length * (LENGTH_OF_10_N / 10.0), LONGEST)
        way = forces.vectors / np.maximum(length, 1e-9) * drawn
        tips = forces.points + self.places[0].shift
        ends = np.stack([tips - way, tips], axis=1)  # they end where they press
        colours = np.where(forces.on_person[:, None], PRESSED, OTHER).astype(np.uint8)
        if handle is None:
            self._handles["/forces"] = self._scene.add_arrows(
                "/forces", ends, colours, shaft_radius=0.006, head_radius=0.016, head_length=0.035
            )
            return
        assign(handle, {"points": ends.astype(np.float32), "colors": colours, "visible": True})

    # -- the eye ----------------------------------------------------------------------------------

    def aim(self, name: str, beside: float = 0.0) -> None:
        """Where the camera of a new browser, or of a replay, stands: see ``view``."""
        camera, (eye, target) = self.server.initial_camera, self.view(name, beside)
        camera.position, camera.look_at, camera.fov = eye, target, float(FIELD_OF_VIEW)

    def view(self, name: str, beside: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
        """Where a camera stands and what it looks at [m] (3,), (3,).

        Args:
            name: of one of the scene's, or "all" for several environments.
            beside: by which share of the picture's height everything is further left, where a panel hides the right.
        """
        if name == "all":
            shifts = np.array([p.shift for p in self.places])
            target = shifts.mean(axis=0) + MIDDLE
            eye = target + OVERVIEW * (np.ptp(shifts, axis=0).max() + 2.0)
        else:
            place = self.places[0]
            camera, data = place.model.camera(name), place.data
            mujoco.mj_camlight(place.model, data)
            back = data.cam_xmat[camera.id].reshape(3, 3)[:, 2]
            eye = data.cam_xpos[camera.id] + place.shift
            away = float((eye - place.shift - place.model.stat.center) @ back)
            target = eye - max(0.5, away) * back
        ahead = target - eye
        right = np.cross(ahead, (0.0, 0.0, 1.0))
        right *= np.linalg.norm(ahead) / np.linalg.norm(right)
        moved = 2.0 * np.tan(FIELD_OF_VIEW / 2) * beside * right
        return eye + moved, target + moved


def poses(parts: list[tuple[Place, shapes.Copies]]) -> tuple[np.ndarray, np.ndarray]:
    """Positions [m] (n, 3) and orientations, wxyz (n, 4), of copies in several places, float32."""
    positions, quats = [], []
    for place, copies in parts:
        data, geoms = place.data, copies.geoms
        bodies = place.model.geom_bodyid[geoms]
        axes = data.geom_xmat[geoms, 2::3]
        positions.append(data.geom_xpos[geoms] + copies.offsets[:, None] * axes + place.shift)
        quats.append(quat_mul(data.xquat[bodies], place.model.geom_quat[geoms], np))
    return np.concatenate(positions).astype(np.float32), np.concatenate(quats).astype(np.float32)


def assign(handle: Any, props: dict[str, Any]) -> None:
    """Set several properties of a node, those that changed."""
    for name, value in props.items():
        if not np.array_equal(getattr(handle, name), value):
            setattr(handle, name, value)


def linear(colours: np.ndarray) -> np.ndarray:
    """Colours as viser 1.1 takes those of instances: linear, from 0 to 255, made of sRGB (..., 3)."""
    x = colours / 255.0
    light = np.where(x <= 0.04045, x / 12.92, ((x + 0.055) / 1.055) ** 2.4)
    return np.round(255 * light).astype(np.uint8)


def colour(rgba: Sequence[float]) -> tuple[int, int, int]:
    """Red, green and blue from 0 to 255."""
    r, g, b = (round(255 * x) for x in rgba[:3])
    return r, g, b
