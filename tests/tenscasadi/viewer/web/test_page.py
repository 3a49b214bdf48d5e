"""Pages play from the disk, without a server or a network."""

from __future__ import annotations

import numpy as np
import pytest
from browser import colored_fraction, picture, wait_until
from moving import thrown

from tenscasadi.viewer import view


@pytest.fixture(scope="module")
def motion():
    return thrown(1.0)


def test_a_page_plays_and_goes_where_it_is_told(motion, open_page, tmp_path):
    view({"falling": motion}, html=tmp_path / "prism.html", speed=0.5)
    page = open_page((tmp_path / "prism.html").as_uri())
    canvas = {"x": 0.0, "y": 160.0, "width": 560.0, "height": 380.0}
    wait_until(
        page, lambda: colored_fraction(picture(page, **canvas)) > 0.01, "the canvas is drawn"
    )
    clock = page.locator("#shown-time")
    told = float(clock.inner_text().split()[0])
    wait_until(page, lambda: float(clock.inner_text().split()[0]) != told, "the clock runs")
    before = picture(page, **canvas)
    wait_until(
        page,
        lambda: (np.abs(picture(page, **canvas) - before).max(axis=2) > 0.2).mean() > 1e-3,
        "the picture moves",
    )
    page.keyboard.press("Space")  # while it plays, what is typed would be overwritten

    def stands():
        before = clock.inner_text()
        page.wait_for_timeout(1000)
        return clock.inner_text() == before

    wait_until(page, stands, "it pauses")
    box = page.locator(
        "input[inputmode]"
    ).first  # of the player: in seconds shown, two for each simulated one
    box.fill("1.2")
    box.press("Enter")
    wait_until(
        page,
        lambda: abs(float(clock.inner_text().split()[0]) - 0.6) < 0.051,
        "the clock tells 0.6 s",
    )
    assert "tension of strings (N)" in page.locator("#shown").inner_text()
    assert page.title() == "falling"
    assert page.faults == []
    assert all(url.startswith(("file:", "data:", "blob:")) for url in page.asked)
