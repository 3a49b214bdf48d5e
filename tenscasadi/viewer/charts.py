"""Charts in the panel of the viewer and of saved pages."""

from __future__ import annotations

from tenscasadi.drawing.view_content import Chart, ViewContent


def build_charts(content: ViewContent) -> str:
    """Build all charts of the content as HTML, with lines at the displayed time."""
    return "".join(_build_chart(chart) for chart in content.charts)


def mark_time(time: float) -> str:
    """Build the HTML that moves the lines to a time [s]."""
    return f"<style>:root{{--time:{time:.6g}}}</style>"


def _build_chart(chart: Chart) -> str:
    from tenscasadi.plots.charts import draw_svg  # loads matplotlib

    svg, (left, right) = draw_svg(chart, 3.2, 1.7)
    svg = svg.replace("<svg ", '<svg style="display:block;width:100%;height:auto" ', 1)
    first, last = float(chart.time[0]), float(chart.time[-1])
    slope = 100 * (right - left) / ((last - first) or 1.0)
    place = f"calc({100 * left:.3f}% + (var(--time,{first:.6g}) - {first:.6g})*{slope:.6g}%)"
    line = f"position:absolute;top:6%;bottom:20%;left:{place};width:1px;background:#c0392b"
    return f'<div class="chart" style="position:relative">{svg}<div class="cursor" style="{line}"></div></div>'
