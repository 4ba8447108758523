"""Pictures and clips of a scene, with OpenGL where there is one and without it where not.

``Renderer`` opens its own OpenGL context (EGL, then OSMesa, then GLFW) instead of leaving that
to ``import mujoco``, which reads ``MUJOCO_GL`` once and too early for anyone to change it.
Where none opens, it says which system package is missing and casts rays instead.
"""

from __future__ import annotations

import contextlib
import ctypes
import importlib
import math
import os
import platform
import sys
import tempfile
import warnings
import weakref
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Protocol

import mujoco
import numpy as np

from agym_jax import raycast
from agym_jax.errors import AgymError, UnknownNameError, did_you_mean
from agym_jax.raycast import Marker

__all__ = [
    "Marker",
    "MissingExtraError",
    "OutputPathError",
    "RenderBackendError",
    "RenderFallbackWarning",
    "Renderer",
    "UnknownCameraError",
    "contact_sheet",
    "write_clip",
]

BACKENDS = ("auto", "gl", "raycast")
OFF = ("disable", "disabled", "off", "false", "0")  # values of MUJOCO_GL that forbid OpenGL
INSTALL_GL = (
    "on Debian or Ubuntu: apt-get install libegl1 libopengl0 libgl1-mesa-dri "
    "(or libosmesa6 where EGL cannot be had)"
)


class UnknownCameraError(UnknownNameError):
    """A camera that the model does not have."""


class MissingExtraError(AgymError, ImportError):
    """An optional Python package that this needs is not installed."""


class OutputPathError(AgymError, OSError):
    """A file that cannot be written: its folder, its name or its suffix."""


class RenderBackendError(AgymError, RuntimeError):
    """A way to draw that does not exist or cannot run here."""


class FrameError(AgymError, ValueError):
    """Frames that are none, or are not uint8 pictures of one size."""


class RenderFallbackWarning(UserWarning):
    """OpenGL could not be opened, so the ray caster draws."""


class _Pictures(Protocol):
    def draw(
        self, data: mujoco.MjData, view: mujoco.MjvScene, markers: Sequence[Marker]
    ) -> np.ndarray: ...

    def close(self) -> None: ...


class _Process:
    """What is true of the whole process, not of one renderer."""

    gl_failed: str | None = None  # MuJoCo aborts the process when it loads OpenGL a second time
    warned = False


def _gl_libraries() -> tuple[str, ...]:
    """Names under ``mujoco`` of the context makers to try, best first."""
    asked = os.environ.get("MUJOCO_GL", "").lower().strip()
    if asked in OFF:
        return ()
    if asked in ("egl", "osmesa", "glfw", "cgl"):
        return (asked,)
    system = platform.system()
    if system == "Darwin":
        return ("cgl", "glfw")
    if system != "Linux":
        return ("glfw",)
    on_screen = os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
    return ("egl", "osmesa", "glfw") if on_screen else ("egl", "osmesa")


def _probe_egl() -> None:
    """Raise where EGL has no device, without loading it for all to see.

    Once PyOpenGL has loaded EGL globally, MuJoCo asks EGL for its functions, and OSMesa is lost.
    """
    egl = ctypes.CDLL("libEGL.so.1")
    egl.eglGetProcAddress.restype = ctypes.c_void_p
    address = egl.eglGetProcAddress(b"eglQueryDevicesEXT")
    count = ctypes.c_int(0)
    if address:
        ask = ctypes.CFUNCTYPE(ctypes.c_uint, ctypes.c_int, ctypes.c_void_p, ctypes.c_void_p)
        ask(address)(0, None, ctypes.byref(count))
    if not count.value:
        raise RuntimeError("it found no device and no software driver")


def _open_library(name: str, width: int, height: int) -> Any:
    """A current OpenGL context of one library, or an exception and no trace of the attempt.

    ``mujoco.egl`` and ``mujoco.osmesa`` each tell PyOpenGL which library to use when it is first
    imported, so a failed attempt must be forgotten before the next one can succeed.
    """
    before = set(sys.modules)
    platform_before = os.environ.get("PYOPENGL_PLATFORM")
    try:
        if name == "egl":
            _probe_egl()
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            context = importlib.import_module(f"mujoco.{name}").GLContext(width, height)
            if not getattr(context, "_context", True):
                raise RuntimeError("it gave no context")
            context.make_current()
    except Exception:
        for module in set(sys.modules) - before:
            if module.split(".")[0] == "OpenGL" or module.startswith(f"mujoco.{name}"):
                del sys.modules[module]
        if platform_before is None:
            os.environ.pop("PYOPENGL_PLATFORM", None)
        raise
    return context


