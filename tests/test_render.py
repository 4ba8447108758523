# ruff: noqa: D103
"""Pictures: both backends see the same scene, and every refusal says what to do."""

import functools
import gc
import sys
import warnings

import mujoco
import numpy as np
import pytest

from agym_jax import clips, render
from agym_jax.errors import AgymError
from agym_jax.render import Marker, Renderer

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


@functools.cache
def why_no_gl() -> str:
    model, _ = scene()
    try:
        Renderer(model, 16, 16, backend="gl").close()
    except render.RenderBackendError as error:
        return str(error)
    return ""


@pytest.fixture(params=["raycast", "gl"])
def backend(request: pytest.FixtureRequest) -> str:
    if request.param == "gl" and why_no_gl():
        pytest.skip(why_no_gl())
    return request.param


@pytest.fixture(autouse=True)
def no_override(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("AGYM_JAX_RENDER", raising=False)


def shot(model, data, backend="raycast", camera="front", markers=()) -> np.ndarray:
    with Renderer(model, WIDTH, HEIGHT, camera, backend) as renderer:
        assert renderer.backend == backend
        return renderer.render(data, markers)


@pytest.mark.parametrize("camera", ["front", "top"])
def test_both_backends_draw_the_same_silhouette(camera):
    if why_no_gl():
        pytest.skip(why_no_gl())
    model, data = scene()
    rays, gl = (blue(shot(model, data, b, camera)) for b in ("raycast", "gl"))
    assert 0.02 < rays.mean() < 0.5
    assert overlap(rays, gl) > 0.93


def test_picture_is_uint8_of_the_asked_size(backend):
    model, data = scene()
    image = shot(model, data, backend)
    assert image.shape == (HEIGHT, WIDTH, 3) and image.dtype == np.uint8
    assert image.std() > 10


def test_large_pictures_need_no_framebuffer_in_the_model(backend):
    model, data = scene()
    assert model.vis.global_.offwidth < 800
    with Renderer(model, 800, 40, backend=backend) as renderer:
        assert renderer.render(data).shape == (40, 800, 3)


def test_marker_is_seen_where_it_is(backend):
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


def test_many_markers_fit(backend):
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
def test_sizes_written_between_pictures_show(backend, name):
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


def test_translucent_geoms_let_what_is_behind_through():
    model, data = scene()
    ball = model.geom("ball")
    ball.rgba[:] = (1, 0, 0, 1)
    full = shot(model, data).astype(int)
    ball.rgba[3] = 0.5
    half = shot(model, data).astype(int)
    here = full[..., 0] > full[..., 2] + 120
    assert here.sum() > 20
    assert (half[here][:, 2] > full[here][:, 2] + 30).mean() > 0.9


def test_unknown_camera_names_the_nearest():
    model, _ = scene()
    with pytest.raises(render.UnknownCameraError, match=r"Did you mean 'front'.*front, top") as e:
        Renderer(model, camera="frnt", backend="raycast")
    assert isinstance(e.value, AgymError)
    with pytest.raises(render.UnknownCameraError, match="'7'"):
        Renderer(model, camera=7, backend="raycast")


def test_free_camera_sees_the_scene():
    model, data = scene()
    assert blue(shot(model, data, camera=-1)).any()


def no_library(*_):
    raise render.RenderBackendError("egl: pretended to be missing")


def test_auto_falls_back_to_rays_and_says_once_what_to_install(monkeypatch):
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


def test_gl_that_cannot_be_had_is_an_error_with_the_package(monkeypatch):
    monkeypatch.setattr(render, "_open_context", no_library)
    model, _ = scene()
    with pytest.raises(render.RenderBackendError, match=r"libegl1.*raycast"):
        Renderer(model, backend="gl")


def test_failed_library_leaves_no_trace(monkeypatch):
    def fail():
        raise OSError("no EGL here")

    monkeypatch.setattr(render, "_probe_egl", fail)
    monkeypatch.setenv("MUJOCO_GL", "egl")
    monkeypatch.delenv("PYOPENGL_PLATFORM", raising=False)
    with pytest.raises(render.RenderBackendError, match="egl: no EGL here"):
        render._open_context(8, 8)
    assert "PYOPENGL_PLATFORM" not in render.os.environ


def test_environment_variable_picks_the_backend(monkeypatch):
    model, _ = scene()
    monkeypatch.setenv("AGYM_JAX_RENDER", "raycast")
    assert Renderer(model, 32, 24, backend="gl").backend == "raycast"
    monkeypatch.setenv("AGYM_JAX_RENDER", "raycst")
    with pytest.raises(render.RenderBackendError, match="Did you mean 'raycast'"):
        Renderer(model)


def test_closed_renderer_says_so():
    model, data = scene()
    renderer = Renderer(model, 32, 24, backend="raycast")
    renderer.close()
    renderer.close()
    with pytest.raises(render.RenderBackendError, match="closed"):
        renderer.render(data)


def film(n: int = 7, height: int = 48, width: int = 64) -> list[np.ndarray]:
    frames = np.full((n, height, width, 3), 200, np.uint8)
    for i in range(n):
        frames[i, 10:20, 5 * i : 5 * i + 10] = (250, 20, 20)
    return list(frames)


def test_gif_is_read_back(tmp_path):
    image = pytest.importorskip("PIL.Image")
    frames = film()
    path = clips.write_clip(frames, tmp_path / "new" / "clip.gif", fps=20)
    with image.open(path) as clip:
        assert (clip.n_frames, clip.size, clip.info["duration"]) == (7, (64, 48), 50)
        clip.seek(6)
        last = np.asarray(clip.convert("RGB")).astype(int)
    assert np.abs(last - frames[-1]).mean() < 3


def test_gif_keeps_the_colour_of_small_things(tmp_path):
    image = pytest.importorskip("PIL.Image")
    shades = np.linspace(90, 220, 200 * 200).reshape(200, 200, 1)
    frame = (shades + np.array([0, 3, 9])).astype(np.uint8)
    frame[100:104, 100:104] = (250, 30, 30)
    path = clips.write_clip([frame, frame[::-1]], tmp_path / "clip.gif")
    with image.open(path) as clip:
        read = np.asarray(clip.convert("RGB")).astype(int)
    assert np.abs(read[101, 101] - (250, 30, 30)).max() < 12
    assert np.abs(read - frame).mean() < 4


@pytest.mark.parametrize("size", [(48, 64), (47, 63)])
def test_mp4_is_read_back(tmp_path, size):
    ffmpeg = pytest.importorskip("imageio_ffmpeg")
    frames = film(7, *size)
    path = clips.write_clip(frames, str(tmp_path / "clip.mp4"), fps=10)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ResourceWarning)  # its reader leaves pipes open
        warnings.filterwarnings("ignore", r"os\.fork", RuntimeWarning)
        reader = ffmpeg.read_frames(str(path))
        about = next(reader)
        pictures = [np.frombuffer(raw, np.uint8).reshape(48, 64, 3) for raw in reader]
        reader.close()
        del reader
        gc.collect()
    assert about["size"] == (64, 48) and about["fps"] == 10
    assert len(pictures) == 7
    close = pictures[-1][: size[0], : size[1]].astype(int) - frames[-1]
    assert np.abs(close).mean() < 10


