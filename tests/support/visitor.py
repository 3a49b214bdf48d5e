"""A page that says what no page of the viewer would: messages straight to its server."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

CAMERA = {
    "type": "ViewerCameraMessage",
    "wxyz": (1.0, 0.0, 0.0, 0.0),
    "position": (3.0, 0.0, 0.0),
    "fov": 1.0,
    "near": 0.01,
    "far": 100.0,
    "image_height": 100,
    "image_width": 100,
    "look_at": (0.0, 0.0, 0.0),
    "up_direction": (0.0, 0.0, 1.0),
}


def connect(server: Any, **options: Any) -> Any:
    """A connection to a server of viser's, as its page makes it."""
    import viser
    from websockets.sync.client import connect

    return connect(
        f"ws://127.0.0.1:{server.get_port()}",
        subprotocols=[f"viser-v{viser.__version__}"],
        compression=None,
        max_size=None,
        **options,
    )


def say(page: Any, **message: Any) -> None:
    """Send a message."""
    import msgspec

    page.send(msgspec.msgpack.encode(message))


def wait_for(found: Callable[[], Any], told: str, seconds: float = 20.0) -> None:
    """Wait until `found` is true; fail after a time limit."""
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        if found():
            return
        time.sleep(0.01)
    raise AssertionError(f"waited in vain: {told}")
