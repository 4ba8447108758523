"""Where the packaged data lies: MJCF, placement banks, weights, policies."""

from __future__ import annotations

from functools import cache
from pathlib import Path

from agym_jax.errors import MissingAssetError, did_you_mean


@cache
def asset_root() -> Path:
    """Folder of the assets: inside the installed wheel, or at the top of a checkout."""
    package = Path(__file__).resolve().parent
    for root in (package / "assets", package.parent / "assets"):
        if root.is_dir():
            return root
    raise MissingAssetError(
        f"agym_jax is installed without its assets (looked beside {package}). Reinstall it."
    )


def asset_path(name: str) -> Path:
    """Full path of one asset, such as ``"robots/jaco.xml"``.

    Raises:
        MissingAssetError: there is no such file; the message lists the nearest ones.
    """
    path = asset_root() / name
    if not path.is_file():
        folder = path.parent
        existing = sorted(p.name for p in folder.glob("*")) if folder.is_dir() else []
        hint = did_you_mean(path.name, existing)
        raise MissingAssetError(f"No asset {name!r}. {hint}")
    return path
