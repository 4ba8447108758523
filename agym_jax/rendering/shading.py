"""Pictures without OpenGL: MuJoCo casts the rays, numpy shades what they hit.

Colours, lights, camera and what is visible come from ``mjv_updateScene``, which needs no OpenGL,
so they follow MuJoCo's own rules. Shadow rays are cast from the light, so that they too have one
origin. Edges are antialiased by casting four more rays through the pixels that differ from a
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
    aim,
    build_ray_scene,
    lengths,
    trace,
)

EDGE = 10.0  # neighbours that differ by more grey levels than this are antialiased
ROTATED_GRID = ((-0.125, -0.375), (0.375, -0.125), (0.125, 0.375), (-0.375, 0.125))  # pixels
SKY = np.array([[0.93, 0.95, 0.97], [0.52, 0.68, 0.86]])  # horizon and zenith, rgb
CHECKER_CELL, CHECKER_CONTRAST = 0.5, 0.045  # m, part of the floor's brightness


@dataclass(frozen=True)
class Stage:
    """A scene and how it looks: one row for each geom of the model, then for each marker and each surface.

    Args:
        scene: the geometry.
        view: MuJoCo's abstract scene: camera, lights.
        rgba: colour, (n, 4) in 0..1.
        gloss: emission, specular, shininess, (n, 3).
        planes: for each plane drawn: geom, texture or -1, repeats across one metre (2,).
        sky: colours at the horizon and at the zenith, (2, 3) in 0..1.
    """

    scene: RayScene
    view: mujoco.MjvScene
    rgba: np.ndarray
    gloss: np.ndarray
    planes: tuple[tuple[int, int, np.ndarray], ...]
    sky: np.ndarray


def set_stage(
    model: mujoco.MjModel, data: mujoco.MjData, view: mujoco.MjvScene, markers: Sequence[Marker]
) -> Stage:
    """Collect what a picture needs.

    Args:
        model: the caller's model, not written.
        data: current kinematics.
        view: updated by ``mjv_updateScene``; geoms that it does not show are not drawn.
        markers: extra spheres.

    Returns:
        The stage of this instant.
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
    scene = build_ray_scene(model, data, rgba[: model.ngeom, 3], markers)
    return Stage(scene, view, rgba, gloss, tuple(planes), sky_colors(model))


def plane_texture(model: mujoco.MjModel, plane: mujoco.MjvGeom) -> tuple[int, np.ndarray]:
    """A plane's texture, or -1, and how often it repeats across one metre of x and y (2,)."""
    if plane.matid < 0:
        return -1, np.zeros(2)
    texture = model.mat_texid[plane.matid, mujoco.mjtTextureRole.mjTEXROLE_RGB]
    repeat = model.mat_texrepeat[plane.matid] / 2.0
    if not model.mat_texuniform[plane.matid]:
        half = model.geom_size[plane.objid, :2]
        repeat = repeat / np.where(half > 0, half, 1.0)
    return int(texture), repeat


def texels(model: mujoco.MjModel, texture: int) -> np.ndarray:
    """A texture's pixels, rgb, (height, width, 3) uint8; a cube's six sides are stacked."""
    height, width = model.tex_height[texture], model.tex_width[texture]
    channels, start = model.tex_nchannel[texture], model.tex_adr[texture]
    flat = model.tex_data[start : start + height * width * channels]
    return flat.reshape(height, width, channels)[..., :3]


def sky_colors(model: mujoco.MjModel) -> np.ndarray:
    """Horizon and zenith of the model's skybox, or a clear day, (2, 3) in 0..1."""
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


def sky(stage: Stage, rays: np.ndarray) -> np.ndarray:
    """Colour where nothing is met: a gradient from the horizon to the zenith, (n, 3) in 0..1."""
    t = np.clip(rays[:, 2:], 0.0, 1.0) ** 0.6
    return stage.sky[0] * (1 - t) + stage.sky[1] * t


def paint(stage: Stage, what: np.ndarray, points: np.ndarray, dist: np.ndarray) -> np.ndarray:
    """Base colours of hits; planes get their texture or a faint checker, fading into the distance.

    Args:
        stage: for looks and poses.
        what: rows of ``Stage``, (n,).
        points: hit points, (n, 3) [m].
        dist: distance from the eye, (n,) [m].

    Returns:
        rgb, (n, 3) in 0..1.
    """
    base = stage.rgba[what, :3]
    model, data = stage.scene.model, stage.scene.data
    for geom, texture, repeat in stage.planes:
        here = np.flatnonzero(what == geom)
        local = points[here] - data.geom_xpos[geom]
        local = local @ data.geom_xmat[geom].reshape(3, 3)[:, :2]
        fade = np.exp(-dist[here, None] / 15.0)
        if texture < 0:
            odd = np.floor(local / CHECKER_CELL).astype(np.int64).sum(axis=1) & 1
            base[here] *= 1 + CHECKER_CONTRAST * (2 * odd[:, None] - 1) * fade
            continue
        texture = texels(model, texture) / 255.0
        at = (local * repeat * (1, -1) - 0.5) % 1.0
        row, column = (at[:, ::-1] * texture.shape[:2]).astype(int).T
        mean, seen = texture.mean(axis=(0, 1)), texture[row, column]
        base[here] *= mean + (seen - mean) * fade
    return base


