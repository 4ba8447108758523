"""Images of a scene, by OpenGL where it is available and by a built-in ray caster otherwise.

``Renderer`` opens its own OpenGL context (EGL, then OSMesa, then GLFW) instead of leaving that
to ``import mujoco``, which reads ``MUJOCO_GL`` only once, on import.
If none opens, it warns which system package is missing and uses the ray caster.
"""

from __future__ import annotations

import contextlib
import ctypes
import importlib
import os
import platform
import sys
import warnings
import weakref
from collections.abc import Sequence
from typing import Any, Protocol

import mujoco
import numpy as np

from agym_jax.errors import AgymError, UnknownNameError, checked_count, did_you_mean
from agym_jax.rendering import shading
from agym_jax.rendering.quality import with_quality
from agym_jax.rendering.raycast import Marker

__all__ = [
    "Marker",
    "RenderBackendError",
    "RenderFallbackWarning",
    "Renderer",
    "UnknownCameraError",
    "add_markers",
]

BACKENDS = ("auto", "gl", "raycast")
OFF = ("disable", "disabled", "off", "false", "0")  # values of MUJOCO_GL that disable OpenGL
INSTALL_GL = (
    "on Debian or Ubuntu: apt-get install libegl1 libopengl0 libgl1-mesa-dri "
    "(or libosmesa6 where EGL is not available)"
)


class UnknownCameraError(UnknownNameError):
    """A camera that the model does not have."""


class RenderBackendError(AgymError, RuntimeError):
    """A rendering backend that does not exist, or is not available on this machine."""


class RenderFallbackWarning(UserWarning):
    """OpenGL is not available, so the ray caster is used."""


class _Backend(Protocol):
    def draw(
        self, data: mujoco.MjData, view: mujoco.MjvScene, markers: Sequence[Marker]
    ) -> np.ndarray: ...

    def close(self) -> None: ...


class _Process:
    """State of the process, shared by all renderers."""

    gl_failed: str | None = None  # MuJoCo aborts the process when it loads OpenGL a second time
    warned = False


def _gl_libraries() -> tuple[str, ...]:
    """Names of the modules of ``mujoco`` that open a context, in the order in which they are tried."""
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
    """Raise if EGL has no device, without loading EGL globally.

    Once PyOpenGL has loaded EGL globally, MuJoCo takes its functions from EGL, and OSMesa can no longer be used.
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
    """Open an OpenGL context of one library and make it current; a failed attempt is undone.

    ``mujoco.egl`` and ``mujoco.osmesa`` each tell PyOpenGL which library to use when it is first
    imported, so a failed attempt has to be undone before the next one can succeed.
    """
    before = set(sys.modules)
    platform_before = os.environ.get("PYOPENGL_PLATFORM")

    def undo() -> None:
        for module in set(sys.modules) - before:
            if module.split(".")[0] == "OpenGL" or module.startswith(f"mujoco.{name}"):
                del sys.modules[module]
        if platform_before is None:
            os.environ.pop("PYOPENGL_PLATFORM", None)

    with contextlib.ExitStack() as on_failure:
        on_failure.callback(undo)
        if name == "egl":
            _probe_egl()
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            context = importlib.import_module(f"mujoco.{name}").GLContext(width, height)
            if not getattr(context, "_context", True):
                raise RuntimeError("it returned no context")
            context.make_current()
        on_failure.pop_all()  # it works: nothing to undo
    return context


def _open_context(width: int, height: int) -> tuple[Any, str]:
    """Open the first OpenGL context that works; return it and the name of its library.

    Raises:
        RenderBackendError: if none could be opened; the message gives the reason for each.
    """
    if _Process.gl_failed:
        raise RenderBackendError(_Process.gl_failed)
    reasons = []
    for name in _gl_libraries():
        try:
            return _open_library(name, width, height), name
        except Exception as error:  # each library fails in its own way
            missing = isinstance(
                error, (AttributeError, ctypes.ArgumentError)
            )  # raised by PyOpenGL
            said = "a library it needs is missing" if missing else str(error) or repr(error)
            reasons.append(f"{name}: {said.strip().splitlines()[0][:90]}")
    raise RenderBackendError("; ".join(reasons) or "MUJOCO_GL disables it")


def add_markers(scene: mujoco.MjvScene, markers: Sequence[Marker]) -> None:
    """Add spheres to a scene of MuJoCo, as many as it has room for."""
    for marker in markers[: scene.maxgeom - scene.ngeom]:
        mujoco.mjv_initGeom(
            scene.geoms[scene.ngeom],
            mujoco.mjtGeom.mjGEOM_SPHERE,
            np.full(3, marker.radius, dtype=float),
            np.asarray(marker.pos, dtype=float),
            np.eye(3).reshape(-1),
            np.asarray(marker.rgba, dtype=np.float32),
        )
        scene.ngeom += 1


class _GLBackend:
    """OpenGL through MuJoCo's classic renderer."""

    def __init__(self, model: mujoco.MjModel, width: int, height: int):
        self._gl, self.library = _open_context(width, height)
        try:
            fitting = with_quality(model, width, height)
            self._context = mujoco.MjrContext(fitting, mujoco.mjtFontScale.mjFONTSCALE_100)
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
        add_markers(view, markers)
        self._gl.make_current()
        mujoco.mjr_render(self._rect, view, self._context)
        out = np.empty((self._rect.height, self._rect.width, 3), np.uint8)
        mujoco.mjr_readPixels(out, None, self._rect, self._context)
        return out[::-1].copy()

    def close(self) -> None:
        with contextlib.suppress(Exception):  # at exit the library may be unloaded already
            self._gl.make_current()
            self._context.free()
            self._gl.free()
        self._gl._context = None  # else MuJoCo frees it again during interpreter shutdown


