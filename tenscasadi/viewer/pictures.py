"""Screenshots and films of the viewer, saved in the browser."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterable
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

_PATIENCE = 60.0  # s, for one picture of a page that draws in software


def send_screenshot(client: Any, name: str) -> None:
    """Send the present picture to the browser as a PNG file.

    `client` is viser's handle of the browser, and `name` is that of the file.
    """
    from PIL import Image  # slow import

    file = BytesIO()
    Image.fromarray(_take_picture(client)).save(file, format="png")
    client.send_file_download(f"{name}.png", file.getvalue(), save_immediately=True)


def send_film(
    client: Any, name: str, times: Iterable[float], show: Callable[[float], None], rate: int
) -> None:
    """Send a film to the browser as an mp4 file.

    Parameters
    ----------
    client : viser.ClientHandle
        Page, whose camera takes the pictures.
    name : str
        Name of the file without its suffix.
    times : iterable of float
        Times of the pictures [s].
    show : callable
        Shows a time on all pages.
    rate : int
        Pictures per second.

    Raises
    ------
    ImportError
        imageio-ffmpeg is not installed.
    """
    try:
        from imageio_ffmpeg import write_frames
    except ImportError as error:
        cure = "pip install 'tenscasadi[video]'"
        raise ImportError(f"films need imageio-ffmpeg: {cure}") from error

    with tempfile.TemporaryDirectory() as folder:
        target, writer = Path(folder) / "film.mp4", None
        try:
            for time in times:
                show(time)
                picture = _take_picture(client)
                picture = picture[: len(picture) // 2 * 2, : picture.shape[1] // 2 * 2]
                if writer is None:
                    size = picture.shape[1], picture.shape[0]
                    writer = write_frames(str(target), size, fps=rate, macro_block_size=2)
                    writer.send(None)
                writer.send(np.ascontiguousarray(picture))
        finally:
            if writer is not None:
                writer.close()
        client.send_file_download(f"{name}.mp4", target.read_bytes(), save_immediately=True)


def _take_picture(client: Any) -> NDArray[np.uint8]:
    """Render the picture (height, width, 3) in the browser.

    `client` is viser's handle of the browser.
    """
    size = int(client.camera.image_height), int(client.camera.image_width)
    return np.asarray(client.get_render(*size, timeout=_PATIENCE))
