"""A motion as one self-contained HTML file: viser's recording of the canvas, with the legend, the time and the curves over it."""

from __future__ import annotations

import json
from html import escape
from typing import TYPE_CHECKING

import numpy as np

from tenscasadi.viewer.canvas import Canvas
from tenscasadi.viewer.charts import charts
from tenscasadi.viewer.legend import legend
from tenscasadi.viewer.web.frames import with_frames

if TYPE_CHECKING:
    import viser

FRAMES_PER_SECOND = 30
MOST_FRAMES = 3000
# of the size, what places are rounded to: a small part of a pixel; pages of large structures are
# then half as long
_GRAIN = 3e-5

_STYLE = """
#shown{position:fixed;right:12px;top:12px;width:300px;max-height:calc(100vh - 90px);overflow:auto;z-index:5;background:#fffffff0;
border:1px solid #ddd;border-radius:6px;font:13px/1.45 system-ui,sans-serif}
#shown summary{cursor:pointer;padding:6px 8px;font-weight:600}
"""

# The player tells its time by its slider: the panel shows it in the motion's seconds, and moves the
# line in the curves.
_FOLLOW = """
(function () {
  var times = %s, clock = document.getElementById("shown-time");
  function tell() {
    var thumb = document.querySelector("[role=slider]");
    var now = times[0] + times[1] * (thumb ? parseFloat(thumb.getAttribute("aria-valuenow")) || 0 : 0);
    clock.textContent = now.toFixed(times[2]) + " s";
    document.querySelectorAll(".cursor").forEach(function (line) {
      var x = Number(line.dataset.left) + (now - Number(line.dataset.first)) * Number(line.dataset.scale);
      line.setAttribute("x1", x);
      line.setAttribute("x2", x);
    });
    requestAnimationFrame(tell);
  }
  tell();
})();
"""


def record(
    server: viser.ViserServer,
    canvas: Canvas,
    speed: float,
    frames_per_second: int = FRAMES_PER_SECOND,
) -> str:
    """Return the page of all that a canvas shows, from its first time to its last."""
    first, last = canvas.exhibit.start, canvas.exhibit.end
    for layer in canvas.layers:
        layer.grain = _GRAIN * float((canvas.high - canvas.low).max())
    canvas.show(first)
    serializer = server.get_scene_serializer()
    moves = last > first
    if moves:
        times = frame_times(first, last, speed, frames_per_second)
        pause = (last - first) / speed / (len(times) - 1)
        for time in times[1:]:
            serializer.insert_sleep(pause)
            canvas.show(float(time))
        serializer.insert_sleep(pause)
    return with_frames(serializer.as_html())


def frame_times(first: float, last: float, speed: float, frames_per_second: int) -> np.ndarray:
    """Return the times of the frames, s. Raises ValueError where there would be too many."""
    count = 1 + max(1, round((last - first) / speed * frames_per_second))
    if count > MOST_FRAMES:
        faster = speed * count / MOST_FRAMES
        raise ValueError(
            f"speed is {speed:g}: {last - first:g} s would take {count} frames in the page, give a speed of at least {faster:.2g}"
        )
    return np.linspace(first, last, count)


def with_panel(page: str, canvas: Canvas, title: str, speed: float) -> str:
    """Return the page with a panel of title, time, legend and curves over it."""
    moves = canvas.exhibit.end > canvas.exhibit.start
    clock = '<div style="padding:0 8px">t = <span id="shown-time"></span></div>' if moves else ""
    panel = f'<details id="shown" open><summary>{escape(title)}</summary>{clock}{legend(canvas)}{charts(canvas.exhibit, marked=True)}</details>'
    digits = (
        int(np.clip(2 - np.floor(np.log10(canvas.exhibit.end - canvas.exhibit.start)), 0, 9))
        if moves
        else 0
    )
    script = (
        f"<script>{_FOLLOW % json.dumps([canvas.exhibit.start, speed, digits])}</script>"
        if moves
        else ""
    )
    end = page.rindex("</body>")
    named = page[:end] + f"<style>{_STYLE}</style>{panel}{script}" + page[end:]
    start, stop = named.index("<title>"), named.index("</title>")
    return named[:start] + f"<title>{escape(title)}" + named[stop:]
