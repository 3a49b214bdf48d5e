"""Adaptive picture quality of pages, and display of low frame rates."""

from __future__ import annotations

# A page that fills a million pixels in more than `slow` ms has no graphics card. It draws without
# smoothing of edges, and with one pixel per pixel of the page: a frame of 51 bars then takes 55 ms
# instead of 85 ms of processor time. Frames are those in which WebGL draws: viser draws on demand.
_SCRIPT = """<script>
(function () {
  var few = 28, slow = 5, probe = document.createElement("canvas").getContext("webgl2");
  var told = probe && probe.getExtension("WEBGL_debug_renderer_info");
  var name = told ? probe.getParameter(told.UNMASKED_RENDERER_WEBGL) : "";
  var software = /swiftshader|llvmpipe|software|basic render/i.test(name), dirty = false, times = [];
  function fill() {
    var program = probe.createProgram(), began;
    [[probe.VERTEX_SHADER, "attribute vec2 at; void main() { gl_Position = vec4(at, 0.0, 1.0); }"],
     [probe.FRAGMENT_SHADER, "precision highp float; void main() { gl_FragColor = normalize(gl_FragCoord); }"]
    ].forEach(function (stage) {
      var shader = probe.createShader(stage[0]);
      probe.shaderSource(shader, stage[1]);
      probe.compileShader(shader);
      probe.attachShader(program, shader);
    });
    probe.linkProgram(program);
    probe.useProgram(program);
    probe.bindBuffer(probe.ARRAY_BUFFER, probe.createBuffer());
    probe.bufferData(probe.ARRAY_BUFFER, new Float32Array([-1, -1, 3, -1, -1, 3]), probe.STATIC_DRAW);
    probe.enableVertexAttribArray(0);
    probe.vertexAttribPointer(0, 2, probe.FLOAT, false, 0, 0);
    for (var pass = 0; pass < 2; pass++) {
      began = performance.now();
      for (var k = 0; k < 3; k++) probe.drawArrays(probe.TRIANGLES, 0, 3);
      probe.readPixels(0, 0, 1, 1, probe.RGBA, probe.UNSIGNED_BYTE, new Uint8Array(4));
    }
    return performance.now() - began;
  }
  if (probe) {
    probe.canvas.width = probe.canvas.height = 580;
    probe.viewport(0, 0, 580, 580);
    var filled = fill();
  }
  if (filled > slow) {
    var open = HTMLCanvasElement.prototype.getContext;
    HTMLCanvasElement.prototype.getContext = function (kind, options) {
      return open.call(this, kind, /^webgl/.test(kind) ? Object.assign({}, options, {antialias: false}) : options);
    };
    Object.defineProperty(window, "devicePixelRatio", {get: function () { return 1; }});
  }
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


def adapt_quality(page: str) -> str:
    """Add a script to a page that adapts its resolution.

    The resolution is the highest one at the player's frame rate. The frame rate is displayed if it
    is lower than that of the player.
    """
    head = page.index("<head>") + len("<head>")
    return page[:head] + _SCRIPT + page[head:]