def test_mp4_without_the_extra_says_what_to_install(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    with pytest.raises(clips.MissingExtraError, match=r'gif.*pip install "agym_jax\[train\]"'):
        clips.write_clip(film(), tmp_path / "clip.mp4")


def test_contact_sheet_is_read_back(tmp_path):
    image = pytest.importorskip("PIL.Image")
    frames = film()
    path = clips.contact_sheet(frames, tmp_path / "sheet.png", columns=3, labels=list("abcdefg"))
    with image.open(path) as sheet:
        assert sheet.size == (3 * 68 + 4, 3 * (48 + 20) + 4)
        third = np.asarray(sheet)[20 : 20 + 48, 4 + 2 * 68 : 4 + 2 * 68 + 64]
    np.testing.assert_array_equal(third, frames[2])
    sparse = clips.contact_sheet(frames, tmp_path / "sparse.png", every=3)
    with image.open(sparse) as sheet:
        assert sheet.size == (3 * 68 + 4, 48 + 20 + 4)


@pytest.mark.parametrize("write", [clips.write_clip, clips.contact_sheet])
def test_unwritable_folder_is_refused_before_any_work(tmp_path, write):
    (tmp_path / "file").write_text("not a folder")
    suffix = ".gif" if write is clips.write_clip else ".png"
    never_read = iter(())  # the frames would fail too, later
    with pytest.raises(clips.OutputPathError, match="not writable"):
        write(never_read, tmp_path / "file" / f"clip{suffix}")
    with pytest.raises(clips.OutputPathError, match="it is a folder"):
        (tmp_path / f"is{suffix}").mkdir()
        write(never_read, tmp_path / f"is{suffix}")


def test_unknown_suffix_names_the_known(tmp_path):
    with pytest.raises(clips.OutputPathError, match=r"'.mp5'.*Did you mean '.mp4'.*\.gif, \.mp4"):
        clips.write_clip(film(), tmp_path / "clip.mp5")


@pytest.mark.parametrize(
    ("frames", "said"),
    [
        ([], "No frames"),
        ([np.zeros((4, 4, 3))], "float64"),
        ([*film(2), np.zeros((4, 4, 3), np.uint8)], "Frame 2"),
    ],
)
def test_bad_frames_are_refused(tmp_path, frames, said):
    with pytest.raises(AgymError, match=said):
        clips.write_clip(frames, tmp_path / "clip.gif")
