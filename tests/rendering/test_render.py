# ruff: noqa: D103
"""Pictures: each backend draws what MuJoCo's own rays hit, and every refusal says what to do."""

import subprocess
import sys
import warnings

import mujoco
import numpy as np
import pytest
from paths import PROCESS_SECONDS

from agym_jax import rendering
from agym_jax.errors import AgymError
from agym_jax.rendering import Marker, Renderer, quality, render

WIDTH, HEIGHT = 120, 90
SCENE = """
<mujoco>
  <asset>
    <texture type="skybox" builtin="flat" rgb1=".9 .9 .9" width="16" height="96"/>
  </asset>
  <worldbody>
    <light pos="1 -2 4" dir="-.2 .4 -.8"/>
    <camera name="front" pos="0 -2 .5" xyaxes="1 0 0 0 0 1" fovy="45"/>
    <camera name="top" pos="0 0 3" xyaxes="1 0 0 0 1 0" fovy="45"/>
    <geom name="floor" type="plane" size="0 0 .1" rgba=".75 .75 .75 1"/>
    <body name="turned" pos="-.4 0 .5" euler="20 30 70">
      <joint type="hinge"/>
      <geom name="box" type="box" size=".15 .1 .2" rgba=".1 .1 .9 1"/>
      <geom name="hidden" type="box" size=".9 .9 .9" group="3" rgba="1 0 0 1"/>
    </body>
    <body name="arm" pos=".1 0 .5" euler="0 40 0">
      <joint type="hinge"/>
      <geom name="capsule" type="capsule" size=".06 .25" rgba=".1 .1 .9 1"/>
      <geom name="ball" type="sphere" size=".12" pos=".4 0 .3" rgba=".1 .1 .9 1"/>
    </body>
  </worldbody>
</mujoco>
"""


def scene() -> tuple[mujoco.MjModel, mujoco.MjData]:
    model = mujoco.MjModel.from_xml_string(SCENE)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    return model, data


def blue(image: np.ndarray) -> np.ndarray:
    """Where the objects, which alone are blue, are."""
    return image[..., 2] > 2.0 * image[..., :2].max(axis=2)


def overlap(a: np.ndarray, b: np.ndarray) -> float:
    return (a & b).sum() / (a | b).sum()


def gl_opens() -> bool:
    model, _ = scene()
    try:
        with Renderer(model, 16, 16, backend="gl") as renderer:
            return renderer.backend == "gl"
    except render.RenderBackendError:
        return False


# Rays need no library; what OpenGL does where it is missing has tests of its own, below.
BACKENDS = ("raycast", "gl") if gl_opens() else ("raycast",)


@pytest.fixture(params=BACKENDS)
def backend(request: pytest.FixtureRequest) -> str:
    return request.param


