"""How many frames a second the viewer draws in a headless browser without a graphics card: played by the server, and from a page of its own.

Run it: python examples/benchmark_viewer.py, with Debian's chromium or one that TENSCASADI_BROWSER
names, and with playwright. Frames are those in which WebGL draws something; the player sends 30 a
second. What a frame costs in processor time, of all processes of the browser, says more than their
number on a machine that does other things, too (Linux alone tells it).
"""

from __future__ import annotations

import contextlib
import os
import shutil
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from benchmark_scale import chain

import tenscasadi as tc
from tenscasadi.viewer import view

SECONDS = 6.0  # of counting
SOFTWARE = (
    *(
        "--no-sandbox",
        "--use-gl=angle",
        "--use-angle=swiftshader",
        "--enable-unsafe-swiftshader",
        "--disable-quic",
        "--no-first-run",
    ),
    *("--disable-background-networking", "--disable-component-update", "--disable-sync"),
)
SIZE = {"width": 1000, "height": 700}
# Counts the animation frames in which something was drawn.
COUNT = """
window.drawn = 0;
let dirty = false;
for (const context of [WebGL2RenderingContext, WebGLRenderingContext])
  for (const name of ["drawElements", "drawArrays", "drawElementsInstanced", "drawArraysInstanced"]) {
    const plain = context.prototype[name];
    if (plain) context.prototype[name] = function (...rest) { dirty = true; return plain.apply(this, rest); };
  }
(function look() { if (dirty) window.drawn += 1; dirty = false; requestAnimationFrame(look); })();
"""


class Row(NamedTuple):
    """Result for one trajectory: frame rate, time per frame, and time to the first frame.

    The time per frame is processor time [ms]. The last one is in seconds from opening the page.
    """

    name: str
    members: int
    way: str
    frames: float
    cost: float
    opening: float


def ball(seconds: float) -> tc.Trajectory:
    """Simulate a six-bar ball that is thrown and rolls on the ground."""
    structure = tc.shapes.six_bar_ball(prestress=50.0, stiffness=1000.0, damping=2.0)
    scene = tc.Scene(
        structure,
        gravity=tc.Gravity(),
        ground=tc.Ground(height=-1.0, stiffness=3000.0, damping=30.0, friction=0.5),
    )
    model = tc.Model(scene)
    start = model.state(structure.nodes, np.tile([0.5, 0.2, 0.0], (len(structure.nodes), 1)))
    return tc.simulate(model, seconds, 5e-4, state=start, correction=tc.Projection(), save_every=10)


def tower(seconds: float) -> tc.Trajectory:
    """Simulate the vibration of a tower of 100 prisms with 300 bars."""
    structure = chain(100)
    model = tc.Model(tc.Scene(structure))
    height = structure.nodes[:, 2] / structure.nodes[:, 2].max()
    sway = np.column_stack([4.0 * height**2, np.zeros((len(height), 2))])
    start = tc.build_projection(model)(model.state(structure.nodes, sway)).full().ravel()
    return tc.simulate(model, seconds, 1e-3, state=start, correction=tc.Projection(), save_every=10)


def many_rows(seconds: float) -> tc.Trajectory:
    """Simulate the fall of a tower of 17 prisms, with 1000 rows per second."""
    structure = tc.shapes.prism_tower(stages=17, prestress=50.0, stiffness=1000.0, damping=1.0)
    scene = tc.Scene(structure, gravity=tc.Gravity((0, 0, -1.0)), ground=tc.Ground(height=-0.1))
    return tc.simulate(
        tc.Model(scene), seconds, 1e-3, correction=tc.Projection(10), save_every=1, verify=False
    )


class Demand(NamedTuple):
    """Opening, dragging and page of a long motion.

    Wall seconds and processor seconds by part until the first frame, frames a second and processor
    ms of each by part while the time is dragged, MB of a page of 1000 frames.
    """

    rows: int
    opening: float
    opening_cost: dict[str, float]
    frames: float
    cost: dict[str, float]
    megabytes: float


def demand(browser: Any, motion: tc.Trajectory, seconds: float) -> Demand:
    """Measure a motion from the call of `view` on."""
    before, began = processor_parts(os.getpid()), time.perf_counter()
    page = browser.new_page(viewport=SIZE)
    page.set_default_timeout(120_000)
    page.add_init_script(COUNT)
    with view(motion, browser=False, wait=False) as served:
        page.goto(served.url)
        page.wait_for_function("window.drawn > 0")
        opening = time.perf_counter() - began
        opening_cost = subtract(processor_parts(os.getpid()), before)
        player: Any = served.player
        player.play(False)
        page.wait_for_timeout(2000)
        spent, first, began, shown = (
            processor_parts(os.getpid()),
            page.evaluate("window.drawn"),
            time.perf_counter(),
            0,
        )
        while (passed := time.perf_counter() - began) < seconds:
            player.show(float(motion.time[-1]) * (0.618 * shown % 1.0))  # back and forth
            shown += 1
            page.wait_for_timeout(max(0.0, 1000 * (shown / 30 - passed)))
        drawn = page.evaluate("window.drawn") - first
        parts = subtract(processor_parts(os.getpid()), spent)
        cost = {part: 1000 * seconds / max(drawn, 1) for part, seconds in parts.items()}
    page.close()
    with tempfile.TemporaryDirectory() as folder:
        target = Path(folder) / "page.html"
        view(motion, html=target, speed=float(motion.time[-1]) * 30 / 1000)
        size = target.stat().st_size / 1e6
    return Demand(len(motion.time), opening, opening_cost, drawn / passed, cost, size)


