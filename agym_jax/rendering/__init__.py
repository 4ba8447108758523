"""Images and videos of a scene, with OpenGL or without.

``from agym_jax.rendering import Renderer`` is all that most callers need. Names are imported at first use.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from agym_jax.rendering.clips import contact_sheet, write_clip
    from agym_jax.rendering.raycast import Marker
    from agym_jax.rendering.render import (
        RenderBackendError,
        Renderer,
        RenderFallbackWarning,
        UnknownCameraError,
    )

__all__ = [
    "Marker",
    "RenderBackendError",
    "RenderFallbackWarning",
    "Renderer",
    "UnknownCameraError",
    "contact_sheet",
    "write_clip",
]

_MODULES = {"Marker": "raycast", "contact_sheet": "clips", "write_clip": "clips"}


def __getattr__(name: str) -> Any:
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    module = importlib.import_module(f"{__name__}.{_MODULES.get(name, 'render')}")
    return getattr(module, name)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
