# ruff: noqa: D103
"""The viewer in a real browser: headless Chromium, the command line in a process of its own."""

from __future__ import annotations

import io
import re
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import chromium
import numpy as np
import pytest
from chromium import Tab
from paths import ROOT

pytest.importorskip("viser")
pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(chromium.PATH is None, reason="no Chromium"),
    pytest.mark.xdist_group("browser"),
]
ID = "ScratchItchJaco-v0"


def start(*words: str) -> subprocess.Popen:
    return subprocess.Popen(
        [sys.executable, "-m", "agym_jax", "view", *words], cwd=ROOT, text=True, stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
    )  # fmt: skip


@pytest.fixture(scope="module")
def address() -> Iterator[str]:
    """Where a viewer serves its page."""
    with start(ID, "--port", "0") as viewer:
        try:
            said = []
            for line in viewer.stdout:
                said.append(line)
                if "Ready" in line:
                    break
            found = re.search(r"http://127\.0\.0\.1:\d+", "".join(said))
            assert found and "Ready" in said[-1], said
            yield found[0]
        finally:
            viewer.terminate()


@pytest.fixture(scope="module")
def tab(address: str, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Tab]:
    with chromium.chromium(tmp_path_factory.mktemp("browser"), 640, 600) as browse:
        page = browse(address)
        page.reads("Return")
        yield page


def shirt(tab: Tab) -> int:
    """Pixels of the canvas in the colour of the person's shirt."""
    from PIL import Image

    pixels = np.asarray(Image.open(io.BytesIO(tab.canvas())).convert("RGB")).astype(int)
    red, green, blue = np.moveaxis(pixels, 2, 0)
    return int(((blue > red + 30) & (blue > 80) & (abs(blue - green) < 60)).sum())


def wait_for_shirt(tab: Tab) -> None:
    """Somebody can be seen in the picture."""
    chromium.wait(lambda: shirt(tab) > 300, 120, "a shirt in the picture")


def step_of(tab: Tab) -> int:
    found = re.search(r"Step (\d+) of 200", tab.text())
    assert found, tab.text()
    return int(found[1])


def test_the_picture_shows_a_person(tab: Tab):
    wait_for_shirt(tab)


def test_the_episode_plays_and_buttons_pause_step_and_begin_it_again(tab: Tab):
    before = step_of(tab)
    chromium.wait(lambda: step_of(tab) != before, 60, "steps")
    tab.click("Pause")
    tab.reads("paused")
    assert tab.run(tab.button("Play"))
    paused = step_of(tab)
    time.sleep(1.0)
    assert step_of(tab) == paused
    tab.click("Step")
    tab.reads(f"Step {paused + 1} of")
    tab.click("Reset")
    tab.reads("Step 0 of")
    tab.key("ArrowRight", "ArrowRight")
    tab.reads("Step 1 of")
    tab.click("Next person")
    tab.reads("seed 1002")
    tab.reads("Step 0 of")


def test_a_chosen_person_begins_the_episode_again(tab: Tab):
    tab.click("Step")
    tab.reads("Step 1 of")
    tab.click_tab("Person")
    tab.check("Choose the person")
    tab.reads("Step 0 of")


def test_an_exported_episode_opens_without_a_server(tmp_path: Path):
    page = tmp_path / "page.html"
    with start(ID, "--export", str(page), "--steps", "30") as viewer:
        said = viewer.communicate()[0]
    assert "opens without a server" in said, said
    assert 0.8e6 < page.stat().st_size < 2e6
    with chromium.chromium(tmp_path / "profile", 640, 480) as browse:
        replay = browse(page.as_uri())
        replay.wait("document.querySelectorAll('canvas').length > 0")
        wait_for_shirt(replay)
