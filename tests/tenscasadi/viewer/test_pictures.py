"""Screenshots and films of pages, with a client that answers at once."""

from __future__ import annotations

import io
import subprocess
import sys
from types import SimpleNamespace

import numpy as np
import pytest
from moving import thrown
from PIL import Image

from tenscasadi.viewer.pictures import send_film, send_screenshot


class Page:
    """Page whose picture is white but for a column that moves."""

    def __init__(self):
        self.camera = SimpleNamespace(image_height=61.0, image_width=81.0)
        self.saved, self.notes, self.column = {}, [], 0

    def get_render(self, height, width, timeout):
        image = np.full((height, width, 3), 255, dtype=np.uint8)
        image[:, self.column : self.column + 8] = 0
        return image

    def send_file_download(self, name, content, save_immediately):
        assert save_immediately
        self.saved[name] = content

    def add_notification(self, title, body):
        self.notes.append(body)


def test_a_screenshot_is_saved_as_png():
    page = Page()
    send_screenshot(page, "prism")
    image = np.asarray(Image.open(io.BytesIO(page.saved["prism.png"])))
    assert image.shape == (61, 81, 3)
    assert image[0, 0].tolist() == [0, 0, 0]


def test_a_film_has_a_picture_for_each_time():
    ffmpeg = pytest.importorskip("imageio_ffmpeg", reason="the extra [video] is not installed")
    page = Page()

    def show(time):
        page.column = int(60 * time)

    send_film(page, "prism", np.linspace(0, 1, 31), show, 30)
    (name,) = page.saved
    assert name == "prism.mp4"
    command = [ffmpeg.get_ffmpeg_exe(), "-i", "-", "-f", "rawvideo", "-pix_fmt", "gray", "-"]
    raw = subprocess.run(command, input=page.saved[name], capture_output=True, check=True).stdout
    pictures = np.frombuffer(raw, np.uint8).reshape(-1, 60, 80)
    assert len(pictures) == 31
    assert pictures[0][:, :4].max() < 60
    assert pictures[-1][:, :4].min() > 200


def test_pages_hear_why_there_is_no_film(monkeypatch):
    pytest.importorskip("viser", reason="the extra [view] is not installed")
    from tenscasadi.viewer import view

    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    page = Page()
    with view(thrown(0.1), browser=False, wait=False) as found:
        found.player.film(page, "prism")
        assert "pip install 'tenscasadi[video]'" in page.notes[0]
        found.player.speed = 1e-5
        found.player.film(page, "prism")
        assert "frames" in page.notes[1]
        assert not found.player.playing
