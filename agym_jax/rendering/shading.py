"""Images without OpenGL: MuJoCo casts the rays, NumPy shades the hits.

Colours, lights, camera and visibility come from ``mjv_updateScene``, which needs no OpenGL,
so they follow MuJoCo's own rules. Shadow rays are cast from the light, so that they have a common
origin, too. Edges are antialiased by casting four more rays through the pixels that differ from a
neighbour.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from agym_jax.rendering.raycast import (
    OPAQUE_ALPHA,
    Hits,
    Marker,
    RayScene,
    build_ray_scene,
    camera_rays,
    lengths,
    trace,
)

EDGE = 10.0  # neighbours that differ by more grey levels than this are antialiased
ROTATED_GRID = ((-0.125, -0.375), (0.375, -0.125), (0.125, 0.375), (-0.375, 0.125))  # pixels
SKY = np.array([[0.93, 0.95, 0.97], [0.52, 0.68, 0.86]])  # horizon and zenith, rgb
CHECKER_CELL, CHECKER_CONTRAST = 0.5, 0.045  # m, part of the floor's brightness


@dataclass(frozen=True)
class ShadedScene:
    """A scene with materials and lights. Its rows are the geoms of the model, then the markers, then the surfaces.

    Args:
        geometry: what the rays are cast against.
        view: MuJoCo's abstract scene, for camera and lights.
        rgba: colour, (n, 4) in 0..1.
        gloss: emission, specular, shininess, (n, 3).
        planes: of each visible plane: geom, texture or -1, and repetitions per metre (2,).
        sky: colours at the horizon and at the zenith, (2, 3) in 0..1.
    """

    geometry: RayScene
    view: mujoco.MjvScene
    rgba: np.ndarray
    gloss: np.ndarray
    planes: tuple[tuple[int, int, np.ndarray], ...]
    sky: np.ndarray


def build_shaded_scene(
    model: mujoco.MjModel, data: mujoco.MjData, view: mujoco.MjvScene, markers: Sequence[Marker]
) -> ShadedScene:
    """Build the shaded scene of one instant.

    Args:
        model: the caller's model, not written.
        data: current kinematics.
        view: updated by ``mjv_updateScene``; geoms that it does not show are not drawn.
        markers: extra spheres.

    Returns:
        The scene.
    """
    n = model.ngeom + len(markers) + model.nflex
    rgba, gloss, planes = np.zeros((n, 4)), np.tile([0.0, 0.5, 0.5], (n, 1)), []
    for geom in view.geoms[: view.ngeom]:
        if geom.objtype != mujoco.mjtObj.mjOBJ_GEOM or not 0 <= geom.objid < model.ngeom:
            continue
        rgba[geom.objid] = geom.rgba
        gloss[geom.objid] = geom.emission, geom.specular, geom.shininess
        if geom.type == mujoco.mjtGeom.mjGEOM_PLANE:
            planes.append((geom.objid, *plane_texture(model, geom)))
    for row, marker in enumerate(markers, start=model.ngeom):
        rgba[row] = marker.rgba
    rgba[n - model.nflex :] = model.flex_rgba
    geometry = build_ray_scene(model, data, rgba[: model.ngeom, 3], markers)
    return ShadedScene(geometry, view, rgba, gloss, tuple(planes), sky_colors(model))


def plane_texture(model: mujoco.MjModel, plane: mujoco.MjvGeom) -> tuple[int, np.ndarray]:
    """A plane's texture, or -1, and its repetitions per metre along x and y (2,)."""
    if plane.matid < 0:
        return -1, np.zeros(2)
    texture = model.mat_texid[plane.matid, mujoco.mjtTextureRole.mjTEXROLE_RGB]
    repeat = model.mat_texrepeat[plane.matid] / 2.0
    if not model.mat_texuniform[plane.matid]:
        half = model.geom_size[plane.objid, :2]
        repeat = repeat / np.where(half > 0, half, 1.0)
    return int(texture), repeat


def texels(model: mujoco.MjModel, texture: int) -> np.ndarray:
    """A texture's pixels, rgb, (height, width, 3) uint8; the six sides of a cube are stacked."""
    height, width = model.tex_height[texture], model.tex_width[texture]
    channels, start = model.tex_nchannel[texture], model.tex_adr[texture]
    flat = model.tex_data[start : start + height * width * channels]
    return flat.reshape(height, width, channels)[..., :3]