@pytest.fixture(autouse=True)
def no_override(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("AGYM_JAX_RENDER", raising=False)


def shot(model, data, backend="raycast", camera="front", markers=()) -> np.ndarray:
    with Renderer(model, WIDTH, HEIGHT, camera, backend) as renderer:
        assert renderer.backend == backend
        return renderer.render(data, markers)


def first_geoms(model: mujoco.MjModel, data: mujoco.MjData, camera: str) -> np.ndarray:
    """The geom that one ray through each pixel's centre meets, or -1, (HEIGHT, WIDTH)."""
    eye, axes = data.camera(camera).xpos, data.camera(camera).xmat.reshape(3, 3)
    focal = HEIGHT / 2 / np.tan(np.radians(model.camera(camera).fovy[0]) / 2)
    drawn, met = np.array([1, 1, 1, 0, 0, 0], np.uint8), np.empty(1, np.int32)
    geoms = np.empty((HEIGHT, WIDTH), np.int32)
    for row, column in np.ndindex(HEIGHT, WIDTH):
        right, up = column + 0.5 - WIDTH / 2, HEIGHT / 2 - row - 0.5
        mujoco.mj_ray(
            model, data, eye, axes @ (right / focal, up / focal, -1.0), drawn, True, -1, met
        )
        geoms[row, column] = met[0]
    return geoms


def away_from_edges(geoms: np.ndarray) -> np.ndarray:
    """Pixels whose eight neighbours show the same thing."""
    around = np.lib.stride_tricks.sliding_window_view(np.pad(geoms, 1, mode="edge"), (3, 3))
    return (around == geoms[..., None, None]).all(axis=(2, 3))


@pytest.mark.parametrize("camera", ["front", "top"])
def test_silhouettes_match_ray_hits(backend, camera):
    model, data = scene()
    names = ("capsule", "ball", "box")  # painted red, green, blue; floor and sky are grey: -1
    ids = [model.geom(name).id for name in names]
    model.geom_rgba[ids, :3] = 0.05 + 0.85 * np.eye(3)
    truth = first_geoms(model, data, camera)
    truth[~np.isin(truth, ids)] = -1
    image = shot(model, data, backend, camera).astype(int)
    ranked = np.sort(image, axis=2)
    coloured = ranked[..., 2] > 2 * ranked[..., 1]
    seen = np.where(coloured, np.take(ids, image.argmax(axis=2)), -1)
    inside = away_from_edges(truth)
    assert inside.mean() > 0.9
    np.testing.assert_array_equal(seen[inside], truth[inside])
    for geom in ids:  # edges are blended, but nothing has moved by as much as a pixel
        assert (inside & (truth == geom)).sum() > 40
        shift = np.argwhere(seen == geom).mean(axis=0) - np.argwhere(truth == geom).mean(axis=0)
        assert np.abs(shift).max() < 0.6


def test_image_is_uint8_of_the_requested_size(backend):
    model, data = scene()
    image = shot(model, data, backend)
    assert image.shape == (HEIGHT, WIDTH, 3) and image.dtype == np.uint8
    assert image.std() > 10


def test_large_images_need_no_framebuffer_in_the_model(backend):
    model, data = scene()
    assert model.vis.global_.offwidth < 800
    with Renderer(model, 800, 40, backend=backend) as renderer:
        assert renderer.render(data).shape == (40, 800, 3)


FULL = quality.Quality(shadowsize=4096, offsamples=8, numslices=40, numstacks=24)


@pytest.mark.parametrize(
    ("size", "expected"),
    [
        ((1280, 960), FULL),
        ((640, 480), FULL),
        ((480, 640), FULL),
        ((320, 240), quality.Quality(2048, 4, 29, 17)),
        ((64, 64), quality.Quality(512, 4, 13, 8)),
        ((1, 1), quality.Quality(256, 4, 12, 8)),
    ],
)
def test_quality_shrinks_with_the_picture(size, expected):
    assert quality.quality_for(FULL, *size) == expected


def test_quality_is_never_finer_than_the_model_says():
    coarse = quality.Quality(shadowsize=0, offsamples=0, numslices=9, numstacks=3)
    assert all(quality.quality_for(coarse, side, 8) == coarse for side in (8, 300, 4000))


@pytest.mark.skipif("gl" not in BACKENDS, reason="needs OpenGL")
def test_opengl_draws_as_finely_as_the_picture_shows_and_leaves_the_model_alone():
    model, _ = scene()
    full = quality.Quality(*(getattr(model.vis.quality, name) for name in quality.Quality._fields))
    with (
        Renderer(model, 64, 64, backend="gl") as small,
        Renderer(model, 640, 8, backend="gl") as wide,
    ):
        sizes = [renderer._backend._context.shadowSize for renderer in (small, wide)]
    assert sizes == [quality.quality_for(full, 64, 64).shadowsize, full.shadowsize]
    assert full == quality.Quality(
        *(getattr(model.vis.quality, name) for name in quality.Quality._fields)
    )


def test_marker_is_drawn_at_its_position(backend):
    model, data = scene()
    green = Marker(pos=(0.3, 0.0, 1.0), radius=0.05, rgba=(0, 1, 0, 1))
    image = shot(model, data, backend, markers=[green]).astype(int)
    rows, columns = np.nonzero(image[..., 1] > image[..., 0] + 60)
    focal = HEIGHT / 2 / np.tan(np.radians(45 / 2))
    assert columns.mean() + 0.5 == pytest.approx(WIDTH / 2 + focal * 0.3 / 2, abs=1)
    assert rows.mean() + 0.5 == pytest.approx(HEIGHT / 2 - focal * 0.5 / 2, abs=1)
    assert len(rows) == pytest.approx(np.pi * (focal * 0.05 / 2) ** 2, rel=0.35)
    plain = shot(model, data, backend).astype(int)
    assert not (plain[..., 1] > plain[..., 0] + 60).any(), "a marker is drawn once only"


def test_many_markers_are_drawn(backend):
    model, data = scene()
    rng = np.random.default_rng(0)
    spots = rng.uniform((-0.5, -0.5, 0.2), (0.5, 0.5, 1.2), (150, 3))
    food = [Marker(spot, 0.03, (0, 1, 0, 1)) for spot in spots]
    with Renderer(model, WIDTH, HEIGHT, backend=backend) as renderer:
        renderer.render(data)
        image = renderer.render(data, food).astype(int)
    assert (image[..., 1] > image[..., 0] + 60).mean() > 0.05


def test_collision_geoms_are_hidden(backend):
    model, data = scene()
    red, green, _ = shot(model, data, backend).astype(int).transpose(2, 0, 1)
    assert not (red > green + 40).any()
    model.geom("hidden").group = 0
    red, green, _ = shot(model, data, backend).astype(int).transpose(2, 0, 1)
    assert (red > green + 40).mean() > 0.2


def test_faint_geoms_are_not_drawn_by_rays():
    model, data = scene()
    seen = blue(shot(model, data))
    model.geom("ball").rgba[3] = 0.05
    fewer = blue(shot(model, data))
    assert fewer.sum() < seen.sum() and not (fewer & ~seen).any()


@pytest.mark.parametrize("name", ["ball", "capsule", "box"])
def test_sizes_written_between_images_are_drawn(backend, name):
    model, data = scene()
    with Renderer(model, WIDTH, HEIGHT, backend=backend) as renderer:
        before = blue(renderer.render(data))
        model.geom(name).size[:] *= 2.0
        after = blue(renderer.render(data))
    model.geom_rbound[:] = 10.0
    if backend == "raycast":
        # Culling by the compiler's bounds would cut pieces off: ask brute force.
        with Renderer(model, WIDTH, HEIGHT, backend=backend) as renderer:
            model.body_bvhadr[:] = -1
            brute = blue(renderer.render(data))
        assert overlap(brute, after) == 1.0
    assert after.sum() > 1.2 * before.sum()


def test_objects_cast_shadows_on_the_floor():
    model, data = scene()
    lit = shot(model, data, camera="top").astype(int)
    model.light_castshadow[:] = False
    unlit = shot(model, data, camera="top").astype(int)
    darker = (unlit - lit).max(axis=2) > 30
    assert 0.01 < darker.mean() < 0.3


def test_translucent_geoms_show_what_is_behind():
    model, data = scene()
    ball = model.geom("ball")
    ball.rgba[:] = (1, 0, 0, 1)
    full = shot(model, data).astype(int)
    ball.rgba[3] = 0.5
    half = shot(model, data).astype(int)
    here = full[..., 0] > full[..., 2] + 120
    assert here.sum() > 20
    assert (half[here][:, 2] > full[here][:, 2] + 30).mean() > 0.9


def test_unknown_camera_names_the_nearest_match():
    model, _ = scene()
    with pytest.raises(render.UnknownCameraError, match=r"Did you mean 'front'.*front, top") as e:
        Renderer(model, camera="frnt", backend="raycast")
    assert isinstance(e.value, AgymError)
    with pytest.raises(render.UnknownCameraError, match="'7'"):
        Renderer(model, camera=7, backend="raycast")


def test_free_camera_shows_the_scene():
    model, data = scene()
    assert blue(shot(model, data, camera=-1)).any()


def no_library(*_):
    raise render.RenderBackendError("egl: pretended to be missing")


def test_auto_falls_back_to_raycast_and_warns_once(monkeypatch):
    monkeypatch.setattr(render, "_open_context", no_library)
    monkeypatch.setattr(render._Process, "warned", False)
    model, data = scene()
    with pytest.warns(render.RenderFallbackWarning, match=r"pretended.*libegl1") as told:
        renderer = Renderer(model, 32, 24)
    assert len(told) == 1 and told[0].filename == __file__
    assert renderer.backend == "raycast"
    assert renderer.render(data).any()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert Renderer(model, 32, 24).backend == "raycast"


def test_unavailable_gl_is_an_error_that_names_the_package(monkeypatch):
    monkeypatch.setattr(render, "_open_context", no_library)
    model, _ = scene()
    with pytest.raises(render.RenderBackendError, match=r"libegl1.*raycast"):
        Renderer(model, backend="gl")


def test_failed_gl_library_is_unloaded(monkeypatch):
    def fail():
        raise OSError("no EGL here")

    monkeypatch.setattr(render, "_probe_egl", fail)
    monkeypatch.setenv("MUJOCO_GL", "egl")
    monkeypatch.delenv("PYOPENGL_PLATFORM", raising=False)
    with pytest.raises(render.RenderBackendError, match="egl: no EGL here"):
        render._open_context(8, 8)
    assert "PYOPENGL_PLATFORM" not in render.os.environ


def test_environment_variable_overrides_the_backend(monkeypatch):
    model, _ = scene()
    monkeypatch.setenv("AGYM_JAX_RENDER", "raycast")
    assert Renderer(model, 32, 24, backend="gl").backend == "raycast"
    monkeypatch.setenv("AGYM_JAX_RENDER", "raycst")
    with pytest.raises(render.RenderBackendError, match="Did you mean 'raycast'"):
        Renderer(model)


def test_closed_renderer_refuses_to_render():
    model, data = scene()
    renderer = Renderer(model, 32, 24, backend="raycast")
    renderer.close()
    renderer.close()
    with pytest.raises(render.RenderBackendError, match="closed"):
        renderer.render(data)


def test_rendering_exports_are_imported_at_first_use():
    code = (
        "import sys, agym_jax.rendering as r\n"
        "assert not {'agym_jax.rendering.render', 'mujoco', 'OpenGL'} & set(sys.modules)\n"
        "assert r.Renderer and r.Marker and r.write_clip and set(r.__all__) <= set(dir(r))\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, timeout=PROCESS_SECONDS
    )
    assert not done.returncode, done.stderr
    with pytest.raises(AttributeError, match="no attribute 'Rendrer'"):
        rendering.Rendrer  # noqa: B018


def test_markers_are_added_to_a_scene_as_far_as_there_is_room():
    scene = mujoco.MjvScene(mujoco.MjModel.from_xml_string("<mujoco/>"), maxgeom=2)
    marker = Marker(np.array([1.0, 2.0, 3.0]), 0.01, (0.0, 1.0, 0.0, 1.0))
    render.add_markers(scene, [marker] * 3)
    assert scene.ngeom == 2
    np.testing.assert_allclose(scene.geoms[1].pos, [1, 2, 3])
    np.testing.assert_allclose(scene.geoms[1].size, 0.01)
    np.testing.assert_allclose(scene.geoms[1].rgba, [0, 1, 0, 1])
