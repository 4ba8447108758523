"""Where the packaged data lies: MJCF, placement banks, weights, policies."""

from __future__ import annotations

from functools import cache
from pathlib import Path

from agym_jax.errors import MissingAssetError, did_you_mean


@cache
def asset_root() -> Path:
    """Folder of the assets: inside the installed wheel, or at the top of a checkout."""
    package = Path(__file__).resolve().parent.parent
    for root in (package / "assets", package.parent / "assets"):
        if root.is_dir():
            return root
    raise MissingAssetError(
        f"agym_jax is installed without its assets (looked beside {package}). Reinstall it."
    )


def asset_path(name: str) -> Path:
    """Full path of one asset, such as ``"robots/jaco.xml"``, or of any file by its absolute path.

    Raises:
        MissingAssetError: there is no such file; the message lists the nearest ones.
    """
    path = asset_root() / name  # an absolute path stays as it is
    if path.is_file():
        return path
    folder = path.parent
    if not folder.is_dir():
        known = next(p for p in folder.parents if p.is_dir())
        missing = folder.relative_to(known).parts[0]
        near = did_you_mean(missing, [p.name for p in known.iterdir() if p.is_dir()])
        hint = f"The folder {known} has no folder {missing!r}. {near}"
    else:
        files = [p.name for p in folder.iterdir() if p.is_file()]
        same = [x for x in files if x.endswith(path.suffix)]
        hint = f"The folder {folder} is there. {did_you_mean(path.name, same or files)}"
    if Path(name).is_absolute():
        raise MissingAssetError(f"No file {name!r}. {hint}")
    own = Path(name).absolute()
    hint += (
        f" {own} is there: give that absolute path." if own.is_file() else
        " A relative path is one of the package's assets; give a file of your own by its absolute path, "
        f"such as str(Path(__file__).parent / {path.name!r})."
    )  # fmt: skip
    raise MissingAssetError(f"No asset {name!r}. {hint}")
