"""Functions for pages with a server: opening, waiting, closing."""

from __future__ import annotations

import os
import sys
import webbrowser
from collections.abc import Callable
from types import TracebackType
from typing import Any, TypeVar

from tenscasadi.util.validate import flag
from tenscasadi.util.viewable import in_notebook
from tenscasadi.viewer.web.server import silence_viser

Own = TypeVar("Own", bound="Served")


class Served:
    """Base class of pages with a server, which ``with`` closes.

    The server is `_server`.
    """

    _server: Any

    def close(self) -> None:
        """Stop the server of the page."""
        stop(self._server)

    def __enter__(self: Own) -> Own:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()


def check_serving(browser: bool | None, wait: bool | None) -> None:
    """Check the flags `browser` and `wait`, which may be None.

    Raises TypeError.
    """
    for field, value in (("browser", browser), ("wait", wait)):
        if value is not None:
            flag(field, value)


def open_and_wait(
    url: str, hold: Callable[[], None], browser: bool | None, wait: bool | None
) -> None:
    """Open the browser, and keep the script running.

    It shows the page at `url`. `hold` is a function that waits. By default, the browser is opened
    if there is a display, and the script waits if it is one.
    """
    if browser if browser is not None else _has_display():
        webbrowser.open(url)
    if wait if wait is not None else not (hasattr(sys, "ps1") or in_notebook()):
        sys.stdout.write(f"viewer at {url}, Ctrl-C ends it\n")
        sys.stdout.flush()
        hold()


def stop(server: Any) -> None:
    """Stop a server without console output."""
    with silence_viser():
        server.stop()


def _has_display() -> bool:
    return sys.platform in ("darwin", "win32") or any(
        os.environ.get(name) for name in ("DISPLAY", "WAYLAND_DISPLAY")
    )
