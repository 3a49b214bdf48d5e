"""Films: as many frames as asked for, that move, and that players everywhere read."""

from __future__ import annotations

import re
import subprocess
import sys

import numpy as np
import pytest

import tenscasadi as tc
from tenscasadi.animation import animate


@pytest.fixture(scope="module")
def swing():
    model = tc.Model(tc.Scene(tc.shapes.pendulum(), gravity=tc.Gravity()))
    return tc.simulate(model, t_end=0.5, step=0.01, compiled=False)


def test_a_film_holds_every_frame_at_the_right_speed(swing, tmp_path):
    ffmpeg = pytest.importorskip("imageio_ffmpeg", reason="tenscasadi[video] is not installed")
    file = animate(swing, tmp_path / "swing.mp4", speed=0.5, frames_per_second=10)
    command = [ffmpeg.get_ffmpeg_exe(), "-i", str(file), "-f", "rawvideo", "-pix_fmt", "gray", "-"]
    decoded = subprocess.run(command, capture_output=True, check=True, timeout=60)
    told = decoded.stderr.decode(errors="replace")
    assert re.search(r"Video: h264 .*yuv420p.* 540x460.* 10 fps", told), told
    frames = np.frombuffer(decoded.stdout, np.uint8).reshape(-1, 460, 540).astype(float)
    assert len(frames) == 11  # of 0.5 s at half speed
    assert abs(frames[-1] - frames[0]).max() > 100


def test_without_ffmpeg_it_says_what_to_install(swing, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    with pytest.raises(ImportError, match=r"pip install 'tenscasadi\[video\]'"):
        animate(swing, tmp_path / "swing.mp4")
    assert not list(tmp_path.iterdir())
    assert animate(swing, tmp_path / "swing.gif", frames_per_second=10).exists()


def test_a_film_that_cannot_be_written_is_an_os_error(swing, tmp_path):
    pytest.importorskip("imageio_ffmpeg", reason="tenscasadi[video] is not installed")
    with pytest.raises(FileNotFoundError):
        animate(swing, tmp_path / "missing" / "swing.mp4")
