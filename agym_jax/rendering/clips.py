"""Videos (.gif, .mp4) and contact sheets (.png) from frames.

A wrong suffix, an unwritable folder or a missing package is reported before anything is encoded.
"""

from __future__ import annotations

import contextlib
import importlib
import math
import os
import tempfile
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from agym_jax.errors import AgymError, MissingExtraError, did_you_mean

__all__ = ["FrameError", "MissingExtraError", "OutputPathError", "contact_sheet", "write_clip"]


class OutputPathError(AgymError, OSError):
    """A file that cannot be written: its folder, its name or its suffix."""


class FrameError(AgymError, ValueError):
    """No frames, or frames that are not uint8 images of one size."""


def _check_frames(frames: Sequence[np.ndarray]) -> list[np.ndarray]:
    """The frames as a list; raises FrameError."""
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
    """The path, whose folder is created if needed; raises OutputPathError if it cannot be written."""
    path = Path(path)
    if path.suffix.lower() not in suffixes:
        near = did_you_mean(path.suffix.lower(), suffixes)
        raise OutputPathError(f"Cannot write {path}: unknown suffix {path.suffix!r}. {near}")
    if path.is_dir():
        raise OutputPathError(f"Cannot write {path}: it is a folder.")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        tempfile.TemporaryFile(dir=path.parent).close()
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
    """Write a video.

    Args:
        frames: images, uint8 (height, width, 3), all of one size.
        path: ends in .mp4 (needs imageio-ffmpeg) or .gif (needs pillow). The folder is created. An
            mp4 of odd width or height gets one more column or row.
        fps: frames per second [1/s]; a .gif has a time resolution of 10 ms, and stores a run
            of equal frames as one long frame.

    Returns:
        The path.

    Raises:
        OutputPathError: if the suffix is unknown or the folder is not writable.
        MissingExtraError: if the package required for this suffix is not installed.
        FrameError: if there are no frames, or their sizes differ.
    """
    path = _check_path(path, (".gif", ".mp4"))
    frames = _check_frames(frames)
    if path.suffix.lower() == ".gif":
        _write_gif(frames, path, fps)
        return path
    ffmpeg = _import_extra("imageio_ffmpeg", "Write a .gif instead, or: ")
    height, width, _ = frames[0].shape
    pad = ((0, height % 2), (0, width % 2), (0, 0))  # yuv420p needs even sizes
    writer = ffmpeg.write_frames(
        str(path), (width + width % 2, height + height % 2), fps=fps, quality=8, macro_block_size=2
    )
    with warnings.catch_warnings():
        # JAX warns about forks in a process with threads, but this one is replaced by ffmpeg immediately.
        warnings.filterwarnings("ignore", r"os\.fork", RuntimeWarning)
        writer.send(None)
    with contextlib.closing(writer):
        for frame in frames:
            writer.send(np.ascontiguousarray(np.pad(frame, pad, mode="edge")))
    return path


def _write_gif(frames: list[np.ndarray], path: Path, fps: float) -> None:
    """Write a .gif with one palette for all frames and no dithering, so that static pixels compress well.

    Colours are weighted by the square root of their frequency; otherwise the shades of a large
    floor would take all entries of the palette, and a small red target would turn brown.
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


def evenly(count: int, most: int) -> list[int]:
    """Return at most ``most`` indices spread evenly over ``count`` frames, including the first and the last."""
    return np.linspace(0, count - 1, min(count, most)).round().astype(int).tolist()


def contact_sheet(
    frames: Sequence[np.ndarray],
    path: str | os.PathLike[str],
    columns: int = 5,
    every: int | None = None,
    labels: Sequence[str] | None = None,
) -> Path:
    """Write a grid of captioned frames: an overview of an episode.

    Args:
        frames: images, uint8 (height, width, 3), all of one size.
        path: ends in .png.
        columns: frames per row.
        every: stride between frames; None spreads four rows evenly from the first frame to the last.
        labels: captions of ``frames``; None numbers them.

    Returns:
        The path.
    """
    path = _check_path(path, (".png",))
    frames = _check_frames(frames)
    if labels is not None and len(labels) != len(frames):
        raise FrameError(f"There are {len(frames)} frames but {len(labels)} labels.")
    image, pen = _import_extra("PIL.Image", ""), _import_extra("PIL.ImageDraw", "")
    picks = range(0, len(frames), every) if every else evenly(len(frames), 4 * columns)
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
