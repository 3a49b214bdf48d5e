"""Display of the frame rate on slow pages."""

from __future__ import annotations

# Frames are those in which WebGL draws: viser draws on demand.
_SCRIPT = """<script>
(function () {
  var few = 28, probe = document.createElement("canvas").getContext("webgl2");
  var told = probe && probe.getExtension("WEBGL_debug_renderer_info");
  var name = told ? probe.getParameter(told.UNMASKED_RENDERER_WEBGL) : "";
  var software = /swiftshader|llvmpipe|software|basic render/i.test(name), dirty = false, times = [];
  if (probe && probe.getExtension("WEBGL_lose_context")) probe.getExtension("WEBGL_lose_context").loseContext();
  [window.WebGLRenderingContext, window.WebGL2RenderingContext].forEach(function (context) {
    if (!context) return;
    ["drawElements", "drawArrays", "drawElementsInstanced", "drawArraysInstanced"].forEach(function (call) {
      var own = context.prototype[call];
      if (own) context.prototype[call] = function () { dirty = true; return own.apply(this, arguments); };
    });
  });
  function badge() {
    var found = document.getElementById("frames");
    if (!found && document.body) {
      found = document.createElement("div");
      found.id = "frames";
      found.style.cssText = "position:fixed;left:12px;bottom:56px;z-index:6;font:12px system-ui,sans-serif;color:#777;pointer-events:none";
      document.body.appendChild(found);
    }
    return found;
  }
  function look(now) {
    if (times.length && now - times[times.length - 1] > 1500) times = [];
    if (dirty) times.push(now);
    dirty = false;
    while (times.length > 2 && now - times[1] > 2000) times.shift();
    var span = times.length > 1 ? times[times.length - 1] - times[0] : 0;
    var rate = span > 1000 ? 1000 * (times.length - 1) / span : NaN;
    var text = rate < few ? Math.round(rate) + " frames a second" + (software ? ", drawn without a graphics card" : "") : "";
    var place = text || times.length === 0 ? badge() : document.getElementById("frames");
    if (place && place.textContent !== text) place.textContent = text;
    requestAnimationFrame(look);
  }
  requestAnimationFrame(look);
})();
</script>"""


def add_frame_rate(page: str) -> str:
    """Add the display of the frame rate to a page of viser.

    It appears if the rate is lower than that of the player.
    """
    head = page.index("<head>") + len("<head>")
    return page[:head] + _SCRIPT + page[head:]
