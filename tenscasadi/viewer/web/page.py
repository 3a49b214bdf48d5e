"""Trajectories as self-contained HTML files with legend and charts."""

from __future__ import annotations

import json
from html import escape
from typing import TYPE_CHECKING

import numpy as np

from tenscasadi.drawing.view_content import choose_frame_times
from tenscasadi.viewer.canvas import Canvas
from tenscasadi.viewer.charts import build_charts
from tenscasadi.viewer.controls import FRAME_RATE
from tenscasadi.viewer.legend import build_legend
from tenscasadi.viewer.web.frames import adapt_quality

if TYPE_CHECKING:
    import viser

_STYLE = """
#shown{position:fixed;right:12px;top:12px;width:300px;max-height:calc(100vh - 90px);overflow:auto;z-index:5;background:#fffffff0;
border:1px solid #ddd;border-radius:6px;font:13px/1.45 system-ui,sans-serif}
#shown summary{cursor:pointer;padding:6px 8px;font-weight:600}
@media (max-width:600px){#shown{left:8px;right:8px;top:8px;width:auto;max-height:38vh;font-size:11px}}
"""

# The slider of the player tells the time of the film. The panel shows that of the motion, and moves
# the lines in the charts.
_FOLLOW = """
(function () {
  var times = %s, clock = document.getElementById("shown-time");
  function tell() {
    var thumb = document.querySelector("[role=slider]");
    var now = times[0] + times[1] * (thumb ? parseFloat(thumb.getAttribute("aria-valuenow")) || 0 : 0);
    clock.textContent = now.toFixed(times[2]) + " s";
    document.documentElement.style.setProperty("--time", now);
    requestAnimationFrame(tell);
  }
  tell();
})();
"""


# On a phone the panel would hide the motion.
_CLOSE = 'if (innerWidth < 600) document.getElementById("shown").open = false;'


def record_page(server: viser.ViserServer, canvas: Canvas, speed: float) -> str:
    """Record all frames of a canvas as an HTML page.

    `speed` is in simulated seconds per second. `server` is the viewer's server.
    """
    times = choose_frame_times(canvas.content, speed, FRAME_RATE)
    for layer in canvas.layers:
        layer.grain = 3e-5 * canvas.content.size  # a small part of a pixel
    canvas.show(float(times[0]))
    serializer = server.get_scene_serializer()
    pause = float(times[-1] - times[0]) / speed / max(len(times) - 1, 1)
    for time in times[1:]:
        serializer.insert_sleep(pause)
        canvas.show(float(time))
    if len(times) > 1:
        serializer.insert_sleep(pause)
    return adapt_quality(serializer.as_html())


def add_panel(page: str, canvas: Canvas, title: str, speed: float) -> str:
    """Add a panel with title, time, legend and charts to an HTML page.

    `speed` is in simulated seconds per second.
    """
    start, duration = canvas.content.start, canvas.content.end - canvas.content.start
    clock = script = ""
    if duration > 0:
        digits = int(np.clip(2 - np.floor(np.log10(duration)), 0, 9))
        clock = '<div style="padding:0 8px">t = <span id="shown-time"></span></div>'
        script = f"<script>{_FOLLOW % json.dumps([start, speed, digits])}</script>"
    inside = f"{clock}{build_legend(canvas)}{build_charts(canvas.content)}"
    script += f"<script>{_CLOSE}</script>"
    panel = f'<details id="shown" open><summary>{escape(title)}</summary>{inside}</details>'
    end = page.rindex("</body>")
    page = page[:end] + f"<style>{_STYLE}</style>{panel}{script}" + page[end:]
    first, last = page.index("<title>"), page.index("</title>")
    return page[:first] + f"<title>{escape(title)}" + page[last:]
