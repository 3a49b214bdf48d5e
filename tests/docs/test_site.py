"""The site builds without a warning, and asks nobody for anything when it is read."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path

import pytest

import ocp
import tenscasadi as tc

ROOT = Path(__file__).resolve().parents[2]

NEEDED = ("material", "mkdocstrings", "latex2mathml", "viser")
pytestmark = [
    pytest.mark.slow,  # building the site simulates and plans what its gallery plays
    pytest.mark.skipif(
        not all(map(find_spec, NEEDED)), reason="needs pip install 'tenscasadi[docs]'"
    ),
]


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("site")
    command = [
        sys.executable,
        "-m",
        "mkdocs",
        "build",
        "--strict",
        "--quiet",
        "-f",
        ".mkdocs.yml",
        "-d",
        str(folder),
    ]
    environment = {**os.environ, "NO_MKDOCS_2_WARNING": "1", "PYTHONPATH": str(ROOT)}
    done = subprocess.run(
        command, capture_output=True, text=True, check=False, cwd=ROOT, env=environment
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return folder


def pages(site: Path) -> Iterator[Path]:
    yield from (
        page for page in site.rglob("*.html") if "viewer" not in page.relative_to(site).parts
    )


def test_pages_load_nothing_from_elsewhere(site):
    for page in pages(site):
        text = page.read_text(encoding="utf-8")
        loaded = re.findall(r"<(?:script|img|iframe|source)[^>]*\ssrc=\"([^\"]*)\"", text)
        loaded += re.findall(r"<link[^>]*\shref=\"([^\"]*)\"", text)
        assert loaded
        assert not [address for address in loaded if re.match(r"(?:https?:)?//", address)], page


def test_public_names_are_in_the_api(site):
    text = "".join(page.read_text(encoding="utf-8") for page in (site / "api").glob("*.html"))
    for package in (tc, ocp):
        for name in package.__all__:
            assert f'id="{package.__name__}.{name}"' in text, name


def test_formulas_are_mathml(site):
    text = (site / "mathematics.html").read_text(encoding="utf-8")
    assert text.count("<math") > 50
    assert "arithmatex" not in text
    assert "$" not in re.sub(r"<(script|style)\b.*?</\1>", "", text, flags=re.DOTALL)


def test_commands_are_listed(site):
    text = (site / "command_line.html").read_text(encoding="utf-8")
    for command in ("plan", "simulate", "tradeoff", "info"):
        assert f'id="{command}"' in text


def test_tutorials_come_as_notebooks(site):
    books = sorted((site / "tutorials").glob("*.ipynb"))
    assert len(books) == len(list((ROOT / "docs" / "tutorials").glob("*.md")))
    for book in books:
        assert json.loads(book.read_text(encoding="utf-8"))["nbformat"] == 4
        assert f'href="{book.name}"' in book.with_suffix(".html").read_text(encoding="utf-8")


def test_playable_pages_are_built(site):
    named = re.findall(
        r'href="viewer/(\w+)\.html"', (site / "gallery.html").read_text(encoding="utf-8")
    )
    assert sorted(named) == sorted(page.stem for page in (site / "viewer").glob("*.html"))
    assert len(named) > 5


def test_the_gallery_names_every_example(site):
    text = (site / "gallery.html").read_text(encoding="utf-8")
    for example in (ROOT / "examples").glob("*.py"):
        assert f"examples/{example.name}" in text, example.name


@pytest.mark.filterwarnings("default")  # those of playwright's own
def test_pages_open_from_disk_in_a_browser(site, browser):
    said: list[str] = []
    page = browser.new_page()
    page.on(
        "console",
        lambda message: said.append(message.text) if message.type in ("error", "warning") else None,
    )
    page.on("pageerror", lambda error: said.append(str(error)))
    local = ("file:", "data:", "blob:")
    page.on(
        "request",
        lambda request: (
            None if request.url.startswith(local) else said.append(f"asks for {request.url}")
        ),
    )
    for each in pages(site):
        if each.name != "404.html":  # whose addresses are those of a server
            page.goto(each.as_uri())
            assert page.locator("h1").first.is_visible(), each
    assert said == []
    page.goto((site / "mathematics.html").as_uri())
    assert page.locator("math").first.bounding_box()["height"] > 5
    page.locator("input.md-search__input").fill("collocation")
    page.locator(".md-search-result__link").first.wait_for()
    assert said == []
    page.goto((site / "viewer" / "simulate_ball.html").as_uri())
    page.wait_for_timeout(1000)
    assert [each for each in said if each.startswith("asks")] == []
    page.close()
