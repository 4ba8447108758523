# ruff: noqa: D103
"""Films and contact sheets: what is written is read back, and what cannot be is refused first."""

import gc
import sys
import warnings

import imageio_ffmpeg
import numpy as np
import pytest
from PIL import Image

from agym_jax.errors import AgymError
from agym_jax.rendering import clips


def film(n: int = 7, height: int = 48, width: int = 64) -> list[np.ndarray]:
    frames = np.full((n, height, width, 3), 200, np.uint8)
    for i in range(n):
        frames[i, 10:20, 5 * i : 5 * i + 10] = (250, 20, 20)
    return list(frames)


def test_gif_round_trip(tmp_path):
    frames = film()
    path = clips.write_clip(frames, tmp_path / "new" / "clip.gif", fps=20)
    with Image.open(path) as clip:
        assert (clip.n_frames, clip.size, clip.info["duration"]) == (7, (64, 48), 50)
        clip.seek(6)
        last = np.asarray(clip.convert("RGB")).astype(int)
    assert np.abs(last - frames[-1]).mean() < 3


def test_gif_preserves_the_colour_of_small_objects(tmp_path):
    shades = np.linspace(90, 220, 200 * 200).reshape(200, 200, 1)
    frame = (shades + np.array([0, 3, 9])).astype(np.uint8)
    frame[100:104, 100:104] = (250, 30, 30)
    path = clips.write_clip([frame, frame[::-1]], tmp_path / "clip.gif")
    with Image.open(path) as clip:
        read = np.asarray(clip.convert("RGB")).astype(int)
    assert np.abs(read[101, 101] - (250, 30, 30)).max() < 12
    assert np.abs(read - frame).mean() < 4


@pytest.mark.parametrize("size", [(48, 64), (47, 63)])
def test_mp4_round_trip(tmp_path, size):
    frames = film(7, *size)
    path = clips.write_clip(frames, str(tmp_path / "clip.mp4"), fps=10)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ResourceWarning)  # its reader leaves pipes open
        warnings.filterwarnings("ignore", r"os\.fork", RuntimeWarning)
        reader = imageio_ffmpeg.read_frames(str(path))
        about = next(reader)
        pictures = [np.frombuffer(raw, np.uint8).reshape(48, 64, 3) for raw in reader]
        reader.close()
        del reader
        gc.collect()
    assert about["size"] == (64, 48) and about["fps"] == 10
    assert len(pictures) == 7
    close = pictures[-1][: size[0], : size[1]].astype(int) - frames[-1]
    assert np.abs(close).mean() < 10


def test_mp4_without_the_extra_names_the_package(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    with pytest.raises(clips.MissingExtraError, match=r'gif.*pip install "agym_jax\[train\]"'):
        clips.write_clip(film(), tmp_path / "clip.mp4")


def test_contact_sheet_round_trip(tmp_path):
    frames = film()
    path = clips.contact_sheet(frames, tmp_path / "sheet.png", columns=3, labels=list("abcdefg"))
    with Image.open(path) as sheet:
        assert sheet.size == (3 * 68 + 4, 3 * (48 + 20) + 4)
        third = np.asarray(sheet)[20 : 20 + 48, 4 + 2 * 68 : 4 + 2 * 68 + 64]
    np.testing.assert_array_equal(third, frames[2])
    sparse = clips.contact_sheet(frames, tmp_path / "sparse.png", every=3)
    with Image.open(sparse) as sheet:
        assert sheet.size == (3 * 68 + 4, 48 + 20 + 4)


def test_contact_sheet_is_full_and_shows_the_first_and_the_last_frame(tmp_path):
    frames = [np.full((8, 8, 3), i, np.uint8) for i in range(201)]
    with Image.open(clips.contact_sheet(frames, tmp_path / "sheet.png")) as sheet:
        cells = np.asarray(sheet)[20 :: 8 + 20, 4 :: 8 + 4, 0]
    assert cells.shape == (4, 5) and (cells[0, 0], cells[-1, -1]) == (0, 200)
    strides = np.diff(cells.ravel().astype(int))
    assert set(strides.tolist()) == {10, 11}


@pytest.mark.parametrize(("count", "most"), [(1, 20), (19, 20), (20, 20), (21, 20), (39, 20)])
def test_evenly_chosen_frames_differ_and_include_both_ends(count, most):
    picks = clips.evenly(count, most)
    assert len(set(picks)) == len(picks) == min(count, most)
    assert (picks[0], picks[-1]) == (0, count - 1)


@pytest.mark.parametrize("write", [clips.write_clip, clips.contact_sheet])
def test_unwritable_folder_is_refused_before_encoding(tmp_path, write):
    (tmp_path / "file").write_text("not a folder")
    suffix = ".gif" if write is clips.write_clip else ".png"
    never_read = iter(())  # the frames would fail too, later
    with pytest.raises(clips.OutputPathError, match="not writable"):
        write(never_read, tmp_path / "file" / f"clip{suffix}")
    with pytest.raises(clips.OutputPathError, match="it is a folder"):
        (tmp_path / f"is{suffix}").mkdir()
        write(never_read, tmp_path / f"is{suffix}")


def test_unknown_suffix_lists_known_ones(tmp_path):
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
def test_invalid_frames_are_refused(tmp_path, frames, said):
    with pytest.raises(AgymError, match=said):
        clips.write_clip(frames, tmp_path / "clip.gif")