class _RaycastBackend:
    """The ray caster of ``agym_jax.rendering.shading``."""

    def __init__(self, model: mujoco.MjModel, width: int, height: int):
        self._model, self._size = model, (width, height)

    def draw(
        self, data: mujoco.MjData, view: mujoco.MjvScene, markers: Sequence[Marker]
    ) -> np.ndarray:
        scene = shading.build_shaded_scene(self._model, data, view, markers)
        return shading.draw(scene, *self._size)

    def close(self) -> None:
        """The ray caster holds no resources."""


def check_backend(name: str) -> None:
    """Reject a backend that does not exist.

    Raises:
        RenderBackendError: if there is no such backend; the message suggests the closest match.
    """
    if name not in BACKENDS:
        near = did_you_mean(name, BACKENDS)
        raise RenderBackendError(f"Unknown backend {name!r} (argument or AGYM_JAX_RENDER). {near}")


def _open_backend(
    model: mujoco.MjModel, width: int, height: int, asked: str
) -> tuple[str, _Backend]:
    """Name of the backend and the backend; warns once per process if "auto" cannot use OpenGL."""
    asked = os.environ.get("AGYM_JAX_RENDER", "").lower().strip() or asked
    check_backend(asked)
    if asked != "raycast":
        try:
            return "gl", _GLBackend(model, width, height)
        except RenderBackendError as error:
            why = f"OpenGL is not available ({error})"
            if asked == "gl":
                raise RenderBackendError(
                    f"{why}; {INSTALL_GL}. Or use backend='raycast', which needs no library."
                ) from error
        if not _Process.warned:
            _Process.warned = True
            warnings.warn(
                f"{why}, so the built-in ray caster is used: the same scene, but slower and without "
                f"reflections, textured objects and smooth meshes. For those, {INSTALL_GL}. "
                "AGYM_JAX_RENDER=raycast silences this warning.",
                RenderFallbackWarning,
                stacklevel=3,
            )
    return "raycast", _RaycastBackend(model, width, height)


class Renderer:
    """Renders states of one model from one camera; a context manager.

    Visual geoms (groups 0 to 2) are drawn; collision geoms (group 3 and up) and sites are not.

    Args:
        model: an MjModel; sizes and colours may be written between images.
        width: image width in pixels.
        height: image height in pixels.
        camera: name or id of a camera; -1 is MuJoCo's free camera, which shows the whole scene.
        backend: "gl", "raycast", or "auto" for OpenGL if it is available and the ray caster if not. The
            environment variable AGYM_JAX_RENDER overrides this.

    Raises:
        UnknownCameraError: if the model has no such camera.
        RenderBackendError: if the backend is unknown, or "gl" is not available.
        ArgumentError: if the width or height is not positive.
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
        checked_count("width", width)
        checked_count("height", height)
        self._camera = camera_of(model, camera)
        self._option = mujoco.MjvOption()
        self._option.sitegroup[:] = 0
        self._view: mujoco.MjvScene | None = None
        self._max_markers = 0
        self.backend, self._backend = _open_backend(model, width, height, backend)
        self._free = weakref.finalize(self, self._backend.close)

    def render(self, data: mujoco.MjData, markers: Sequence[Marker] = ()) -> np.ndarray:
        """Render an image.

        Args:
            data: a state with current kinematics (after ``mj_forward`` or ``mj_kinematics`` and
                ``mj_camlight``).
            markers: extra spheres in this image.

        Returns:
            uint8, (height, width, 3).
        """
        if not self._free.alive:
            raise RenderBackendError("This Renderer was closed; create a new one.")
        if self._view is None or len(markers) > self._max_markers:
            self._max_markers = max(64, 2 * len(markers))
            self._view = mujoco.MjvScene(self._model, self._model.ngeom + 500 + self._max_markers)
        everything = mujoco.mjtCatBit.mjCAT_ALL.value
        mujoco.mjv_updateScene(
            self._model, data, self._option, None, self._camera, everything, self._view
        )
        return self._backend.draw(data, self._view, markers)

    def close(self) -> None:
        """Free the OpenGL context. This may be called more than once."""
        self._free()

    def __enter__(self) -> Renderer:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def camera_of(model: mujoco.MjModel, camera: str | int) -> mujoco.MjvCamera:
    """Return the MuJoCo camera with a given name or id.

    Args:
        model: model that has the camera.
        camera: name of the camera, or its number, which may be given as text; -1 is a free camera.

    Raises:
        UnknownCameraError: if the model has no such camera.
    """
    names = [model.camera(i).name for i in range(model.ncam)]
    if isinstance(camera, str) and camera not in names and camera.lstrip("-").isdigit():
        camera = int(camera)
    if not isinstance(camera, int):
        number = names.index(camera) if camera in names else model.ncam
    else:
        number = camera
    out = mujoco.MjvCamera()
    if not -1 <= number < model.ncam:
        advice = "-1 is a free camera that shows the whole scene."
        raise UnknownCameraError("camera", str(camera), [n for n in names if n], advice)
    if number == -1:
        mujoco.mjv_defaultFreeCamera(model, out)
    else:
        out.type, out.fixedcamid = mujoco.mjtCamera.mjCAMERA_FIXED, number
    return out