def _open_context(width: int, height: int) -> tuple[Any, str]:
    """The first OpenGL context that opens, and its library's name.

    Raises:
        RenderBackendError: none opened; says why for each.
    """
    if _Process.gl_failed:
        raise RenderBackendError(_Process.gl_failed)
    reasons = []
    for name in _gl_libraries():
        try:
            return _open_library(name, width, height), name
        except Exception as error:  # each library fails in its own way
            missing = isinstance(error, (AttributeError, ctypes.ArgumentError))  # PyOpenGL's way
            said = "a library it needs is missing" if missing else str(error) or repr(error)
            reasons.append(f"{name}: {said.strip().splitlines()[0][:90]}")
    raise RenderBackendError("; ".join(reasons) or "MUJOCO_GL forbids it")


class _GLPictures:
    """OpenGL through MuJoCo's classic renderer."""

    def __init__(self, model: mujoco.MjModel, width: int, height: int):
        self._gl, self.library = _open_context(width, height)
        try:
            self._context = mujoco.MjrContext(model, mujoco.mjtFontScale.mjFONTSCALE_100)
        except Exception as error:
            _Process.gl_failed = f"{self.library}: {error}"
            self._gl.free()
            raise RenderBackendError(_Process.gl_failed) from error
        mujoco.mjr_resizeOffscreen(width, height, self._context)
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN, self._context)
        self._rect = mujoco.MjrRect(0, 0, width, height)

    def draw(
        self, data: mujoco.MjData, view: mujoco.MjvScene, markers: Sequence[Marker]
    ) -> np.ndarray:
        for marker in markers:
            mujoco.mjv_initGeom(
                view.geoms[view.ngeom],
                mujoco.mjtGeom.mjGEOM_SPHERE,
                np.full(3, marker.radius, dtype=float),
                np.asarray(marker.pos, dtype=float),
                np.eye(3).reshape(-1),
                np.asarray(marker.rgba, dtype=np.float32),
            )
            view.ngeom += 1
        self._gl.make_current()
        mujoco.mjr_render(self._rect, view, self._context)
        out = np.empty((self._rect.height, self._rect.width, 3), np.uint8)
        mujoco.mjr_readPixels(out, None, self._rect, self._context)
        return out[::-1].copy()

    def close(self) -> None:
        with contextlib.suppress(Exception):  # at exit the library may be gone already
            self._gl.make_current()
            self._context.free()
            self._gl.free()


class _RaycastPictures:
    """``agym_jax.raycast``."""

    def __init__(self, model: mujoco.MjModel, width: int, height: int):
        self._model, self._size = model, (width, height)

    def draw(
        self, data: mujoco.MjData, view: mujoco.MjvScene, markers: Sequence[Marker]
    ) -> np.ndarray:
        return raycast.draw(raycast.build_scene(self._model, data, view, markers), *self._size)

    def close(self) -> None:
        """Nothing to free."""


def _pick(model: mujoco.MjModel, width: int, height: int, asked: str) -> tuple[str, _Pictures]:
    """The backend's name and the backend; warns once a process when "auto" cannot have OpenGL."""
    asked = os.environ.get("AGYM_JAX_RENDER", "").lower().strip() or asked
    if asked not in BACKENDS:
        near = did_you_mean(asked, BACKENDS)
        raise RenderBackendError(f"Unknown backend {asked!r} (argument or AGYM_JAX_RENDER). {near}")
    if asked != "raycast":
        try:
            return "gl", _GLPictures(model, width, height)
        except RenderBackendError as error:
            why = f"OpenGL could not be opened ({error})"
            if asked == "gl":
                raise RenderBackendError(
                    f"{why}; {INSTALL_GL}. Or use backend='raycast', which needs no library."
                ) from error
        if not _Process.warned:
            _Process.warned = True
            warnings.warn(
                f"{why}, so the built-in ray caster draws: the same scene, but slower and without "
                f"reflections, textured objects and smooth meshes. For those, {INSTALL_GL}. "
                "AGYM_JAX_RENDER=raycast silences this.",
                RenderFallbackWarning,
                stacklevel=3,
            )
    return "raycast", _RaycastPictures(model, width, height)