def sky_colors(model: mujoco.MjModel) -> np.ndarray:
    """Colours of the model's skybox at the horizon and at the zenith, or a default, (2, 3) in 0..1."""
    boxes = np.flatnonzero(model.tex_type == mujoco.mjtTexture.mjTEXTURE_SKYBOX)
    if not boxes.size:
        return SKY
    sides = texels(model, boxes[0]) / 255.0
    width = sides.shape[1]
    if len(sides) != 6 * width:
        return SKY
    sides = sides.reshape(6, width, width, 3)  # right, left, up, down, front, back
    middle = slice(width // 2 - 1, width // 2 + 1)
    return np.stack([sides[4, middle].mean(axis=(0, 1)), sides[2].mean(axis=(0, 1))])


def sky(scene: ShadedScene, rays: np.ndarray) -> np.ndarray:
    """Background colour: a gradient from the horizon to the zenith, (n, 3) in 0..1."""
    t = np.clip(rays[:, 2:], 0.0, 1.0) ** 0.6
    return scene.sky[0] * (1 - t) + scene.sky[1] * t


def base_color(
    scene: ShadedScene, row: np.ndarray, points: np.ndarray, dist: np.ndarray
) -> np.ndarray:
    """Base colours of hits. Planes get their texture or a faint checker pattern that fades with distance.

    Args:
        scene: for materials and poses.
        row: rows of the scene, (n,).
        points: hit points, (n, 3) [m].
        dist: distance from the eye, (n,) [m].

    Returns:
        rgb, (n, 3) in 0..1.
    """
    base = scene.rgba[row, :3]
    model, data = scene.geometry.model, scene.geometry.data
    for geom, texture, repeat in scene.planes:
        here = np.flatnonzero(row == geom)
        local = points[here] - data.geom_xpos[geom]
        local = local @ data.geom_xmat[geom].reshape(3, 3)[:, :2]
        fade = np.exp(-dist[here, None] / 15.0)
        if texture < 0:
            odd = np.floor(local / CHECKER_CELL).astype(np.int64).sum(axis=1) & 1
            base[here] *= 1 + CHECKER_CONTRAST * (2 * odd[:, None] - 1) * fade
            continue
        texture = texels(model, texture) / 255.0
        at = (local * repeat * (1, -1) - 0.5) % 1.0
        v, u = (at[:, ::-1] * texture.shape[:2]).astype(int).T
        mean, seen = texture.mean(axis=(0, 1)), texture[v, u]
        base[here] *= mean + (seen - mean) * fade
    return base


def is_lit(scene: RayScene, light: mujoco.MjvLight, points: np.ndarray) -> np.ndarray:
    """Whether the light reaches the points, by rays from the light to each.

    Args:
        scene: the geometry; translucent geometry casts no shadow.
        light: a directional light is treated as one far away.
        points: (n, 3) [m].

    Returns:
        bool, (n,).
    """
    origin = np.asarray(light.pos, dtype=float)
    if light.type == mujoco.mjtLightType.mjLIGHT_DIRECTIONAL:
        away = 40.0 * max(1.0, scene.model.stat.extent)
        origin = scene.model.stat.center - away * np.asarray(light.dir, dtype=float)
    rays = points - origin
    length = lengths(rays)
    hits = trace(scene, origin, rays / np.maximum(length, 1e-9)[:, None], clear=False)
    return hits.dist > length - 1e-3 * max(1.0, scene.model.stat.extent)


def shade(scene: ShadedScene, eye: np.ndarray, rays: np.ndarray, hits: Hits) -> np.ndarray:
    """Colours of hits by MuJoCo's lighting rules: ambient, Lambert, Blinn-Phong, shadows.

    Args:
        scene: materials and lights.
        eye: origin of the rays, (3,) [m].
        rays: unit directions, (n, 3).
        hits: their first intersections.

    Returns:
        rgb, (n, 3) in 0..1.
    """
    out = sky(scene, rays)
    met = np.flatnonzero(hits.row >= 0)
    if not met.size:
        return out
    row, dist, normal, ray = hits.row[met], hits.dist[met], hits.normal[met], rays[met]
    points = eye + ray * dist[:, None]
    base = base_color(scene, row, points, dist)
    emission, specular, shininess = scene.gloss[row].T
    # ambient light: more from the sky than from the ground
    fill = (0.04 * (1 + normal[:, 2]))[:, None]
    color = base * (emission[:, None] + fill)
    lights = scene.view.lights[: scene.view.nlight]
    for light in lights:
        if light.type == mujoco.mjtLightType.mjLIGHT_IMAGE:
            continue
        to = -np.asarray(light.dir, dtype=float)[None]
        power = np.ones(len(points))
        if light.type != mujoco.mjtLightType.mjLIGHT_DIRECTIONAL:
            to = np.asarray(light.pos, dtype=float) - points
            length = np.maximum(lengths(to), 1e-9)
            to = to / length[:, None]
            a = light.attenuation
            power = 1.0 / np.maximum(a[0] + a[1] * length + a[2] * length**2, 1e-6)
        if light.type == mujoco.mjtLightType.mjLIGHT_SPOT:
            cosine = np.clip(-to @ np.asarray(light.dir, dtype=float), 0.0, 1.0)
            power *= (cosine >= np.cos(np.radians(light.cutoff))) * cosine**light.exponent
        color += base * light.ambient * power[:, None]
        to = np.broadcast_to(to, points.shape)
        slope = np.einsum("ij,ij->i", normal, to)
        here = np.flatnonzero((slope > 0) & (power > 1e-3))
        if light.castshadow and here.size:
            here = here[is_lit(scene.geometry, light, points[here])]
        half = to[here] - ray[here]
        half /= np.maximum(lengths(half), 1e-9)[:, None]
        glint = np.clip(np.einsum("ij,ij->i", normal[here], half), 0, 1)
        glint = power[here] * specular[here] * glint ** (128 * shininess[here])
        diffuse = (slope * power)[here, None]
        color[here] += base[here] * (light.diffuse * diffuse) + light.specular * glint[:, None]
    if not lights:
        color += 0.6 * base
    # infinite floors fade into the horizon
    far = (12.0 * max(1.0, scene.geometry.model.stat.extent)) ** 2
    haze = (1 - np.exp(-(dist**2) / far))[:, None]
    out[met] = np.clip(color, 0, 1) * (1 - haze) + scene.sky[0] * haze
    return out


def trace_color(
    scene: ShadedScene, eye: np.ndarray, rays: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Colours along rays, through one layer of translucent geometry.

    Args:
        scene: the shaded scene.
        eye: origin of the rays, (3,) [m].
        rays: unit directions, (n, 3).

    Returns:
        rgb (n, 3) in 0..1, and the row that each ray hits first (n,).
    """
    hits = trace(scene.geometry, eye, rays, clear=True)
    color = shade(scene, eye, rays, hits)
    alpha = np.where(hits.row >= 0, scene.geometry.alpha[hits.row], 1.0)
    through = np.flatnonzero(alpha <= OPAQUE_ALPHA)
    if through.size:
        solid = trace(scene.geometry, eye, rays[through], clear=False)
        behind = shade(scene, eye, rays[through], solid)
        a = alpha[through, None]
        color[through] = a * color[through] + (1 - a) * behind
    return color, hits.row


def draw(scene: ShadedScene, width: int, height: int) -> np.ndarray:
    """Render the image.

    Args:
        scene: from ``build_shaded_scene``.
        width: pixels.
        height: pixels.

    Returns:
        uint8, (height, width, 3).
    """
    y, x = (i.reshape(-1) + 0.5 for i in np.mgrid[:height, :width].astype(float))
    color, row = trace_color(scene, *camera_rays(scene.view, x, y, width, height))
    image = 255 * color.reshape(height, width, 3)
    row = row.reshape(height, width)
    edge = np.zeros((height, width), bool)
    for axis in (0, 1):
        jump = np.abs(np.diff(image, axis=axis)).max(axis=2) > EDGE
        jump |= np.diff(row, axis=axis) != 0
        before, after = [slice(None)] * 2, [slice(None)] * 2
        before[axis], after[axis] = slice(None, -1), slice(1, None)
        edge[tuple(before)] |= jump
        edge[tuple(after)] |= jump
    again = np.flatnonzero(edge)
    if again.size:
        xs = np.concatenate([x[again] + dx for dx, _ in ROTATED_GRID])
        ys = np.concatenate([y[again] + dy for _, dy in ROTATED_GRID])
        finer, _ = trace_color(scene, *camera_rays(scene.view, xs, ys, width, height))
        image.reshape(-1, 3)[again] = 255 * finer.reshape(len(ROTATED_GRID), -1, 3).mean(axis=0)
    return np.clip(image + 0.5, 0, 255).astype(np.uint8)