def lit(scene: RayScene, light: mujoco.MjvLight, points: np.ndarray) -> np.ndarray:
    """Whether the light reaches the points: rays from the light to each.

    Args:
        scene: what may be in the way; translucent things are not.
        light: where from; a directional light is one far away.
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


def shade(stage: Stage, eye: np.ndarray, rays: np.ndarray, hits: Hits) -> np.ndarray:
    """Colours of hits by MuJoCo's lighting rules: ambient, Lambert, Blinn-Phong, shadows.

    Args:
        stage: looks and lights.
        eye: origin of the rays, (3,) [m].
        rays: unit directions, (n, 3).
        hits: what they met.

    Returns:
        rgb, (n, 3) in 0..1.
    """
    out = sky(stage, rays)
    met = np.flatnonzero(hits.what >= 0)
    if not met.size:
        return out
    what, dist, normal, ray = hits.what[met], hits.dist[met], hits.normal[met], rays[met]
    points = eye + ray * dist[:, None]
    base = paint(stage, what, points, dist)
    emission, specular, shininess = stage.gloss[what].T
    # The sky fills shadows from above a little more than the ground does from below.
    fill = (0.04 * (1 + normal[:, 2]))[:, None]
    color = base * (emission[:, None] + fill)
    lights = stage.view.lights[: stage.view.nlight]
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
            here = here[lit(stage.scene, light, points[here])]
        half = to[here] - ray[here]
        half /= np.maximum(lengths(half), 1e-9)[:, None]
        glint = np.clip(np.einsum("ij,ij->i", normal[here], half), 0, 1)
        glint = power[here] * specular[here] * glint ** (128 * shininess[here])
        diffuse = (slope * power)[here, None]
        color[here] += base[here] * (light.diffuse * diffuse) + light.specular * glint[:, None]
    if not lights:
        color += 0.6 * base
    # Endless floors melt into the horizon.
    far = (12.0 * max(1.0, stage.scene.model.stat.extent)) ** 2
    haze = (1 - np.exp(-(dist**2) / far))[:, None]
    out[met] = np.clip(color, 0, 1) * (1 - haze) + stage.sky[0] * haze
    return out


def look(stage: Stage, eye: np.ndarray, rays: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Colours seen along rays, through one layer of translucent things.

    Args:
        stage: what to look at.
        eye: origin of the rays, (3,) [m].
        rays: unit directions, (n, 3).

    Returns:
        rgb (n, 3) in 0..1, and the row of ``Stage`` that each ray met first (n,).
    """
    hits = trace(stage.scene, eye, rays, clear=True)
    color = shade(stage, eye, rays, hits)
    alpha = np.where(hits.what >= 0, stage.scene.alpha[hits.what], 1.0)
    through = np.flatnonzero(alpha <= OPAQUE_ALPHA)
    if through.size:
        solid = trace(stage.scene, eye, rays[through], clear=False)
        behind = shade(stage, eye, rays[through], solid)
        a = alpha[through, None]
        color[through] = a * color[through] + (1 - a) * behind
    return color, hits.what


def draw(stage: Stage, width: int, height: int) -> np.ndarray:
    """The picture.

    Args:
        stage: from ``set_stage``.
        width: pixels.
        height: pixels.

    Returns:
        uint8, (height, width, 3).
    """
    y, x = (i.reshape(-1) + 0.5 for i in np.mgrid[:height, :width].astype(float))
    color, what = look(stage, *aim(stage.view, x, y, width, height))
    image = 255 * color.reshape(height, width, 3)
    what = what.reshape(height, width)
    edge = np.zeros((height, width), bool)
    for axis in (0, 1):
        jump = np.abs(np.diff(image, axis=axis)).max(axis=2) > EDGE
        jump |= np.diff(what, axis=axis) != 0
        before, after = [slice(None)] * 2, [slice(None)] * 2
        before[axis], after[axis] = slice(None, -1), slice(1, None)
        edge[tuple(before)] |= jump
        edge[tuple(after)] |= jump
    again = np.flatnonzero(edge)
    if again.size:
        xs = np.concatenate([x[again] + dx for dx, _ in ROTATED_GRID])
        ys = np.concatenate([y[again] + dy for _, dy in ROTATED_GRID])
        finer, _ = look(stage, *aim(stage.view, xs, ys, width, height))
        image.reshape(-1, 3)[again] = 255 * finer.reshape(len(ROTATED_GRID), -1, 3).mean(axis=0)
    return np.clip(image + 0.5, 0, 255).astype(np.uint8)