class Renderer:
    """Draws states of one model from one camera; a context manager.

    Visual geoms (groups 0 to 2) are drawn; collision geoms (group 3 and up) and sites are not.

    Args:
        model: an ordinary MjModel; sizes and colours may be written between pictures.
        width: picture width in pixels.
        height: picture height in pixels.
        camera: a camera's name or number; -1 is MuJoCo's free camera, which sees everything.
        backend: "gl", "raycast", or "auto" for OpenGL if it opens and rays if not. The
            environment variable AGYM_JAX_RENDER overrides this.

    Raises:
        UnknownCameraError: the model has no such camera.
        RenderBackendError: no such backend, or "gl" was asked for and cannot be had.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        width: int = 480,
        height: int = 360,
        camera: str | int = "front",
        backend: str = "auto",
    ):
        self._model = model
        self._camera = _find_camera(model, camera)
        self._option = mujoco.MjvOption()
        self._option.sitegroup[:] = 0
        self._view: mujoco.MjvScene | None = None
        self._room = 0
        self.backend, self._pictures = _pick(model, width, height, backend)
        self._free = weakref.finalize(self, self._pictures.close)

    def render(self, data: mujoco.MjData, markers: Sequence[Marker] = ()) -> np.ndarray:
        """One picture.

        Args:
            data: a state with current kinematics (after ``mj_forward`` or ``mj_kinematics`` and
                ``mj_camlight``).
            markers: extra spheres, drawn this once.

        Returns:
            uint8, (height, width, 3).
        """
        if not self._free.alive:
            raise RenderBackendError("This Renderer was closed; make a new one.")
        if self._view is None or len(markers) > self._room:
            self._room = max(64, 2 * len(markers))
            self._view = mujoco.MjvScene(self._model, self._model.ngeom + 500 + self._room)
        everything = mujoco.mjtCatBit.mjCAT_ALL.value
        mujoco.mjv_updateScene(
            self._model, data, self._option, None, self._camera, everything, self._view
        )
        return self._pictures.draw(data, self._view, markers)

    def close(self) -> None:
        """Free the OpenGL context; twice is fine."""
        self._free()

    def __enter__(self) -> Renderer:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def _find_camera(model: mujoco.MjModel, camera: str | int) -> mujoco.MjvCamera:
    """MuJoCo's camera of that name or number."""
    names = [model.camera(i).name for i in range(model.ncam)]
    number = camera
    if isinstance(camera, str):
        number = names.index(camera) if camera in names else model.ncam
    out = mujoco.MjvCamera()
    if not -1 <= number < model.ncam:
        advice = "-1 is a free camera that sees everything."
        raise UnknownCameraError("camera", str(camera), [n for n in names if n], advice)
    if number == -1:
        mujoco.mjv_defaultFreeCamera(model, out)
    else:
        out.type, out.fixedcamid = mujoco.mjtCamera.mjCAMERA_FIXED, number
    return out


def _check_frames(frames: Sequence[np.ndarray]) -> list[np.ndarray]:
    """The frames as a list, or FrameError."""
    frames = [np.asarray(frame) for frame in frames]
    if not frames:
        raise FrameError("No frames to write.")
    for i, frame in enumerate(frames):
        shape, kind = frame.shape, frame.dtype
        if len(shape) != 3 or shape[2] != 3 or kind != np.uint8 or shape != frames[0].shape:
            raise FrameError(
                f"Frame {i} is {kind} of shape {shape}; all must be uint8 (height, width, 3) "
                f"of one size, and frame 0 has shape {frames[0].shape}."
            )
    return frames


def _check_path(path: str | os.PathLike[str], suffixes: Sequence[str]) -> Path:
    """A path that can be written, its folder made, or OutputPathError."""
    path = Path(path)
    if path.suffix.lower() not in suffixes:
        near = did_you_mean(path.suffix.lower(), suffixes)
        raise OutputPathError(f"Cannot write {path}: unknown suffix {path.suffix!r}. {near}")
    if path.is_dir():
        raise OutputPathError(f"Cannot write {path}: it is a folder.")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=path.parent):
            pass
    except OSError as error:
        raise OutputPathError(
            f"Cannot write {path}: its folder {path.parent} is not writable ({error.strerror})."
        ) from error
    return path


def _import_extra(module: str, advice: str) -> Any:
    try:
        return importlib.import_module(module)
    except ImportError as error:
        raise MissingExtraError(
            f'{module} is not installed. {advice}pip install "agym_jax[train]"'
        ) from error