def subtract(after: dict[str, float], before: dict[str, float]) -> dict[str, float]:
    return {part: seconds - before.get(part, 0.0) for part, seconds in after.items()}


def processor_seconds(parent: int) -> float:
    """Processor time of all processes of the browser so far; NaN where the system does not tell."""
    parts = processor_parts(parent)
    return sum(seconds for part, seconds in parts.items() if len(parts) == 1 or part != "Python")


def part_of(process: int, parent: int) -> str:
    """Part that a process has in a picture: our Python, the page's scripts, or the drawing."""
    if process == parent:
        return "Python"
    command = Path(f"/proc/{process}/cmdline").read_text()
    kinds = {"--type=gpu-process": "drawing", "--type=renderer": "page"}
    return next((part for word, part in kinds.items() if word in command), "browser")


def processor_parts(parent: int) -> dict[str, float]:
    """Processor time of all processes below one so far by part.

    NaN where the system does not tell.
    """
    if not Path("/proc/self/stat").exists():
        return {"Python": float("nan")}
    below, total = {parent}, dict.fromkeys(("Python", "page", "drawing", "browser"), 0.0)
    for path in sorted(
        Path("/proc").glob("[0-9]*/stat"), key=lambda path: int(path.parent.name)
    ):  # children after their parents
        process = int(path.parent.name)
        try:
            fields = path.read_text().rpartition(")")[2].split()
            if process in below or int(fields[1]) in below:
                below.add(process)
                ticks = int(fields[11]) + int(fields[12])
                total[part_of(process, parent)] += ticks / os.sysconf("SC_CLK_TCK")
        except OSError:  # it has ended
            continue
    return total


def frames(browser: Any, url: str, seconds: float) -> tuple[float, float, float]:
    """Measure the frame rate of a page, its cost [ms], and the time to the first frame [s]."""
    page = browser.new_page(viewport=SIZE)
    page.set_default_timeout(120_000)
    page.add_init_script(COUNT)
    began = time.perf_counter()
    page.goto(url)
    page.wait_for_function("window.drawn > 0")
    opening = time.perf_counter() - began
    page.wait_for_timeout(2000)
    spent, (first, begin) = (
        processor_seconds(os.getpid()),
        page.evaluate("[window.drawn, performance.now()]"),
    )
    page.wait_for_timeout(1000 * seconds)
    last, end = page.evaluate("[window.drawn, performance.now()]")
    cost = 1000 * (processor_seconds(os.getpid()) - spent) / max(last - first, 1)
    page.close()
    return 1000 * (last - first) / (end - begin), cost, opening


@contextlib.contextmanager
def open_browser() -> Iterator[Any]:
    """Open a headless browser that draws in software."""
    from playwright.sync_api import sync_playwright

    path = (
        os.environ.get("TENSCASADI_BROWSER")
        or shutil.which("chromium")
        or shutil.which("google-chrome")
    )
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(
            executable_path=path, headless=True, args=list(SOFTWARE)
        )
        yield browser
        browser.close()


def measure(seconds: float = SECONDS, motions: dict[str, tc.Trajectory] | None = None) -> list[Row]:
    """Play each motion by the server and as a page."""
    shown = (
        {"six-bar ball, 10 s": ball(10.0), "tower of 300 bars": tower(10.0)}
        if motions is None
        else motions
    )
    rows = []
    with open_browser() as browser, tempfile.TemporaryDirectory() as folder:
        for name, motion in shown.items():
            members = len(motion.bars) + len(motion.strings)
            with view(motion, title=name, browser=False, wait=False) as served:
                rows.append(
                    Row(name, members, "server", *frames(browser, str(served.url), seconds))
                )
            page = Path(folder) / "page.html"
            view(motion, title=name, html=page)
            rows.append(
                Row(
                    name,
                    members,
                    f"page of {page.stat().st_size / 1e6:.1f} MB",
                    *frames(browser, page.as_uri(), seconds),
                )
            )
    return rows


def main(quick: bool = False) -> list[Row]:
    rows = measure(1.0, {"six-bar ball, 0.2 s": ball(0.2)}) if quick else measure()
    print(
        f"{'motion':24s} {'members':>8s} {'played by':>16s} {'frames/s':>9s} {'ms each':>8s} {'opened in':>10s}"
    )
    for row in rows:
        print(
            f"{row.name:24s} {row.members:8d} {row.way:>16s} {row.frames:9.1f} {row.cost:8.0f} {row.opening:8.1f} s"
        )
    motion = many_rows(0.5 if quick else 10.0)
    with open_browser() as browser:
        found = demand(browser, motion, 1.0 if quick else SECONDS)
    print(
        f"{len(motion.bars)} bars, {found.rows} rows: opened in {found.opening:.1f} s, dragged at {found.frames:.0f} frames/s, "
        f"page of 1000 frames {found.megabytes:.2f} MB"
    )
    for part, seconds in found.opening_cost.items():
        told = f"{seconds:6.2f} s of processor time to open, {found.cost[part]:5.0f} ms for a frame"
        print(f"{part:8s} {told}")
    return rows


if __name__ == "__main__":
    main(quick="--quick" in sys.argv)
