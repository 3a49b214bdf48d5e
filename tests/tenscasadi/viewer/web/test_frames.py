"""Pages tell how many frames a second they draw where they are few."""

from __future__ import annotations

import re

import pytest
from browser import wait_until
from moving import thrown

from tenscasadi.viewer import view

# keeps the page busy for most of the time, so that it draws about five frames a second
BUSY = "window.busy = setInterval(function () { var end = performance.now() + 180; while (performance.now() < end); }, 190)"


def told(page):
    return page.evaluate("(document.getElementById('frames') || {}).textContent || ''")


@pytest.mark.slow
def test_few_frames_are_told_by_the_server_s_page_and_by_a_saved_one(open_page, tmp_path):
    saved = view(thrown(1.0), html=tmp_path / "page.html", speed=0.5)
    with view(thrown(2.0), browser=False, wait=False) as served:
        for url in (served.url, (tmp_path / "page.html").as_uri()):
            page = open_page(url)
            page.evaluate(BUSY)
            found = wait_until(
                page, lambda page=page: re.match(r"(\d+) frames a second", told(page)), "it tells"
            )
            assert int(found[1]) < 15
            assert page.faults == []
            page.close()
    assert saved.url is None


@pytest.mark.slow
def test_pages_without_a_graphics_card_leave_edges_rough(open_page):
    with view(thrown(0.1), browser=False, wait=False) as served:
        page = open_page(served.url)
        page.wait_for_selector("canvas")
        read = "document.createElement('canvas').getContext('webgl2', {antialias: true, alpha: false}).getContextAttributes()"
        found = page.evaluate(read)
        assert not found["antialias"]
        assert not found["alpha"]
        assert page.evaluate("devicePixelRatio") == 1
        assert page.faults == []