def write_clip(frames: Sequence[np.ndarray], path: str | os.PathLike[str], fps: float = 10) -> Path:
    """Write a film.

    Args:
        frames: pictures, uint8 (height, width, 3), all of one size.
        path: ends in .mp4 (needs imageio-ffmpeg) or .gif (needs pillow). The folder is made. An
            mp4 of odd width or height gets one more column or row.
        fps: frames a second [1/s]; a .gif keeps time in hundredths of a second, and stores a run
            of equal frames as one long frame.

    Returns:
        The path.

    Raises:
        OutputPathError: unknown suffix or unwritable folder, before anything is encoded.
        MissingExtraError: the package that this suffix needs is missing.
        FrameError: no frames, or not of one size.
    """
    path = _check_path(path, (".gif", ".mp4"))
    frames = _check_frames(frames)
    if path.suffix.lower() == ".gif":
        _write_gif(frames, path, fps)
        return path
    ffmpeg = _import_extra("imageio_ffmpeg", "Write a .gif instead, or: ")
    height, width, _ = frames[0].shape
    pad = ((0, height % 2), (0, width % 2), (0, 0))  # yuv420p halves both
    writer = ffmpeg.write_frames(
        str(path), (width + width % 2, height + height % 2), fps=fps, quality=8, macro_block_size=2
    )
    writer.send(None)
    with contextlib.closing(writer):
        for frame in frames:
            writer.send(np.ascontiguousarray(np.pad(frame, pad, mode="edge")))
    return path


def _write_gif(frames: list[np.ndarray], path: Path, fps: float) -> None:
    """One palette for all frames and no dithering, so that what does not move costs nothing.

    The palette is cut from the root of each colour's frequency; otherwise the shades of a large
    floor would take every entry, and a small red target would turn brown.
    """
    image = _import_extra("PIL.Image", "")
    picks = frames[:: max(1, math.ceil(len(frames) / 12))]
    coarse = np.concatenate([frame.reshape(-1, 3) for frame in picks]) >> 2
    colors, counts = np.unique(coarse @ (4096, 64, 1), return_counts=True)
    pool = np.repeat(colors, np.ceil(np.sqrt(counts)).astype(int))
    pool = np.stack([pool >> 12, (pool >> 6) & 63, pool & 63], axis=-1).astype(np.uint8)
    pool = image.fromarray((pool << 2 | pool >> 4)[None])
    palette = pool.quantize(colors=255, method=image.Quantize.MEDIANCUT, kmeans=1)
    indexed = [
        image.fromarray(frame).quantize(palette=palette, dither=image.Dither.NONE)
        for frame in frames
    ]
    indexed[0].save(
        path, save_all=True, append_images=indexed[1:], duration=round(1000 / fps), loop=0
    )


def contact_sheet(
    frames: Sequence[np.ndarray],
    path: str | os.PathLike[str],
    columns: int = 5,
    every: int | None = None,
    labels: Sequence[str] | None = None,
) -> Path:
    """Write a grid of captioned frames, to look at an episode at once.

    Args:
        frames: pictures, uint8 (height, width, 3), all of one size.
        path: ends in .png.
        columns: pictures in a row.
        every: take every so many frames; None takes at most four rows of them.
        labels: a caption for each of ``frames``; None numbers them.

    Returns:
        The path.
    """
    path = _check_path(path, (".png",))
    frames = _check_frames(frames)
    if labels is not None and len(labels) != len(frames):
        raise FrameError(f"There are {len(frames)} frames but {len(labels)} labels.")
    image, pen = _import_extra("PIL.Image", ""), _import_extra("PIL.ImageDraw", "")
    every = every or max(1, math.ceil(len(frames) / (4 * columns)))
    picks = range(0, len(frames), every)
    height, width, _ = frames[0].shape
    caption, gap = 16, 4
    columns = min(columns, len(picks))
    rows = math.ceil(len(picks) / columns)
    sheet = image.new(
        "RGB",
        (columns * (width + gap) + gap, rows * (height + caption + gap) + gap),
        (250, 250, 250),
    )
    draw = pen.Draw(sheet)
    for place, i in enumerate(picks):
        x = gap + (place % columns) * (width + gap)
        y = gap + (place // columns) * (height + caption + gap)
        draw.text((x + 2, y + 2), str(labels[i]) if labels is not None else f"{i}", (40, 40, 40))
        sheet.paste(image.fromarray(frames[i]), (x, y + caption))
    sheet.save(path)
    return path
