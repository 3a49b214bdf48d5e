"""A headless browser for tests of the viewer: `open_page` opens pages, whose errors are kept; tests are skipped where there is none."""

from __future__ import annotations

import io
import os
import shutil
import time
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest

NAMES = ("chromium", "chromium-browser", "google-chrome", "chrome")
SOFTWARE = (  # it draws without a graphics card, and asks nobody for updates
    *(
        "--no-sandbox",
        "--use-gl=angle",
        "--use-angle=swiftshader",
        "--enable-unsafe-swiftshader",
        "--disable-quic",
        "--no-first-run",
    ),
    *(
        "--disable-background-networking",
        "--disable-component-update",
        "--disable-sync",
        "--mute-audio",
    ),
)
PATIENCE = 60.0  # s: drawing in software is slow on a busy machine


def chromium() -> str | None:
    """Path of a browser: what TENSCASADI_BROWSER names, or the first that is installed."""
    return os.environ.get("TENSCASADI_BROWSER") or next(
        (found for name in NAMES if (found := shutil.which(name))), None
    )


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    """A browser that draws in software; skips where viser, playwright or the browser is missing.

    It ends with its module: Playwright runs once at a time in a process, and other modules
    start it for themselves.
    """
    for module in ("viser", "playwright"):
        pytest.importorskip(
            module, reason=f"{module} is not installed: pip install 'tenscasadi[test]'"
        )
    path = chromium()
    if path is None:
        pytest.skip("there is no browser: install chromium, or name one in TENSCASADI_BROWSER")
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        running = playwright.chromium.launch(
            executable_path=path, headless=True, args=list(SOFTWARE)
        )
        yield running
        running.close()


@pytest.fixture
def open_page(browser: Any) -> Iterator[Callable[..., Any]]:
    """Open a page by its address. It has lists `faults`, of errors, and `asked`, of the addresses that it loaded; both are closed at the end."""
    opened = []

    def open_it(url: str, width: int = 900, height: int = 600) -> Any:
        page = browser.new_page(viewport={"width": width, "height": height})
        page.set_default_timeout(1000 * PATIENCE)
        page.faults, page.asked = [], []
        page.on(
            "console",
            lambda message: page.faults.append(message.text) if message.type == "error" else None,
        )
        page.on("pageerror", lambda error: page.faults.append(str(error)))
        page.on("request", lambda request: page.asked.append(request.url))
        page.goto(url)
        opened.append(page)
        return page

    yield open_it
    for page in opened:
        page.close()


def picture(page: Any, **clip: float) -> np.ndarray:
    """What a page looks like, (height, width, 3), 0 to 1; `clip`: x, y, width and height of a part of it."""
    from PIL import Image

    shot = page.screenshot(timeout=1000 * PATIENCE, **({"clip": clip} if clip else {}))
    return np.asarray(Image.open(io.BytesIO(shot)).convert("RGB"), dtype=float) / 255


def colored_fraction(image: np.ndarray) -> float:
    """Fraction of a picture that is not white."""
    return float((image.min(axis=2) < 0.95).mean())


def wait_until(page: Any, condition: Callable[[], Any], told: str) -> Any:
    """Return the first true value of `condition`; fail after a time limit."""
    end = time.monotonic() + PATIENCE
    while time.monotonic() < end:
        if value := condition():
            return value
        page.wait_for_timeout(50)
    raise AssertionError(f"waited {PATIENCE:g} s in vain: {told}; {page.faults}")
